"""A source that draws a rope, and a robot that stores its command, for tests without hardware."""

from __future__ import annotations

import time
from typing import Any

import cv2
import numpy as np

from shape_obs import Intrinsics
from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import Frame
from shape_obs.robot import ActionSpec, RobotError
from shape_obs.source import EndOfSource, FrameTimeout, NotConnected, Source, StaleFrame

WIDTH, HEIGHT = 160, 120
INTRINSICS = Intrinsics(WIDTH, HEIGHT, fx=100.0, fy=100.0, cx=79.5, cy=59.5)
# Straight above the table, 0.7 m high; x to the right, y up in the image.
OVERHEAD = Extrinsics(((1.0, 0.0, 0.0, 0.0), (0.0, -1.0, 0.0, 0.0), (0.0, 0.0, -1.0, 0.7), (0.0, 0.0, 0.0, 1.0)))
ROPE = {
    "shapes": [{"kind": "centerline", "n": 10, "ends": "tips"}],
    "segmentation": {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]},
}


class RopeSource(Source):
    """A camera with a fixed rate that sees a blue rope, `robot.offset` to the right; tests switch its faults.

    Attributes:
        gone: Nothing comes, and nothing can be opened.
        dark: Images are black.
        delay: Seconds by which frames are older when they arrive.
        exposure: Seconds from the beginning of a frame's exposure to its arrival; None where the camera does not know.
    """

    kind, name, live, has_depth = "drawn", "drawn rope", True, True

    def __init__(self, robot: Any = None, hertz: float = 100.0, frames: int | None = None) -> None:
        super().__init__(OVERHEAD)
        self._robot, self._period, self._frames = robot, 1 / hertz, frames
        self._begin: float | None = None
        self._last = -1
        self.gone = self.dark = False
        self.delay = 0.0
        self.exposure: float | None = None
        self.connects = 0

    @property
    def intrinsics(self) -> Intrinsics:
        if self._begin is None:
            raise NotConnected("connect first")
        return INTRINSICS

    def connect(self) -> None:
        if self.gone:
            raise FrameTimeout("the camera is gone")
        if self._begin is None:
            self._begin, self._last = time.monotonic(), -1
            self.connects += 1

    def disconnect(self) -> None:
        self._begin = None

    def read(self, timeout: float = 1.0, fresh: bool = False) -> Frame:
        if self._begin is None:
            raise NotConnected("connect first")
        due = self._begin + (self._last + 1) * self._period
        if self.gone or due - time.monotonic() > timeout:
            time.sleep(timeout)
            raise FrameTimeout(f"no frame in {timeout} s")
        if self._frames is not None and self._last + 1 >= self._frames:
            raise EndOfSource("over")
        time.sleep(max(0.0, due - time.monotonic()))
        self._last = int((time.monotonic() - self._begin) / self._period)
        return self._draw()

    def read_latest(self, max_age: float = 0.1) -> Frame:
        if self._begin is None:
            raise NotConnected("connect first")
        newest = int((time.monotonic() - self._begin) / self._period)
        if self.gone or time.monotonic() - (self._begin + newest * self._period) > max_age:
            raise StaleFrame("too old")
        self._last = newest
        return self._draw()

    def _draw(self) -> Frame:
        assert self._begin is not None
        stamp = 1000.0 + self._last * self._period - self.delay
        received = self._begin + self._last * self._period
        rgb = np.full((HEIGHT, WIDTH, 3), 0 if self.dark else 200, np.uint8)
        depth = np.full((HEIGHT, WIDTH), 700, np.uint16)
        if not self.dark:
            right = round(100 * (0.0 if self._robot is None else self._robot.command[0]) / 0.7)
            cv2.line(rgb, (40 + right, 60), (110 + right, 66), (20, 60, 200), 5)
        exposed = None if self.exposure is None else received - self.exposure
        return Frame(rgb, depth, self.camera, stamp, received, self._last, exposed)


class ListRobot:
    """A robot that stores its last command."""

    def __init__(self, size: int = 2, **spec: Any) -> None:
        given = {"scale": size * [0.01], "low": size * [-0.1], "high": size * [0.1], "units": size * ["m"], **spec}
        self.action_spec = ActionSpec.from_dict({"names": [f"x{i}" for i in range(size)], **given})
        self.command = np.zeros(size)
        self.calls: list[str] = []
        self.fails = False

    def connect(self) -> None:
        self.calls.append("connect")

    def reset(self) -> None:
        self.calls.append("reset")
        self.command = np.zeros(len(self.action_spec))

    def send(self, action: Any, until: float) -> None:
        if self.fails:
            raise RobotError("the robot is in an emergency stop")
        self.calls.append("send")
        self.command = self.action_spec.following(self.command, action, 0.02)

    def state(self) -> Any:
        return self.command.copy()

    def stop(self) -> None:
        self.calls.append("stop")

    def park(self) -> None:
        self.calls.append("park")

    def disconnect(self) -> None:
        self.calls.append("disconnect")
