"""Ramp: a motion from one pose to another, known at every moment to whoever has the clock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Ramp:
    """An even motion; before and after it stands still.

    Args:
        start: Where it begins.
        end: Where it ends.
        begin: When it begins: ``time.monotonic()``, seconds, which all processes of a machine share.
        seconds: How long it takes; 0 for at once.
    """

    start: Array
    end: Array
    begin: float
    seconds: float

    def at(self, moment: float) -> Array:
        """Where it is at a moment of ``time.monotonic()``."""
        share = 1.0 if self.seconds <= 0 else min(max((moment - self.begin) / self.seconds, 0.0), 1.0)
        return self.start + share * (self.end - self.start)

    @classmethod
    def standing(cls, pose: Array, moment: float) -> Ramp:
        """Stands still from a moment on."""
        return cls(pose, pose, moment, 0.0)
