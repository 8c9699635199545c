"""Borders of a mask: from the pixels that a contour runs through to where the material ends."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d

from shape_obs.form import Curve
from shape_obs.samples import Samples

Array = npt.NDArray[np.float64]

# Smoothing along the contour, in its steps: enough to see a direction and a length through the staircase of pixels,
# at 0.2 px off a bend of radius 10. What is fitted is not smoothed.
_STAIRCASE: Final = 2.0
_CELL: Final = 2  # steps of the contour in one sample: half the work, and no bend is lost


@dataclass(frozen=True, eq=False)
class Border:
    """Where a piece of a mask ends: its outer outline, or a hole's.

    Args:
        traced: (P,2) pixels, image coordinates, closed, clockwise as seen, through the centres of the border pixels.
        hole: Whether the material lies outside.
    """

    traced: Array
    hole: bool = False

    @cached_property
    def points(self) -> Array:
        """(P,2) where the material ends, still with the staircase.

        Per step along its main direction, a straight border runs through pixels that lie 0 to 1 px inside the edge,
        along the other axis: half a pixel on average there, so 0.5 max(|n_u|, |n_v|) along the normal n.
        """
        smooth = _smooth(self.traced)
        along = np.roll(smooth, -1, axis=0) - np.roll(smooth, 1, axis=0)
        reach = np.sqrt(np.einsum("pd,pd->p", along, along))
        normal = along[:, ::-1] * ([-1, 1] if self.hole else [1, -1]) / np.maximum(reach, 1e-9)[:, None]
        return self.traced + 0.5 * np.abs(normal).max(axis=1, keepdims=True) * normal

    @cached_property
    def curve(self) -> Curve:
        """The outline, the staircase smoothed away, so that its length is the object's."""
        return Curve(_smooth(self.points), np.zeros(len(self.points), bool), closed=True)

    @cached_property
    def samples(self) -> Samples:
        """``points``, two by two."""
        starts = np.arange(0, len(self.points), _CELL)
        weight = np.diff(starts, append=len(self.points)).astype(np.float64)
        return Samples(np.add.reduceat(self.points, starts, axis=0) / weight[:, None], weight, float(_CELL))


def clockwise(points: Array) -> bool:
    """Whether a closed outline of (P,2+) points runs clockwise as seen, the second coordinate downwards."""
    u, v = points[:, 0] - points[0, 0], points[:, 1] - points[0, 1]
    return bool(u @ np.roll(v, -1) >= v @ np.roll(u, -1))


def _smooth(points: Array) -> Array:
    return gaussian_filter1d(points, _STAIRCASE, axis=0, mode="wrap", truncate=2.0)
