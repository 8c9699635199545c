"""Tell the strands of a rope apart by their depth, where the mask shows them in one place."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.frame import FARTHEST, DepthImages, metres_at, unit_of
from shape_obs.image.connected_runs import nearest_pixel
from shape_obs.point_cloud.local_depth import MIN_SHARE, SPARSE, median, room

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]

_U = np.uint64  # unsigned indices are not checked for being negative
_MOVED: Final = 0.13  # of its depth, by which a rope may come nearer or go away beyond what was predicted
_FEW: Final = 3.0  # times as many pixels as a strand behind has in a square: then it is none
_APART: Final = (2.0, 0.02)  # widths, and of the depth: strands that lie so far apart are not taken for each other


@compiled
def strand_gap(width: float, focal: float) -> float:
    """Return by which share of its depth a strand of a rope lies apart from another.

    Args:
        width: Of the rope, pixels.
        focal: Focal length, pixels.
    """
    return max(_APART[0] * width / focal, _APART[1])


@compiled
def strand_depth(
    depth: DepthImages,
    mask: Mask,
    at: tuple[int, int],
    points: Array,
    reach: int,
    expected: Array,
    slack: float,
) -> tuple[Array, Array]:
    """Return the median depth of the mask around each point, of what lies where it is expected, and its mean place.

    From a reach of four pixels on, every second pixel is read, as on a chessboard. Depth is NaN where nothing is
    known; where nothing is expected, also where less than a quarter of the pixels have depth.

    Args:
        depth: The frame's, see ``frame.depth_images``.
        mask: ``(h, w)`` uint8, C-contiguous.
        at: Image column and row of its first pixel.
        points: ``(P, 2)`` image pixels.
        reach: How far around a point is looked, pixels.
        expected: ``(P,)`` metres, or ``(0,)``.
        slack: By which share a depth may differ from that.

    Returns:
        ``(P,)`` metres; ``(P, 2)`` image pixels.
    """
    (height, width), step, (millimetres, metric) = mask.shape, 2 if reach >= SPARSE else 1, depth
    near, whole, unit = room((2 * reach + 1) ** 2), len(millimetres) > 0, unit_of(depth)
    out, places = np.empty(len(points)), np.empty_like(points)
    for n in range(len(points)):
        low, high, share = 0.0, FARTHEST / unit, MIN_SHARE
        if len(expected) > 0:
            low, high, share = expected[n] * (1 - slack) / unit, expected[n] * (1 + slack) / unit, 0.0
        column, row = nearest_pixel(points[n, 0]) - at[0], nearest_pixel(points[n, 1]) - at[1]
        known, inside, x, y = 0, 0, 0, 0
        for v in range(max(row - reach, 0), min(row + reach + 1, height)):
            first, before = column - reach + (v - row + reach & 1) * (step - 1), known
            while first < 0:
                first += step
            for u in range(first, min(column + reach + 1, width), step):  # what is not wanted is overwritten
                on, i, j = mask[_U(v), _U(u)] != 0, _U(v + at[1]), _U(u + at[0])
                z = np.float32(millimetres[i, j]) if whole else metric[i, j]
                near[_U(known)] = z
                wanted = on and low < z and z < high
                inside, x, known = inside + on, x + (u if wanted else 0), known + wanted
            y += v * (known - before)
        out[n] = np.nan
        if known >= max(share * inside, 1):
            out[n] = median(near, int(known)) * unit
            places[n, 0], places[n, 1] = at[0] + x / known, at[1] + y / known
    return out, places


@compiled
def strand_under(
    depth: DepthImages, mask: Mask, at: tuple[int, int], points: Array, reach: int, expected: Array, slack: float
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Return whether the depth around points of a strand is known, and whether most of it is another's in front.

    Args:
        depth: The frame's, see ``frame.depth_images``.
        mask: ``(h, w)`` uint8, C-contiguous.
        at: Image column and row of its first pixel.
        points: ``(N, 2)`` image pixels.
        reach: How far around a point is looked, pixels.
        expected: ``(N,)`` depth of the strand, metres.
        slack: By which share another strand is nearer, at least.
    """
    height, width = mask.shape
    seen, under = np.zeros(len(points), np.bool_), np.zeros(len(points), np.bool_)
    for n in range(len(points)):
        column, row = nearest_pixel(points[n, 0]) - at[0], nearest_pixel(points[n, 1]) - at[1]
        inside = known = nearer = 0
        for v in range(max(row - reach, 0), min(row + reach + 1, height)):
            for u in range(max(column - reach, 0), min(column + reach + 1, width)):
                if mask[v, u] == 0:
                    continue
                z = metres_at(depth, v + at[1], u + at[0])
                inside += 1
                known += 0 < z < FARTHEST
                nearer += 0 < z < expected[n] * (1 - slack)
        seen[n], under[n] = known >= max(MIN_SHARE * inside, 1), 2 * nearer > known
    return seen, under


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
        expected: ``(K, 3)`` pixels and log-depth where the rope should be: what lies far from all of it in depth is not
            the rope's, and a square without depth takes the log-depth of the nearest of them.

    Returns:
        ``(M, 3)`` centroids, pixels and log-depth; ``(M,)`` counts.
    """
    low, high = np.inf, -np.inf
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
                metres = metres_at(depth, row, k)
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
    count, other = held, np.full(held, -1, np.int64)
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
                metres = metres_at(depth, row, column)
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
