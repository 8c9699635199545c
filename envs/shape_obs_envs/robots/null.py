"""NullRobot: a robot that moves nothing and remembers what it was sent."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from shape_obs.robot import ActionSpec, Array, RobotError
from shape_obs_envs.robots.coordinates import checked_motion

_REMEMBERED: Final = 10_000


class NullRobot:
    """Satisfies the `Robot` protocol without any hardware: its state is where it has been told to go.

    For dry runs, and to see what a controller would send. Every reset puts it into the middle of its workspace.

    Args:
        size: How many coordinates it has, when no ``spec`` is given: x0, x1, ... in metres, 1 cm for an action of 1,
            within -0.5 ... 0.5 m.
        spec: What its actions mean, an `ActionSpec` or a mapping of its fields.
        period: Seconds for which a velocity is driven, when ``spec`` has that mode: until the next one comes.

    Attributes:
        action_spec: What its actions mean.
        sent: The last 10,000 motions: (``time.monotonic()``, (A,) in physical units).

    Raises:
        ValueError: ``size`` is less than 1.
        SpecError: A mapping that is no spec.

    Example:
        >>> robot = NullRobot(size=2)
        >>> robot.connect()
        >>> robot.reset()
        >>> robot.send(np.array([0.01, 0.0]), until=time.monotonic() + 0.2)
        >>> robot.state().tolist()
        [0.01, 0.0]
    """

    name = "null"

    def __init__(
        self, size: int = 6, spec: ActionSpec | Mapping[str, Any] | None = None, period: float = 1 / 30
    ) -> None:
        if size < 1:
            raise ValueError(f"size: expected 1 coordinate or more, got {size}.")
        if spec is None:
            spec = ActionSpec(
                names=tuple(f"x{i}" for i in range(size)),
                units=("m",) * size,
                scale=(0.01,) * size,
                low=(-0.5,) * size,
                high=(0.5,) * size,
            )
        self.action_spec: ActionSpec = spec if isinstance(spec, ActionSpec) else ActionSpec.from_dict(spec)
        self.sent: deque[tuple[float, Array]] = deque(maxlen=_REMEMBERED)
        self._period, self._connected = period, False
        self._told = self._middle()

    def connect(self) -> None:
        """Nothing to open, but the other calls expect it."""
        self._connected = True

    def reset(self) -> None:
        """Go to the middle of the workspace.

        Raises:
            RobotError: It is not connected.
        """
        self._check_connected()
        self._told = self._middle()

    def send(self, action: Array, until: float) -> None:
        """Remember a motion (A,), in physical units; one whose time is over is not begun.

        Raises:
            RobotError: It is not connected, or this is no motion.
        """
        self._check_connected()
        motion = checked_motion(action, self.action_spec)
        if time.monotonic() >= until:
            return
        self.sent.append((time.monotonic(), motion))
        self._told = self.action_spec.following(self._told, motion, self._period)

    def state(self) -> Array:
        """Where it has been told to go: (A,) in physical units."""
        return self._told.copy()

    def stop(self) -> None:
        """It stands still anyway."""

    def park(self) -> None:
        """It may be left alone anywhere."""

    def disconnect(self) -> None:
        """Nothing to close."""
        self._connected = False

    def _middle(self) -> Array:
        return (np.asarray(self.action_spec.low) + np.asarray(self.action_spec.high)) / 2

    def _check_connected(self) -> None:
        if not self._connected:
            raise RobotError(f"The robot {self.name!r} is not connected: call connect() first.")
