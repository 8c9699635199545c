"""A robot, a camera and a controller for tests without hardware, and the environment that joins them."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import cv2
import gymnasium as gym
import numpy as np
from fake_camera import HEIGHT, WIDTH, FakeCamera
from fake_clock import FakeClock

from shape_obs import ShapeObservation
from shape_obs.deploy import Limits
from shape_obs.robot import ActionSpec, RobotError
from shape_obs.utils.timing import Clock

PATIENT = Limits(max_age=9.0, watchdog=9.0)  # no delay of a busy machine holds an action back
ROPE = {
    "shapes": [{"kind": "centerline", "n": 10, "ends": "tips"}],
    "segmentation": {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]},
}


class FakeRobot:
    """A robot that stores its commands with their times, and ignores ``until`` as a careless driver would.

    Attributes:
        command: Commanded position of shape (size,).
        calls: Names of the calls, in order.
        times: Name and time of each call.
        slow: Name of a call -> seconds that it takes the next time.
        broken: Names of calls that raise ``RobotError``.
        foreign: Whether they raise what a driver of others does instead.
        attempts: Names of the calls, also of those that failed.
        signals: Name of a call -> signal that comes during it.
    """

    name = "fake"
    goal = np.zeros((10, 3))

    def __init__(
        self,
        size: int = 2,
        clock: Clock | None = None,
        broken: Iterable[str] = (),
        signals: Mapping[str, str] | None = None,
        foreign: bool = False,
        **spec: Any,
    ) -> None:
        given = {"scale": size * [0.01], "low": size * [-0.1], "high": size * [0.1], "units": size * ["m"], **spec}
        self.action_spec = ActionSpec.from_dict({"names": [f"x{i}" for i in range(size)], **given})
        self.clock = clock or FakeClock()
        self.command = np.zeros(size)
        self.times: list[tuple[str, float]] = []
        self.slow: dict[str, float] = {}
        self.broken, self.signals = set(broken), dict(signals or {})
        self.attempts: list[str] = []
        self.foreign = foreign
        self._call("__init__")

    @property
    def calls(self) -> list[str]:
        return [name for name, _ in self.times]

    def when(self, call: str) -> list[float]:
        """Return the times of a call."""
        return [moment for name, moment in self.times if name == call]

    def _call(self, name: str) -> None:
        self.clock.sleep(self.slow.pop(name, 0.0))
        self.attempts.append(name)
        try:
            if name in self.signals:
                signal.raise_signal(getattr(signal, self.signals[name]))
        finally:  # a driver may turn any exception into one of its own
            if name in self.broken:
                raise (RuntimeError if self.foreign else RobotError)(f"{name}: the robot is in an emergency stop")
        if name not in ("state", "__init__"):
            self.times.append((name, self.clock.now()))

    def connect(self) -> None:
        self._call("connect")

    def reset(self) -> None:
        self._call("reset")
        self.command = np.zeros(len(self.action_spec))

    def send(self, action: Any, until: float) -> None:
        self._call("send")
        self.command = self.action_spec.following(self.command, action, 0.02)

    def state(self) -> Any:
        self._call("state")
        return self.command.copy()

    def stop(self) -> None:
        self._call("stop")

    def park(self) -> None:
        self._call("park")

    def disconnect(self) -> None:
        self._call("disconnect")


def rope(right: float = 0.0, down: int = 0) -> Any:
    """Return an image (H, W, 3) uint8 of a blue rope, some metres to the right and pixels down."""
    rgb, u = np.full((HEIGHT, WIDTH, 3), 200, np.uint8), round(100 * right / 0.7)
    return cv2.line(rgb, (40 + u, 60 + down), (110 + u, 66 + down), (20, 60, 200), 5)


def rope_camera(robot: Any = None, **options: Any) -> FakeCamera:
    """Return a camera that sees a rope, which the robot moves to the right."""
    return FakeCamera(lambda _: rope(0.0 if robot is None else robot.command[0]), **options)


def unplugged_camera() -> FakeCamera:
    """Return a camera that cannot be connected."""
    camera = rope_camera()
    camera.unplug()
    return camera


def make_env(source: Any = None, robot: Any = None, **options: Any) -> Any:
    """Return ``ShapeObs/D455-v0`` of a fake camera and perhaps a robot, on the camera's clock."""
    if source is None:
        source = rope_camera(robot, clock=None if robot is None else robot.clock)
    if isinstance(source, FakeCamera):
        options = {"clock": source.clock, **options}
    given = {"rate": 50.0, "size": [WIDTH, HEIGHT], "timeout": 0.2, "disable_env_checker": True, **options}
    return gym.make("shape_obs_envs:ShapeObs/D455-v0", source=source, robot=robot, **given)


def cell(robot: Any = None, source: Any = None, **options: Any) -> Any:
    """Return (wrapped environment, robot, camera)."""
    robot = robot or FakeRobot()
    source = source or rope_camera(robot, clock=robot.clock)
    return ShapeObservation(make_env(source, robot, **options), **ROPE), robot, source


class Always:
    """A controller with a constant action; ``at`` maps steps to functions that are called before it, or replace it."""

    def __init__(self, at: Mapping[int, Callable[[], Any]] | None = None) -> None:
        self._at, self._step = at or {}, -1

    def act(self, observation: Any) -> Any:
        self._step += 1
        replaced = self._at[self._step]() if self._step in self._at else None
        return np.array([1.0, 0.0]) if replaced is None else replaced
