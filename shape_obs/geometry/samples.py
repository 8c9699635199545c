"""Weighted points: the input of a clusterer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Samples:
    """Weighted points.

    Args:
        points: ``(M, D)`` centroids: pixels for D = 2, metres for D = 3.
        weight: ``(M,)`` how many pixels (points) each stands for.
        scale: Edge of the cells, in the unit of ``points``.
    """

    points: npt.NDArray[np.float64]
    weight: npt.NDArray[np.float64]
    scale: float

    def __len__(self) -> int:
        return len(self.points)
