"""Serve the tuner for a camera that is unplugged after thirty frames, until a file exists: ``tuner_camera.py FILE``."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

from fake_camera import FakeCamera
from fake_cell import rope

from shape_obs.tuner.engine import Engine
from shape_obs.tuner.server import Address, serve
from shape_obs.tuner.session import Session
from shape_obs.utils.timing import CLOCK

FRAMES = 30


class Unplugged(FakeCamera):
    """A camera that is gone until a file says that it is plugged in again; it writes its calls to another file."""

    def __init__(self, plug: Path) -> None:
        script = {FRAMES: FakeCamera.unplug}
        super().__init__(lambda n: rope(down=n % 20), script, hertz=30.0, clock=CLOCK, depth=None, intrinsics=None)
        self._plug = plug

    def _note(self) -> None:
        with self._plug.with_suffix(".log").open("a") as log:
            log.write(f"{self.calls[-1]}\n")

    def connect(self) -> None:
        if self._plug.exists():
            self.plug()
        super().connect()
        self._note()

    def disconnect(self) -> None:
        super().disconnect()
        self._note()


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())  # as the command does, so that the camera is released
    rule = {"kind": "hsv", "low": [100, 120, 40], "high": [130, 255, 255]}
    engine = Engine(Unplugged(Path(sys.argv[1])), Session({"segmentation": rule}), patience=1.0)
    with Address(port=0).bind() as listening:
        try:
            engine.start()
            serve(
                engine,
                Path(sys.argv[1]).with_suffix(".yaml"),
                "127.0.0.1",
                listening,
                lambda url: print(url, flush=True),
            )
        finally:
            engine.stop()
