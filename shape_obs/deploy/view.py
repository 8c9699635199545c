"""Show the image and the detected shapes while a robot runs: on a web page, or in the rerun viewer."""

from __future__ import annotations

import socket
import sys
from contextlib import redirect_stdout
from typing import Any

import numpy as np

from shape_obs.deploy.loop import Step
from shape_obs.drawing import GOAL, draw_detection, legible_scale
from shape_obs.drawing.rerun_log import RerunLog
from shape_obs.utils.errors import install_hint
from shape_obs.utils.threads import Newest


class LiveView:
    """A web page with the camera's image, the points drawn over it, the goals in orange, and the loop's decision.

    A thread draws only the newest frame, so that the loop never waits.

    Args:
        port: Port of the page on this machine, ``http://localhost:PORT``; 0 for any free port.
        env: The running environment; if it has goals, its ``targets`` are drawn too.

    Raises:
        ImportError: viser is not installed; the extra ``view`` installs it.
        OSError: The port is in use.

    Attributes:
        url: URL of the page.
    """

    def __init__(self, port: int, env: Any) -> None:
        try:
            import viser
        except ImportError as error:
            raise ImportError(f"a live view needs viser: {install_hint('view')}") from error
        self._env = env
        port = port or _free_port()
        with redirect_stdout(sys.stderr):  # stdout is for the report
            self._server = viser.ViserServer("127.0.0.1", port, verbose=False)
        self.url = f"http://localhost:{self._server.get_port()}"
        self._text = self._server.gui.add_markdown("waiting for a frame")
        self._image = self._server.gui.add_image(np.zeros((48, 64, 3), np.uint8), format="jpeg")
        self._newest: Newest[Step] = Newest(self._draw, "live view")

    def show(self, step: Step) -> None:
        """Draw a step next, in place of one that has not been drawn yet."""
        self._newest.put(step)

    def close(self) -> None:
        """Close the page."""
        self._newest.close()
        with redirect_stdout(sys.stderr):
            self._server.stop()

    def _draw(self, step: Step) -> None:
        judgement, frame = step.judgement, step.frame
        self._text.content = f"**{judgement.move}** {judgement.reason}  \nstep {step.step}"
        if frame is None or frame.rgb is None:
            return
        targets = getattr(self._env, "targets", ())
        under = [(target.points2d, GOAL) for target in targets if target.points2d is not None]
        self._image.image = draw_detection(frame.rgb, step.detection, scale=legible_scale(frame.rgb), under=under)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class RerunView:
    """Log the steps of a loop to a rerun recording stream, as ``log_rerun`` does, with actions, goals and decisions.

    A thread logs only the newest step, so that the loop never waits: while it is busy, steps are left out.

    Args:
        recording: The ``rerun.RecordingStream``.
        env: The running environment, with a robot; if it has goals, its ``targets`` are logged too.

    Raises:
        ImportError: rerun is not installed; the extra ``rerun`` installs it.
    """

    def __init__(self, recording: Any, env: Any) -> None:
        self._log = RerunLog(recording)
        self._env = env
        self._names: tuple[str, ...] = env.unwrapped.robot.action_spec.names
        self._newest: Newest[Step] = Newest(self._draw, "rerun view")

    def show(self, step: Step) -> None:
        """Log a step next, in place of one that has not been logged yet."""
        self._newest.put(step)

    def close(self) -> None:
        """Log the last step; a viewer that hangs is left alone after two seconds."""
        self._newest.close()

    def _draw(self, step: Step) -> None:
        frame, judgement = step.frame, step.judgement
        notes = {"loop": f"{judgement.move} {judgement.reason}".strip()}
        if frame is None:
            self._log.log(None, number=step.step, notes=notes)
            return
        action = {} if step.action is None else {"action": dict(zip(self._names, step.action, strict=True))}
        targets = getattr(self._env, "targets", ())
        goals = [target.points2d for target in targets if target.points2d is not None]
        self._log.log(
            step.detection,
            frame.rgb,
            frame.depth,
            frame.camera,
            number=step.step,
            features=action,
            goals=goals,
            notes=notes,
        )
