"""From pixels to metres: robust local depth under each point, and cells of pixels at one depth."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs.compiled import compiled
from shape_obs.frame import FARTHEST, MILLIMETRE, DepthImages, readable_depth
from shape_obs.geometry.curve import FittedCurve, FittedForm
from shape_obs.geometry.lattice import FittedLattice
from shape_obs.image.region import Region
from shape_obs.point_cloud.local_depth import MAX_REACH, MIN_SHARE, median, median_depth, room

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

SMEARED: Final = 2.5  # widths next to a hidden piece, in which depth may be that of what hides it
COMPARED: Final = 6.0  # widths within which the rope's own depth is looked for
_MOVED: Final = 0.13  # of its depth, by which a rope may come nearer or go away beyond what was predicted
_FEW: Final = 3.0  # times as many pixels as a strand behind has in a square: then it is none
_APART: Final = (2.0, 0.02)  # widths, and of the depth: strands that lie so far apart are not taken for each other
STEP: Final = 0.015  # metres: no rope on a table comes nearer by this much within a few widths


def form_depth(form: FittedForm, depth: npt.NDArray[Any], region: Region, width: float) -> Array:
    """Return ``(P,)`` metres under a form, NaN where it is not known or belongs to something that lies over it.

    Under a lattice every third row and column is read.

    Looks at the middle half of the object's width (13 pixels at most), so that a round rope's flanks do not pull the
    median down, and at mask pixels only, so that the table does not either. Where fewer than a quarter of these carry
    depth, a hole stays a hole.

    Args:
        form: ``(P, 2)`` pixels.
        depth: ``(H, W)`` the frame's depth.
        region: The mask.
        width: The object's width, pixels.
    """
    readable, unit = readable_depth(depth)
    left, top = region.window[:2]
    reach = min(max(round(width / 4), 1), MAX_REACH)
    points = np.ascontiguousarray(form.points, dtype=np.float64)
    where = readable, unit, region.mask, left, top
    if isinstance(form, FittedLattice):
        (rows, down), (cols, right) = _some(form.rows), _some(len(points) // form.rows)
        some = np.ascontiguousarray(form.lattice[np.ix_(rows, cols)].reshape(-1, 2))
        read = median_depth(*where, some, reach, MIN_SHARE, True)[0].reshape(len(rows), -1)
        known = np.isfinite(read)
        share = down @ known @ right.T
        z = down @ np.where(known, read, 0) @ right.T / np.maximum(share, 1e-9)
        return np.where(share > 0.5, z, np.nan).ravel()
    z, _ = median_depth(*where, points, reach, MIN_SHARE, not is_rope(form))
    if isinstance(form, FittedCurve) and not form.whole:
        z[form.interpolated | overlaid(form, z, width)] = np.nan
    return z


@lru_cache(maxsize=16)
def _some(count: int) -> tuple[npt.NDArray[np.int64], Array]:
    """Return every third row of ``count`` and the last, ``(S,)``, and how all follow from them, ``(count, S)``."""
    nodes = np.unique(np.append(np.arange(0, count, 3), count - 1))
    return nodes, np.stack([np.interp(np.arange(count), nodes, each) for each in np.eye(len(nodes))], axis=1)


def is_rope(form: FittedForm) -> bool:
    """Return whether a form is an open curve: the depth under it does not slope across it."""
    return isinstance(form, FittedCurve) and not form.closed


def lift_form(form: FittedForm, z: Array, intrinsics: Intrinsics) -> Array | None:
    """Return a whole form in space, for measuring distances in metres.

    Holes are bridged and the depth is smoothed over a few points (millimetre steps would make the form longer than it
    is); the points that leave the detector are lifted again.

    Args:
        form: ``(P, 2)`` pixels.
        z: ``(P,)`` metres, as ``form_depth`` gives them.
        intrinsics: The projection.

    Returns:
        ``(P, 3)`` metres, or None where less than half of the form has depth, or the lens has no ray to some of it.
    """
    known = np.isfinite(z)
    if known.mean() < 0.5:
        return None
    points = intrinsics.deproject(form.points, form.smoothed(z, known))
    return points if np.isfinite(points).all() else None


def overlaid(curve: FittedCurve, metres: Array, width: float) -> npt.NDArray[np.bool_]:
    """Return where the depth next to a hidden piece is that of what hides it, and not the curve's own.

    The camera's two eyes see past an edge differently, and depth is smeared there: it is compared with that of the
    curve a little further away.

    Args:
        curve: ``(P, D)`` pixels, with hidden pieces.
        metres: ``(P,)`` depth under it; NaN where it is not known.
        width: Of the rope, pixels.

    Returns:
        ``(P,)`` bool.
    """
    arc = curve.arc[: len(metres)]
    away = arc[:, None] - arc
    if curve.closed:
        away = (away + curve.size / 2) % curve.size - curve.size / 2
    apart = np.abs(away)
    nearby = apart[:, curve.interpolated].min(axis=1) <= SMEARED * width
    own = np.where(nearby | curve.interpolated, np.nan, metres)
    over = np.zeros(len(metres), bool)
    for at in np.flatnonzero(nearby & ~curve.interpolated & np.isfinite(metres)):
        near = (apart[at] <= COMPARED * width) & np.isfinite(own)
        if near.any():
            over[at] = metres[at] < nearest_expected(-away[at, near], own[near], 0.0) - STEP
        elif np.isfinite(own).any():
            over[at] = metres[at] < np.nanmedian(own) - STEP
    return over


@compiled("(f8[::1], f8[::1], f8)")
def nearest_expected(arc: Array, metres: Array, at: float) -> float:
    """Return the least depth that a rope may have at a place, by its depth a little further away.

    Args:
        arc: ``(K,)`` arc positions, pixels; at least one.
        metres: ``(K,)`` depth there.
        at: The place. The rope may go on as level as it is, or as steeply.
    """
    values = room(len(metres))
    for k in range(len(metres)):
        values[k] = metres[k]
    level, middle, mean = median(values, len(metres)), arc.mean(), metres.mean()
    spread = slope = 0.0
    for k in range(len(arc)):
        spread += (arc[k] - middle) ** 2
        slope += (arc[k] - middle) * (metres[k] - mean)
    return min(level, mean + slope / spread * (at - middle)) if spread > 0 else level


@compiled("(f8, f8)")
def strand_gap(width: float, focal: float) -> float:
    """Return by which share of its depth a strand of a rope lies apart from another.

    Args:
        width: Of the rope, pixels.
        focal: Focal length, pixels.
    """
    return max(_APART[0] * width / focal, _APART[1])


@compiled
def gather_lifted_cells(
    runs: Indices, edge: int, depth: DepthImages, focal: float, width: float, expected: Array
) -> tuple[Array, Array]:
    """Gather the pixels of ``(R, 3)`` runs into squares, those of two strands at unlike depths apart.

    Args:
        runs: Of a mask; at least one.
        edge: Of the squares, pixels.
        depth: The frame's, see ``frame.depth_images``.
        focal: Focal length, pixels.
        width: Of the rope, pixels.
        expected: ``(K, 3)`` pixels and relief where the rope should be: what lies far from all of it in depth is not
            the rope's, and a square without depth takes the relief of the nearest of them.

    Returns:
        ``(M, 3)`` centroids, pixels and relief; ``(M,)`` counts.
    """
    (millimetres, metric), low, high = depth, np.inf, -np.inf
    for k in range(len(expected)):
        low, high = min(low, expected[k, 2]), max(high, expected[k, 2])
    low, high = math.exp(low / focal - _MOVED), min(math.exp(high / focal + _MOVED), FARTHEST)
    left, right, most = runs[0, 1], runs[0, 2], 0
    for at in range(len(runs)):
        left, right = min(left, runs[at, 1]), max(right, runs[at, 2])
        most += (runs[at, 2] - runs[at, 1]) // edge + 2
    top, left = runs[0, 0] // edge, left // edge
    across = (right - 1) // edge - left + 1
    places = np.full((runs[-1, 0] // edge - top + 1) * across, -1, np.int32)
    # Of each square: pixels, sums of columns and rows, pixels with depth, sum of their depth, the least and the most.
    sums, held, behind, apart = np.empty((2 * most, 7)), 0, math.exp(strand_gap(width, focal)), False
    for at in range(len(runs)):
        row, column, base = runs[at, 0], runs[at, 1], (runs[at, 0] // edge - top) * across - left
        cell = column // edge
        while column < runs[at, 2]:
            into, stop = places[base + cell], min((cell + 1) * edge, runs[at, 2])
            if into < 0:
                _clear(sums[held])
                places[base + cell] = into = held
                held += 1
            near, far, known, total = sums[into, 5], sums[into, 6], 0.0, 0.0
            for k in range(column, stop):
                metres = millimetres[row, k] * MILLIMETRE if len(millimetres) > 0 else float(metric[row, k])
                if low < metres < high:
                    near, far, known, total = min(near, metres), max(far, metres), known + 1, total + metres
            sums[into, 5], sums[into, 6], apart = near, far, apart or far > behind * near
            _add(sums[into], row, column, stop, known, total)
            column, cell = stop, cell + 1
    if apart:
        held = _part_strands(runs, edge, depth, (low, high), behind, top, left, across, places, sums, held)
    points, weight, at = np.empty((held, 3)), np.empty(held), 0
    for into in range(held):
        count = sums[into, 0]
        if count == 0:
            continue
        u, v = sums[into, 1] / count, sums[into, 2] / count
        points[at, 0], points[at, 1], weight[at] = u, v, count
        if sums[into, 3] > 0:
            points[at, 2] = focal * math.log(sums[into, 4] / sums[into, 3])
        else:
            points[at, 2] = expected[_nearest_in_image(u, v, expected), 2]
        at += 1
    return points[:at], weight[:at]


@compiled
def _clear(sums: Array) -> None:
    for k in range(7):
        sums[k] = 0.0
    sums[5] = np.inf


@compiled
def _add(sums: Array, row: int, start: int, stop: int, known: float, metres: float) -> None:
    """Add pixels of one row to a square's sums, and the depth of those where it is known."""
    count = float(stop - start)
    sums[0], sums[1], sums[2] = sums[0] + count, sums[1] + count * (start + stop - 1) / 2, sums[2] + count * row
    sums[3], sums[4] = sums[3] + known, sums[4] + metres


@compiled
def _part_strands(
    runs: Indices, edge: int, depth: DepthImages, limits: tuple[float, float], behind: float,
    top: int, left: int, across: int, places: npt.NDArray[np.int32], sums: Array, held: int,
) -> int:  # fmt: skip
    """Give the strand behind another in a square sums of its own; return how many there are then."""
    (millimetres, metric), count, other = depth, held, np.full(held, -1, np.int64)
    for into in range(held):
        if sums[into, 6] > behind * sums[into, 5]:
            near = sums[into, 5]
            other[into] = count
            _clear(sums[count])
            _clear(sums[into])
            sums[into, 5], count = near, count + 1
    for at in range(len(runs)):
        row, base = runs[at, 0], (runs[at, 0] // edge - top) * across - left
        for column in range(runs[at, 1], runs[at, 2]):
            into = places[base + column // edge]
            if other[into] >= 0:
                metres = millimetres[row, column] * MILLIMETRE if len(millimetres) > 0 else float(metric[row, column])
                known = limits[0] < metres < limits[1]
                far = known and metres > behind * sums[into, 5]
                _add(
                    sums[other[into] if far else into], row, column, column + 1, 1.0 if known else 0.0,
                    metres if known else 0.0,
                )  # fmt: skip
    for into in range(held):
        if other[into] >= 0 and _FEW * sums[other[into], 0] < sums[into, 0]:  # the table next to the rope
            for k in range(3):
                sums[into, k] += sums[other[into], k]
                sums[other[into], k] = 0.0
    return count


@compiled
def _nearest_in_image(u: float, v: float, nodes: Array) -> int:
    """Return which of ``(K, 3)`` nodes lies nearest to a pixel in the image."""
    best, least = 0, np.inf
    for k in range(len(nodes)):
        square = (nodes[k, 0] - u) ** 2 + (nodes[k, 1] - v) ** 2
        if square < least:
            best, least = k, square
    return best
