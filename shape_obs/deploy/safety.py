"""Decide whether a detection is good enough to act on, stop a loop that hangs, and replace a robot in a dry run."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from shape_obs.robot import ActionSpec, Anchors, Array, Robot, measured, robot_anchors, robot_name
from shape_obs.spec import Spec, SpecError
from shape_obs.utils.timing import CLOCK, Clock

if TYPE_CHECKING:
    from typing_extensions import Self

Move = Literal["act", "hold", "stop"]


@dataclass(frozen=True)
class Limits(Spec):
    """Limits that decide when to act, to hold and to stop.

    The robot acts only on shapes found in the present frame, even if the observation still holds an older shape. While
    a shape is lost or late, the robot stands still; after ``hold`` seconds the run ends.

    Args:
        hold: Seconds to wait for a lost or late shape.
        min_valid: Fraction of a shape's points that must be measured, 0 to 1.
        max_age: Seconds after the exposure of an image during which the robot may act on it. A motion that was chosen
            from the image ends then, unless a new motion has replaced it.
        watchdog: Seconds after which a loop that hangs is ended; its last motion has already ended after ``max_age``.

    Raises:
        SpecError: A value is out of its range.
    """

    hold: float = 0.5
    min_valid: float = 0.5
    max_age: float = 0.2
    watchdog: float = 2.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("hold", "max_age"):
            if not 0 <= getattr(self, name) < math.inf:
                raise SpecError(f"Limits.{name}: expected seconds, 0 or more, got {getattr(self, name)!r}.")
        if not 0 <= self.min_valid <= 1:
            raise SpecError(f"Limits.min_valid: expected a fraction from 0 to 1, got {self.min_valid!r}.")
        if not 0 < self.watchdog < math.inf:
            raise SpecError(f"Limits.watchdog: expected seconds above 0, got {self.watchdog!r}.")


class Judgement(NamedTuple):
    """A decision, and its reason.

    Attributes:
        move: ``"act"``, ``"hold"`` or ``"stop"``.
        cause: ``"shape lost"``, ``"points missing"`` or ``"image old"``; empty for ``"act"``.
        reason: The cause with its numbers.
    """

    move: Move
    cause: str = ""
    reason: str = ""


class Gate:
    """Decide for each frame whether to act, to hold or to stop.

    Args:
        limits: The limits.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._since: float | None = None

    def judge(self, info: Mapping[str, Any], now: float) -> Judgement:
        """Return the decision for the last observation.

        Args:
            info: The environment's info: ``shape/ok``, ``shape/age``, ``shape/<name>/valid_fraction``, ``exposed``.
            now: Present value of ``time.monotonic()``.
        """
        cause, reason = self._fault(info, now)
        if not cause:
            self._since = None
            return Judgement("act")
        if self._since is None:
            self._since = now
        waited = now - self._since
        if waited > self._limits.hold:
            return Judgement("stop", cause, f"{reason}, for {waited:.2f} s")
        return Judgement("hold", cause, reason)

    def _fault(self, info: Mapping[str, Any], now: float) -> tuple[str, str]:
        limits = self._limits
        age = info.get("shape/age", math.nan)
        if not info.get("shape/ok", False) or not age <= 0:  # an unknown age is NaN
            return "shape lost", f"no shape in the present frame (the last is {age:.2f} s old)"
        fractions = [value for name, value in info.items() if name.endswith("/valid_fraction")]
        if fractions and min(fractions) < limits.min_valid:
            few = f"only {min(fractions):.0%} of the points were measured (limit: {limits.min_valid:.0%})"
            return "points missing", few
        age = now - info.get("exposed", now)
        if not age <= limits.max_age:
            return "image old", f"the image was {1e3 * age:.0f} ms old (limit: {1e3 * limits.max_age:.0f} ms)"
        return "", ""


class Watchdog:
    """Call a function, once, if ``feed`` was not called for ``seconds``. Use it as a context manager.

    Args:
        act: Called from a thread when the time limit is reached.
        seconds: Time limit.
        clock: Time, and the thread that watches it.

    Attributes:
        expired: Whether the time limit was reached.
    """

    def __init__(self, act: Callable[[], None], seconds: float, clock: Clock = CLOCK) -> None:
        self._act, self._seconds, self._clock = act, seconds, clock
        self._alarm = clock.alarm(self._bite, "watchdog")
        self.expired = False

    def feed(self) -> None:
        """Restart the time limit."""
        if not self.expired:
            self._alarm.set(self._clock.now() + self._seconds)

    def _bite(self) -> None:
        self.expired = True
        self._act()

    def __enter__(self) -> Self:
        self.feed()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._alarm.close()


class DryRobot:
    """Wrap a robot and discard all motions; connecting, reading its state and ``stop`` are passed on.

    Args:
        robot: The robot.

    Attributes:
        sent: Number of discarded motions.
    """

    sent: int

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.sent = 0

    @property
    def name(self) -> str:
        """Name of the robot, marked as a dry run."""
        return f"{robot_name(self._robot)} (dry run)"

    @property
    def action_spec(self) -> ActionSpec:
        """Action spec of the robot."""
        return self._robot.action_spec

    @property
    def anchors(self) -> Anchors:
        """Anchors of the robot."""
        return robot_anchors(self._robot)

    @property
    def measured(self) -> Mapping[str, float]:
        """Measurements of the robot."""
        return measured(self._robot)

    @property
    def shape_obs_defaults(self) -> Any:
        """Defaults of the robot for ``ShapeObservation``."""
        return getattr(self._robot, "shape_obs_defaults", {})

    def source(self) -> Any:
        """Return the robot's own camera.

        Raises:
            ValueError: The robot has no camera.
        """
        own = getattr(self._robot, "source", None)
        if own is None:
            raise ValueError(f"source 'robot': {robot_name(self._robot)} has no camera; name one, such as 'd455'.")
        return own()

    def connect(self) -> None:
        """Connect the robot."""
        self._robot.connect()

    def reset(self) -> None:
        """Do nothing."""

    def send(self, action: Array, until: float) -> None:
        """Count the motion and discard it."""
        self.sent += 1

    def state(self) -> Array:
        """Return the state of the robot."""
        return self._robot.state()

    def stop(self) -> None:
        """Stop the robot, since another program may have moved it."""
        self._robot.stop()

    def park(self) -> None:
        """Do nothing."""

    def disconnect(self) -> None:
        """Disconnect the robot."""
        self._robot.disconnect()
