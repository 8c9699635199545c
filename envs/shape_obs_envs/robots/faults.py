"""Faults: what goes wrong with a camera's frames, on purpose, and a list of when it did."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Final

import numpy as np

KINDS: Final = ("drop", "delay", "freeze", "black")
#: Seconds by which a frame is late, at least and at most; those behind it wait, as on a cable.
_LATE: Final = (0.05, 0.15)
_REMEMBERED: Final = 100_000


@dataclass
class Faults:
    """Shares of frames that something happens to; no frame has two faults, but any may have a hand in it.

    Args:
        drop: Lost on their way.
        delay: Late by 50 to 150 ms.
        freeze: Without a new colour image; depth goes on.
        black: With a black colour image.
        seed: Of which frames these are.

    Attributes:
        affected: Fault -> numbers of the frames that had it, "occluder" for those with a hand in them.

    Raises:
        ValueError: Shares below 0, or above 1 together.
    """

    drop: float = 0.0
    delay: float = 0.0
    freeze: float = 0.0
    black: float = 0.0
    seed: int = 0
    affected: dict[str, deque[int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shares = [getattr(self, kind) for kind in KINDS]
        if min(shares) < 0 or sum(shares) > 1:
            told = ", ".join(f"{kind}={share}" for kind, share in zip(KINDS, shares, strict=True))
            raise ValueError(f"expected shares from 0 to 1, together at most 1, got {told}.")
        self._random = np.random.default_rng([self.seed, 0xFA17])

    def draw(self) -> str:
        """What happens to the next frame: one of `KINDS`, or an empty word."""
        drawn = self._random.random()
        for kind in KINDS:
            drawn -= getattr(self, kind)
            if drawn < 0:
                return kind
        return ""

    def lateness(self) -> float:
        """Seconds by which the next late frame is late."""
        return float(self._random.uniform(*_LATE))

    def note(self, kind: str, number: int) -> None:
        """Remember what happened to a frame."""
        self.affected.setdefault(kind, deque(maxlen=_REMEMBERED)).append(number)
