"""LiveView: a web page that shows what the camera sees while a robot runs."""

from __future__ import annotations

import socket
import sys
import threading
from contextlib import redirect_stdout
from typing import Any

import numpy as np

from shape_obs.deploy.loop import Step
from shape_obs.drawing import draw_detection

GOAL = (235, 130, 40)


class LiveView:
    """The camera's image with the points drawn over it, the goal in orange, and what the loop decides.

    Drawing happens in a thread of its own and takes the newest frame only, so that the loop does not wait for it.

    Args:
        port: Of the page, on this machine: ``http://localhost:PORT``. 0 takes any that is free.
        env: The environment that runs; with a goal, its ``target`` is drawn too.

    Raises:
        ImportError: viser is not installed; ``pip install 'shape-obs[view]'``.
        OSError: The port is taken.

    Attributes:
        url: Of the page.
    """

    def __init__(self, port: int, env: Any) -> None:
        try:
            import viser
        except ImportError as error:
            raise ImportError("a live view needs viser: pip install 'shape-obs[view]'") from error
        self._env = env
        port = port or _free_port()
        with redirect_stdout(sys.stderr):  # stdout belongs to the report
            self._server = viser.ViserServer("127.0.0.1", port, verbose=False)
        self.url = f"http://localhost:{self._server.get_port()}"
        self._text = self._server.gui.add_markdown("waiting for a frame")
        self._image = self._server.gui.add_image(np.zeros((48, 64, 3), np.uint8), format="jpeg")
        self._newest: Step | None = None
        self._wake, self._over = threading.Condition(), False
        self._thread = threading.Thread(target=self._run, name="live view", daemon=True)
        self._thread.start()

    def show(self, moment: Step) -> None:
        """Show this next; what has not been drawn yet is left out."""
        with self._wake:
            self._newest = moment
            self._wake.notify()

    def close(self) -> None:
        """Shut the page."""
        with self._wake:
            self._over = True
            self._wake.notify()
        self._thread.join(2.0)
        with redirect_stdout(sys.stderr):
            self._server.stop()

    def _run(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._over or self._newest is not None)
                if self._over:
                    return
                newest, self._newest = self._newest, None
            if newest is not None:
                self._draw(newest)

    def _draw(self, moment: Step) -> None:
        judgement, frame = moment.judgement, moment.frame
        self._text.content = f"**{judgement.move}** {judgement.reason}  \nstep {moment.step}"
        if frame is None or frame.rgb is None:
            return
        target = getattr(self._env, "target", None)
        under = [] if target is None or target.points2d is None else [(target.points2d, GOAL)]
        self._image.image = draw_detection(frame.rgb, moment.detection, under=under)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
