"""Ramp: a motion from one pose to another, known at every moment to every process that has the clock."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Ramp:
    """Describe an even motion that ends at a time limit; before and after it the robot stands still.

    Args:
        start: Where it begins.
        end: Where it ends if it has the time.
        begin: When it begins: ``time.monotonic()``, seconds, which all processes of a machine share.
        seconds: How long it takes; 0 for at once.
        until: When it ends at the latest, wherever it is then: ``time.monotonic()``, seconds.
    """

    start: Array
    end: Array
    begin: float
    seconds: float
    until: float = math.inf

    def at(self, moment: float) -> Array:
        """Return the pose at a moment of ``time.monotonic()``."""
        moving = min(moment, self.until) - self.begin
        if moving < 0:
            return self.start.copy()
        share = 1.0 if moving >= self.seconds else moving / self.seconds
        return self.start + share * (self.end - self.start)

    @property
    def final(self) -> Array:
        """The pose in which it stands still in the end."""
        return self.at(math.inf)

    @classmethod
    def standing(cls, pose: Array, moment: float) -> Ramp:
        """Return a motion that stands still from a moment on."""
        return cls(pose, pose, moment, 0.0)
