"""Report: summarize a run, section by section, in memory that does not grow with it."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass, field
from typing import Any

from shape_obs.deploy.quantiles import Quantiles, Section


@dataclass(frozen=True)
class Report:
    """Summarize a run.

    Args:
        steps: How many there were.
        seconds: How long they took.
        overruns: Steps whose deadline had passed before it was waited for.
        acted: Steps with an action.
        held: Steps without one, since the shape was lost or late.
        expired: Motions that ended because no new one replaced them in time.
        guarded: How many actions the guard changed: ``clipped``, ``capped``, ``boxed``.
        reasons: Why steps were held, and how often.
        ended: Why the run ended.
        failed: Whether that is an error: an exception, the camera or the robot failed, the shape stayed lost, or the
            watchdog stopped the robot.
        success: Whether the goal was reached in the last frame; None without a goal.
        sections: Milliseconds by part of the loop, right to 0.5 %. ``source`` rectifies and aligns, ``detect`` finds
            the shapes, ``between`` makes features of them and judges, ``act`` is the controller's, ``send`` the guard's
            and the robot's; ``own`` is all of these together, from raw images to an action sent; ``age`` is how long
            the images had been there before.
    """

    steps: int
    seconds: float
    overruns: int
    acted: int
    held: int
    expired: int
    guarded: dict[str, int]
    reasons: dict[str, int]
    ended: str
    failed: bool
    success: bool | None
    sections: dict[str, Section]

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON-able values."""
        sections = {name: section._asdict() for name, section in self.sections.items()}
        return {**asdict(self), "sections": sections}

    def __str__(self) -> str:
        lines = [
            f"steps           {self.steps} in {self.seconds:.1f} s ({self.steps / max(self.seconds, 1e-9):.2f} Hz), "
            f"overruns: {self.overruns}",
            f"acted           {self.acted}, held: {self.held}"
            + "".join(f"\n  held          {count} x {reason}" for reason, count in self.reasons.items()),
            "guard           " + ", ".join(f"{name} {count}" for name, count in self.guarded.items()),
            f"motions         ended early: {self.expired}",
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
    """Count what happens while a run goes on."""

    acted: int = 0
    held: int = 0
    guarded: Counter[str] = field(default_factory=lambda: Counter(clipped=0, capped=0, boxed=0))
    reasons: Counter[str] = field(default_factory=Counter)
    sections: dict[str, Quantiles] = field(default_factory=dict)

    def time(self, milliseconds: dict[str, float]) -> None:
        """Add a step's times."""
        for name, value in milliseconds.items():
            self.sections.setdefault(name, Quantiles()).add(value)

    def report(self, **rest: Any) -> Report:
        """Return the report of the run."""
        return Report(
            acted=self.acted,
            held=self.held,
            guarded=dict(self.guarded),
            reasons=dict(self.reasons),
            sections={name: times.section() for name, times in self.sections.items()},
            **rest,
        )
