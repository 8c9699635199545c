"""Points on the outline of a flat object and on a sheet in an image, with all that a shape holds of them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.configurations.points_in_image import WHERE_TYPES, Seen, nothing_seen, seen_points
from shape_obs.frame import DepthImages
from shape_obs.geometry.lattice import sample_lattice
from shape_obs.geometry.polyline import MAX_SHIFT_AROUND, arc_length, closed, equal_chords
from shape_obs.tracking.belief import Shares
from shape_obs.tracking.registration import follow_outline

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]


@compiled("(f8[:,::1], f8[::1], f8[:,::1], i8)")
def points_around(points: Array, arc: Array, metric: Array, count: int) -> Array:
    """Return ``count`` points of a closed curve with equal chords in a metric, from its first point."""
    around = closed(metric)
    places, _ = equal_chords(closed(points), arc, around, arc_length(around), count + 1, 0.0, MAX_SHIFT_AROUND)
    return places[:count]


@compiled("(f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], i8, b1, " + WHERE_TYPES + ")")
def follow_ring(
    points: Array, space: Array, reference: Array, predicted: Array, count: int, in_metres: bool, depth: DepthImages,
    mask: Mask, at: tuple[int, int], width: float, lens: Array, radius: float, edges: Indices, across: int,
    shares: Shares, columns: int, diagonal: float,
) -> tuple[tuple[Array, Array, Array, Array, Array, float, bool], Seen]:  # fmt: skip
    """Run ``follow_outline`` and lay ``count`` points on the outline, with equal gaps in the image or in space.

    Returns:
        What ``follow_outline`` returns, and ``seen_points``; no points if some are not measured.
    """
    found = follow_outline(points, space, reference, predicted)
    curve, there, arc, measured = found[0], found[1], found[2], len(found[1]) > 0
    if in_metres and not measured and len(lens) > 0:
        return found, nothing_seen()
    places = points_around(curve, arc, there if in_metres and measured else curve, count)
    return found, _if_all_measured(
        places, arc[-1], depth, mask, at, width, lens, radius, edges, across, shares, columns, diagonal
    )


@compiled("(f8[:,::1], f8[::1], f8[::1], i8, i8, b1, " + WHERE_TYPES + ")")
def sheet_points(
    lattice: Array, down: Array, right: Array, rows: int, cols: int, centers: bool, depth: DepthImages, mask: Mask,
    at: tuple[int, int], width: float, lens: Array, radius: float, edges: Indices, across: int, shares: Shares,
    columns: int, diagonal: float,
) -> Seen:  # fmt: skip
    """Run ``sample_lattice`` and ``seen_points`` on a sheet; return none if depth is missing at some points."""
    fine = lattice.reshape(len(down), len(right), 2)
    places, size = sample_lattice(fine, down, right, rows, cols, centers), down[-1] + right[-1]
    return _if_all_measured(
        places, size, depth, mask, at, width, lens, radius, edges, across, shares, columns, diagonal
    )


@compiled
def _if_all_measured(
    places: Array, size: float, depth: DepthImages, mask: Mask, at: tuple[int, int], width: float, lens: Array,
    radius: float, edges: Indices, across: int, shares: Shares, columns: int, diagonal: float,
) -> Seen:  # fmt: skip
    """Return ``seen_points`` of points whose depth is their own; none if some have none: theirs is filled in."""
    none = np.empty(0)
    seen = seen_points(
        places, none, none, False, size, depth, mask, at, width, lens, radius, edges, across, shares, columns,
        diagonal,
    )  # fmt: skip
    return seen if len(lens) == 0 or seen[3].all() else nothing_seen()
