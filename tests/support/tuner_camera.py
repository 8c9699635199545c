"""Serve the tuner for a camera that is unplugged after thirty frames, until a file exists: ``tuner_camera.py FILE``."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import cv2
import numpy as np

from shape_obs import Frame
from shape_obs.source import CameraLost, CameraNotFound, Source
from shape_obs.tuner.engine import Engine
from shape_obs.tuner.server import Address, serve
from shape_obs.tuner.session import Session

FRAMES = 30


class Unplugged(Source):
    """A camera that shows a blue rope and is then gone until it is plugged in again; it writes its calls to a file."""

    kind, name, live, has_depth = "camera", "scripted", True, False

    def __init__(self, plug: Path) -> None:
        super().__init__()
        self.plug, self.count = plug, 0

    @property
    def intrinsics(self) -> None:
        return None

    def note(self, call: str) -> None:
        with self.plug.with_suffix(".log").open("a") as log:
            log.write(f"{call}\n")

    def connect(self) -> None:
        if self.count >= FRAMES and not self.plug.exists():
            raise CameraNotFound("scripted camera: it is not plugged in")
        self.note("connect")

    def disconnect(self) -> None:
        self.note("disconnect")

    def read(self, timeout: float = 1.0, fresh: bool = False) -> Frame:
        time.sleep(1 / 30)
        self.count += 1
        if self.count >= FRAMES and not self.plug.exists():
            raise CameraLost("scripted camera: it was unplugged")
        picture = np.full((240, 320, 3), 150, np.uint8)
        u = np.arange(50, 270)
        curve = np.stack([u, 140 + 40 * np.sin((u - 50 + self.count) / 40)], axis=1).astype(np.int32)
        cv2.polylines(picture, [curve], False, (30, 60, 200), 10, cv2.LINE_AA)
        return Frame(picture, stamp=self.count / 30)

    def read_latest(self, max_age: float = 0.1) -> Frame:
        return self.read()


if __name__ == "__main__":
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
