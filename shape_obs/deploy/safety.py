"""Gate: decide whether what was seen is good enough to act on.

Watchdog: act from another thread when a loop hangs.

DryRobot: a robot that is asked where it is and never moved.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from shape_obs.spec import Spec, SpecError

if TYPE_CHECKING:
    from typing_extensions import Self
from shape_obs.robot import ActionSpec, Anchors, Array, Robot, robot_anchors, robot_name

Move = Literal["act", "hold", "stop"]


@dataclass(frozen=True)
class Limits(Spec):
    """Set when to act, to hold and to stop.

    A shape that was not found in the present frame is never acted on, though an observation may still hold an older
    one. While it is lost, or late, the robot stands still; when that has lasted for ``hold`` seconds, the run ends.

    Args:
        hold: Seconds that a lost or old shape is waited for.
        min_valid: Share of a shape's points that must be measured, 0 to 1.
        max_age: Seconds after the exposure of an image within which it may be acted on, and after which the motion that
            was chosen on it ends unless a new one replaces it.
        watchdog: Seconds after which a loop that does not come round is ended; its motion ended after ``max_age``.

    Raises:
        SpecError: A value out of its range.
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
            raise SpecError(f"Limits.min_valid: expected a share from 0 to 1, got {self.min_valid!r}.")
        if not 0 < self.watchdog < math.inf:
            raise SpecError(f"Limits.watchdog: expected seconds above 0, got {self.watchdog!r}.")


class Judgement(NamedTuple):
    """Say what to do now, and why if it is not to act.

    Attributes:
        move: What to do.
        cause: ``"shape lost"``, ``"points missing"`` or ``"image old"``; empty when there is none.
        reason: The same with its numbers.
    """

    move: Move
    cause: str = ""
    reason: str = ""


class Gate:
    """Decides frame by frame.

    Args:
        limits: What is allowed.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._since: float | None = None

    def judge(self, info: Mapping[str, Any], now: float) -> Judgement:
        """Look at what is known of the last observation.

        Args:
            info: Of the environment: ``shape/ok``, ``shape/age``, ``shape/<name>/valid_fraction``, ``exposed``.
            now: ``time.monotonic()``.
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
        if not info.get("shape/ok", False) or not age <= 0:  # an age that is unknown is NaN
            return "shape lost", f"no shape in the present frame (the last is {age:.2f} s old)"
        shares = [value for name, value in info.items() if name.endswith("/valid_fraction")]
        if shares and min(shares) < limits.min_valid:
            few = f"only {min(shares):.0%} of the points were measured (at least {limits.min_valid:.0%} wanted)"
            return "points missing", few
        age = now - info.get("exposed", now)
        if not age <= limits.max_age:
            return "image old", f"the image was {1e3 * age:.0f} ms old (at most {1e3 * limits.max_age:.0f} ms wanted)"
        return "", ""


class Watchdog:
    """Call a function once when ``feed`` was not called for ``seconds``. A context manager; it watches within.

    Args:
        act: Called from a thread when the time is over.
        seconds: How long it waits.

    Attributes:
        expired: Whether the time was over.
    """

    def __init__(self, act: Callable[[], None], seconds: float) -> None:
        self._act, self._seconds = act, seconds
        self._fed = time.monotonic()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)
        self.expired = False

    def feed(self) -> None:
        """Report that the loop has come round."""
        self._fed = time.monotonic()

    def _watch(self) -> None:
        left = self._seconds
        while not self._over.wait(left):
            left = self._fed + self._seconds - time.monotonic()
            if left <= 0:
                self.expired = True
                self._act()
                return

    def __enter__(self) -> Self:
        self.feed()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()


class DryRobot:
    """Stands before a robot and lets no motion through; connecting, its state and ``stop`` are the robot's own.

    Args:
        robot: The robot.

    Attributes:
        sent: How many motions were swallowed.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.sent = 0

    @property
    def name(self) -> str:
        """Of the robot, marked."""
        return f"{robot_name(self._robot)} (dry run)"

    @property
    def action_spec(self) -> ActionSpec:
        """The robot's."""
        return self._robot.action_spec

    @property
    def anchors(self) -> Anchors:
        """The robot's."""
        return robot_anchors(self._robot)

    @property
    def shape_obs_defaults(self) -> Any:
        """The robot's."""
        return getattr(self._robot, "shape_obs_defaults", {})

    def source(self) -> Any:
        """The camera that the robot brings.

        Raises:
            ValueError: It brings none.
        """
        own = getattr(self._robot, "source", None)
        if own is None:
            raise ValueError(f"source 'robot': {robot_name(self._robot)} brings no camera; name one, such as 'd455'.")
        return own()

    def connect(self) -> None:
        """Connect the robot."""
        self._robot.connect()

    def reset(self) -> None:
        """Stay where it is."""

    def send(self, action: Array, until: float) -> None:
        """Count the motion and drop it."""
        self.sent += 1

    def state(self) -> Array:
        """The robot's."""
        return self._robot.state()

    def stop(self) -> None:
        """Stop the robot: somebody else may have moved it."""
        self._robot.stop()

    def park(self) -> None:
        """Stay where it is."""

    def disconnect(self) -> None:
        """Disconnect the robot."""
        self._robot.disconnect()
