"""A robot without hardware that stores the motions it was sent."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from shape_obs.robot import ActionSpec, Array, RobotError

_STORED: Final = 10_000


class NullRobot:
    """A ``Robot`` without hardware, whose state is its commanded position.

    For dry runs, and to see what a controller would send. Each reset moves it to the middle of its workspace.

    Args:
        size: Number of coordinates if no ``spec`` is given: x0, x1, ... in metres, 1 cm for an action of 1, within
            -0.5 ... 0.5 m.
        spec: Meaning of its actions, an ``ActionSpec`` or a mapping of its fields.
        period: Duration in seconds of a velocity command, if ``spec`` has that mode.

    Attributes:
        action_spec: Meaning of its actions.
        sent: The last 10,000 motions: (``time.monotonic()``, motion of shape ``(A,)`` in physical units).

    Raises:
        ValueError: ``size`` is less than 1.
        SpecError: The mapping is not a valid spec.

    Example:
        >>> robot = NullRobot(size=2)
        >>> robot.connect()
        >>> robot.reset()
        >>> robot.send(np.array([0.01, 0.0]), until=time.monotonic() + 0.2)
        >>> robot.state().tolist()
        [0.01, 0.0]
    """

    action_spec: ActionSpec
    sent: deque[tuple[float, Array]]
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
        self.action_spec = spec if isinstance(spec, ActionSpec) else ActionSpec.from_dict(spec)
        self.sent = deque(maxlen=_STORED)
        self._period, self._connected = period, False
        self._position = self._middle()

    def connect(self) -> None:
        """Connect; required before the other calls."""
        self._connected = True

    def reset(self) -> None:
        """Go to the middle of the workspace.

        Raises:
            RobotError: It is not connected.
        """
        self._check_connected()
        self._position = self._middle()

    def send(self, action: Array, until: float) -> None:
        """Store a motion ``(A,)`` in physical units; skip it if its time limit has passed.

        Raises:
            RobotError: It is not connected, or the motion is invalid.
        """
        self._check_connected()
        motion = checked_motion(action, self.action_spec)
        if time.monotonic() >= until:
            return
        self.sent.append((time.monotonic(), motion))
        self._position = self.action_spec.following(self._position, motion, self._period)

    def state(self) -> Array:
        """Return the commanded position ``(A,)`` in physical units."""
        return self._position.copy()

    def stop(self) -> None:
        """Do nothing: the robot always stands still."""

    def park(self) -> None:
        """Do nothing: the robot is safe in any position."""

    def disconnect(self) -> None:
        """Disconnect."""
        self._connected = False

    def _middle(self) -> Array:
        return (np.asarray(self.action_spec.low) + np.asarray(self.action_spec.high)) / 2

    def _check_connected(self) -> None:
        if not self._connected:
            raise RobotError(f"The robot {self.name!r} is not connected: call connect() first.")


def checked_motion(action: Array, spec: ActionSpec) -> Array:
    """Return a copy of a motion.

    Raises:
        RobotError: The motion has a wrong shape, or values that are not finite.
    """
    motion = np.array(action, np.float64)
    if motion.shape != (len(spec),) or not np.isfinite(motion).all():
        raise RobotError(
            f"Expected a motion of {len(spec)} finite numbers ({', '.join(spec.names)}), got {action!r}; the robot "
            "continues with the last one."
        )
    return motion
