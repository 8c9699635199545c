"""Found points against a known closed outline."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from shape_obs.bench.ropes import resample
from shape_obs.geometry.outline import clockwise
from shape_obs.geometry.topology import Ring
from shape_obs.metrics import in_order, spacing_cv

Array = npt.NDArray[np.float64]

_FINE_STEP: Final = 0.1  # pixels


class OutlineScore(NamedTuple):
    """How well ordered points follow a closed outline; lengths in pixels.

    Args:
        ordered: The points' places along the outline strictly increase, once around.
        clockwise: As seen in the image.
        distance: Mean distance of the points to the outline.
        gap_cv: Standard deviation over mean of the distances between neighbours, last to first too.
        slip: Largest distance of a point from its own arc position, along the outline, in gaps; where the outline's
            first point is not where point 0 belongs, it means nothing.
    """

    ordered: bool
    clockwise: bool
    distance: float
    gap_cv: float
    slip: float


def outline_score(points: npt.ArrayLike, outline: Array) -> OutlineScore:
    """Compare N found points with a known outline.

    Args:
        points: (N,2) pixels.
        outline: (P,2) pixels, closed, clockwise as seen, from where point 0 belongs.
    """
    found = np.asarray(points, dtype=np.float64)
    fine = resample(np.concatenate([outline, outline[:1]]), _FINE_STEP)[:-1]
    distance, nearest = KDTree(fine).query(found)
    place = np.asarray(nearest, dtype=np.float64) / len(fine)
    off = (place - np.arange(len(found)) / len(found) + 0.5) % 1.0 - 0.5
    return OutlineScore(
        ordered=in_order(place, period=1.0),
        clockwise=clockwise(found),
        distance=float(distance.mean()),
        gap_cv=spacing_cv(found, Ring(len(found))),
        slip=float(np.abs(off).max() * len(found)),
    )
