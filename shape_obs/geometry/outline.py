"""Borders of a mask: from the pixels that a contour runs through to where the material ends."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import NUMPY, Kernels
from shape_obs.compiled.interface_outline import CELL
from shape_obs.geometry.form import Curve
from shape_obs.geometry.samples import Samples

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Border:
    """Where a piece of a mask ends: its outer outline, or a hole's.

    Args:
        traced: (P,2) pixels, image coordinates, closed, either way round, through the centres of the border pixels.
        hole: Whether the material lies outside.
        kernels: What runs the inner loops.
    """

    traced: Array
    hole: bool = False
    kernels: Kernels = NUMPY

    @property
    def points(self) -> Array:
        """(P,2) where the material ends, clockwise as seen, still with the staircase."""
        return self._drawn[0]

    @property
    def smooth(self) -> Array:
        """(P,2) the same, the staircase smoothed away, so that its length is the object's."""
        return self._drawn[1]

    @cached_property
    def curve(self) -> Curve:
        """The smoothed outline."""
        return Curve(self.smooth, np.zeros(len(self.smooth), bool), closed=True, kernels=self.kernels)

    @cached_property
    def samples(self) -> Samples:
        """``points``, two by two."""
        points = self.kernels.pairs(self.points)
        weight = np.full(len(points), float(CELL))
        if len(self.points) % CELL:
            weight[-1] = 1.0
        return Samples(points, weight, float(CELL))

    @cached_property
    def rim(self) -> tuple[Array, Array, npt.NDArray[np.int64], float, float]:
        """The smoothed outline as the rim of a sheet, see ``Kernels.rim``."""
        return self.kernels.rim(self.smooth)

    @cached_property
    def _drawn(self) -> tuple[Array, Array]:
        return self.kernels.border(np.ascontiguousarray(self.traced), self.hole)


def clockwise(points: Array) -> bool:
    """Whether a closed outline of (P,2+) points runs clockwise as seen, the second coordinate downwards."""
    u, v = points[:, 0] - points[0, 0], points[:, 1] - points[0, 1]
    return bool(u[:-1] @ v[1:] >= v[:-1] @ u[1:])
