"""Report: how a run went, section by section."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Section:
    """Milliseconds that a part of the loop took: median, 95th percentile and most."""

    median: float
    p95: float
    most: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Section:
        """Of the values of a run."""
        array = np.asarray(values, np.float64)
        return cls(*(float(np.round(value, 3)) for value in (np.median(array), np.percentile(array, 95), array.max())))


@dataclass(frozen=True)
class Report:
    """How a run went.

    Args:
        steps: How many there were.
        seconds: How long they took.
        overruns: Steps whose deadline had passed before it was waited for.
        acted: Steps with an action.
        held: Steps without one, since the shape was lost or late.
        guarded: How many actions the guard changed: ``clipped``, ``capped``, ``boxed``.
        reasons: Why steps were held, and how often.
        ended: Why the run ended.
        failed: Whether that is an error: the camera or the robot failed, the shape stayed lost, or the watchdog bit.
        success: Whether the goal was reached in the last frame; None without a goal.
        sections: Milliseconds by part of the loop. ``source`` rectifies and aligns, ``detect`` finds the shapes,
            ``between`` makes features of them, judges and logs, ``act`` is the controller's, ``send`` the guard's and
            the robot's; ``own`` is all of these together, from raw images to an action sent; ``age`` is how long the
            images had been there before.
    """

    steps: int
    seconds: float
    overruns: int
    acted: int
    held: int
    guarded: dict[str, int]
    reasons: dict[str, int]
    ended: str
    failed: bool
    success: bool | None
    sections: dict[str, Section]

    def to_dict(self) -> dict[str, Any]:
        """The report as JSON-able values."""
        return asdict(self)

    def __str__(self) -> str:
        lines = [
            f"steps           {self.steps} in {self.seconds:.1f} s ({self.steps / max(self.seconds, 1e-9):.2f} Hz), "
            f"overruns: {self.overruns}",
            f"acted           {self.acted}, held: {self.held}"
            + "".join(f"\n  held          {count} x {reason}" for reason, count in self.reasons.items()),
            "guard           " + ", ".join(f"{name} {count}" for name, count in self.guarded.items()),
            f"ended           {self.ended}",
        ]
        if self.success is not None:
            lines.append(f"goal            {'reached' if self.success else 'not reached'}")
        if self.sections:
            lines.append("milliseconds    median     p95    most")
            lines += [
                f"  {name:<12} {section.median:8.2f}{section.p95:8.2f}{section.most:8.2f}"
                for name, section in self.sections.items()
            ]
        return "\n".join(lines)


@dataclass
class Tally:
    """What is counted while a run goes on."""

    acted: int = 0
    held: int = 0
    guarded: Counter[str] = field(default_factory=lambda: Counter(clipped=0, capped=0, boxed=0))
    reasons: Counter[str] = field(default_factory=Counter)
    sections: dict[str, list[float]] = field(default_factory=dict)

    def time(self, milliseconds: dict[str, float]) -> None:
        """Add a step's times."""
        for name, value in milliseconds.items():
            self.sections.setdefault(name, []).append(value)

    def report(self, **rest: Any) -> Report:
        """The report of the run."""
        return Report(
            acted=self.acted,
            held=self.held,
            guarded=dict(self.guarded),
            reasons=dict(self.reasons),
            sections={name: Section.of(values) for name, values in self.sections.items()},
            **rest,
        )
