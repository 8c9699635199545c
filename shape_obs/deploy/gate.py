"""Gate: decide whether what was seen is good enough to act on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from shape_obs.spec import Spec, SpecError

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
