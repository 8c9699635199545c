"""Weighted points, the input of a clusterer; and the points of an outline, taken two by two."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled

Array = npt.NDArray[np.float64]

SAMPLED: Final = 2  # points of an outline in one sample: half the work, and no bend is lost


@dataclass(frozen=True)
class Samples:
    """Weighted points.

    Args:
        points: ``(M, D)`` centroids: pixels for D = 2, metres for D = 3.
        weight: ``(M,)`` how many pixels (points) each stands for.
        scale: Edge of the cells, in the unit of ``points``.
    """

    points: Array
    weight: Array
    scale: float

    def __len__(self) -> int:
        return len(self.points)


@compiled("(f8[:,::1],)")
def pairs(points: Array) -> Array:
    """Return the mean of each two points, the last alone if they are odd: ``(P, D)`` -> ``(ceil(P / 2), D)``."""
    size, dimension = points.shape
    out = np.empty(((size + 1) // 2, dimension))
    for p in range(size // 2):
        for d in range(dimension):
            out[p, d] = (points[2 * p, d] + points[2 * p + 1, d]) / 2
    if size % 2:
        for d in range(dimension):
            out[size // 2, d] = points[size - 1, d]
    return out
