"""The connected pieces of a mask that belong to each of several objects, where none belongs to two."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.image.connected_runs import label_runs, nearest_pixel
from shape_obs.image.find_region import region_of_runs
from shape_obs.image.region import Region

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]


def component_parts(region: Region, curves: Sequence[Array], min_area: int, min_share: float) -> list[Region] | None:
    """Return the pieces of a region that belong to each curve.

    Args:
        region: Of all objects.
        curves: ``(P, 2)`` pixels each.
        min_area: Smaller pieces are dropped, pixels.
        min_share: So are those smaller than this share of the largest.

    Returns:
        None where a piece belongs to two curves, or it is not clear which pieces belong to one.
    """
    points, stops = np.ascontiguousarray(np.concatenate(curves)), np.cumsum([len(curve) for curve in curves])
    owner, apart = split_components(region.runs, points, stops)
    if not apart:
        return None
    own = [region.runs[owner == k] for k in range(len(curves))]
    return [region_of_runs(runs, region.window, min_area, min_share) for runs in own]


@compiled("(i8[:,::1], f8[:,::1], i8[::1])")
def split_components(runs: Indices, points: Array, stops: Indices) -> tuple[Indices, bool]:
    """Return the curve that each run of a mask belongs to where every curve has connected pieces of its own.

    Args:
        runs: ``(R, 3)`` of the mask, see ``connected_runs``.
        points: ``(P, 2)`` pixels of all curves, one after the other.
        stops: ``(K,)`` where each curve ends in ``points``.

    Returns:
        ``(R,)`` the index of a curve, -1 for pieces that no curve passes; whether no piece is passed by two curves, and
        each curve passes one with at least half of its points.
    """
    label, count = label_runs(runs)
    owner = np.full(count, -1, np.int64)
    for k in range(len(stops)):
        first, met = stops[k - 1] if k else 0, 0
        for p in range(first, stops[k]):
            row, column = nearest_pixel(points[p, 1]), nearest_pixel(points[p, 0])
            low, high = 0, len(runs)  # the first run that is behind the point
            while low < high:
                middle = (low + high) // 2
                if runs[middle, 0] < row or (runs[middle, 0] == row and runs[middle, 1] <= column):
                    low = middle + 1
                else:
                    high = middle
            if low > 0 and runs[low - 1, 0] == row and column < runs[low - 1, 2]:
                piece = label[low - 1]
                if owner[piece] >= 0 and owner[piece] != k:
                    return label, False
                owner[piece] = k
                met += 1
        if 2 * met < stops[k] - first:
            return label, False
    for at in range(len(runs)):
        label[at] = owner[label[at]]
    return label, True
