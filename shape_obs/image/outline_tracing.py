"""Trace the outlines of the components of a mask and of their holes, each border pixel once."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.image.connected_runs import find_root, label_runs

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]

SPECK: Final = 20  # pixels around a hole; shorter ones are noise
# Eight steps, anticlockwise as seen from the one to the right.
_RIGHT = np.array([1, 1, 0, -1, -1, -1, 0, 1])
_DOWN = np.array([0, -1, -1, -1, 0, 1, 1, 1])
_OUTER, _INNER = 4, 0  # where the background is at the first pixel of an outline, and of a hole's: a step


class Traced(NamedTuple):
    """What ``trace_components`` returns; borders run through the centres of border pixels.

    Args:
        outlines: ``(P, 2)`` image pixels, closed, 8-connected: the outlines of all components, end to end.
        stops: ``(Q,)`` where each outline ends.
        areas: ``(Q,)`` pixels of each component, without its holes.
        widths: ``(Q,)`` of the ribbons of these areas and outlines, pixels.
        holes: ``(H, 6)`` of each hole: its component, column and row of the first pixel of its border in the image,
            pixels of the border, its length, and the area that it encloses.
    """

    outlines: Array
    stops: Indices
    areas: Indices
    widths: Array
    holes: Array


@compiled("(u1[:,::1], i8[:,::1], i8, i8, i8)")
def trace_components(mask: Mask, runs: Indices, pieces: int, left: int, top: int) -> Any:
    """Trace the outlines of the components of a mask, and measure their holes.

    The time grows with the runs and the border pixels alone, however many components and holes there are.

    The width is the root w of ``w (s - w) = area``, s being half of what is around the component: the outline of an
    L x w ribbon runs through pixel centres, so it is 2 (L - 1) + 2 (w - 1) long. A ribbon that lies in a loop has a
    part of it around the hole.

    Args:
        mask: ``(h, w)`` uint8, C-contiguous, 0 = background.
        runs: ``(R, 3)`` its runs, image coordinates.
        pieces: How many components there are.
        left: Image column of its first pixel.
        top: Image row of its first pixel.

    Returns:
        The fields of ``Traced``: the components in the order of their first runs, each hole after those that begin
        above it.
    """
    label = np.zeros(len(runs), np.int64)
    if pieces > 1:
        label, _ = label_runs(runs)
    outlines, count, found = np.empty((1024, 2)), 0, 0
    stops, areas, around = np.empty(pieces, np.int64), np.zeros(pieces, np.int64), np.empty(pieces)  # (Q,)
    for at in range(len(runs)):
        if label[at] == found:
            outlines, count, length, _ = _follow(
                mask, runs[at, 1] - left, runs[at, 0] - top, _OUTER, left, top, outlines, count
            )
            stops[found], around[found] = count, length
            found += 1
        areas[label[at]] += runs[at, 2] - runs[at, 1]
    holes = np.empty((0, 6))
    if _touching(runs) > len(runs) - pieces:
        holes = _holes(mask, runs, label, left, top)
    widths = np.empty(pieces)
    for h in range(len(holes)):
        around[int(holes[h, 0])] += holes[h, 4] if holes[h, 3] >= SPECK else 0.0
    for q in range(pieces):
        half = around[q] / 2 + 2
        widths[q] = max((half - math.sqrt(max(half * half - 4 * areas[q], 0.0))) / 2, 1.0)
    return outlines[:count], stops, areas, widths, holes


@compiled("(u1[:,::1], i8, i8, i8, i8)")
def trace_hole(mask: Mask, column: int, row: int, left: int, top: int) -> Array:
    """Trace the border of the hole to the right of an image pixel of a mask: ``(P, 2)`` image pixels, closed."""
    found, count, _, _ = _follow(mask, column - left, row - top, _INNER, left, top, np.empty((1024, 2)), 0)
    return found[:count]


@compiled("(u1[:,::1], i8[:,::1], f8[:,::1], i8, i8, f8, f8)")
def fill_holes(mask: Mask, runs: Indices, holes: Array, left: int, top: int, pixels: float, width: float) -> int:
    """Fill the holes of a mask whose border has fewer pixels, or which are no wider on average; in place.

    Args:
        mask: ``(h, w)`` uint8, C-contiguous, 0 = background.
        runs: ``(R, 3)`` its runs, image coordinates.
        holes: ``(H, 6)`` its holes, see ``Traced``.
        left: Image column of its first pixel.
        top: Image row of its first pixel.
        pixels: Along the border; the mask has fewer around a hole that is filled.
        width: Pixels; twice the area over the length, on average, of a hole that is filled.

    Returns:
        How many holes are left.
    """
    if len(holes) == 0:
        return 0
    gaps, hole, _ = _gaps(runs)
    remaining = 0
    filled = np.zeros(len(holes), np.bool_)
    for h in range(len(holes)):
        filled[h] = holes[h, 3] < pixels or 2 * holes[h, 5] / holes[h, 3] - 1 <= width
        remaining += not filled[h]
    for g in range(len(gaps)):
        if hole[g] >= 0 and filled[hole[g]]:
            row, start, stop = gaps[g, 0] - top, gaps[g, 1] - left, gaps[g, 2] - left
            for column in range(start, stop):
                mask[row, column] = mask[row, start - 1]
    return remaining


@compiled
def _touching(runs: Indices) -> int:
    """Return how often runs touch one in the next row: R - Q times for Q components without holes, else more."""
    touching, above = 0, 0
    for at in range(len(runs)):
        row, start, stop = runs[at, 0], runs[at, 1], runs[at, 2]
        while runs[above, 0] < row - 1 or (runs[above, 0] == row - 1 and runs[above, 2] < start):
            above += 1
        other = above
        while runs[other, 0] == row - 1 and runs[other, 1] <= stop:
            touching += 1
            other += 1
    return touching


@compiled
def _holes(mask: Mask, runs: Indices, label: Indices, left: int, top: int) -> Array:
    """Return the holes as in ``Traced``."""
    gaps, hole, count = _gaps(runs)
    holes, found, at = np.empty((count, 6)), 0, 0
    scratch = np.empty((1024, 2))
    for g in range(len(gaps)):
        if hole[g] == found:
            row, start = gaps[g, 0], gaps[g, 1]
            while runs[at, 0] != row or runs[at, 2] != start:
                at += 1
            scratch, pixels, length, area = _follow(mask, start - 1 - left, row - top, _INNER, left, top, scratch, 0)
            holes[found, 0], holes[found, 1], holes[found, 2] = label[at], start - 1, row
            holes[found, 3], holes[found, 4], holes[found, 5] = pixels, length, area
            found += 1
    return holes


@compiled
def _gaps(runs: Indices) -> tuple[Indices, Indices, int]:
    """Return the gaps between runs of a row ``(G, 3)``, the hole of each, -1 outside, and how many holes there are.

    Gaps are connected where they share a column, as the background is where components are 8-connected. In the
    union-find gap g is element g + 1, and element 0 is the outside.
    """
    count = len(runs)
    gaps, found = np.empty((max(count - 1, 0), 3), np.int64), 0
    for at in range(1, count):
        if runs[at, 0] == runs[at - 1, 0]:
            gaps[found, 0], gaps[found, 1], gaps[found, 2] = runs[at, 0], runs[at - 1, 2], runs[at, 1]
            found += 1
    gaps = gaps[:found]
    root = np.arange(found + 1)
    first, before, gap_before, gap = 0, 0, 0, 0  # the first run of this row and of the one above, and their gaps
    while first < count:
        last = first
        while last + 1 < count and runs[last + 1, 0] == runs[first, 0]:
            last += 1
        above = before < first and runs[before, 0] == runs[first, 0] - 1
        below = last + 1 < count and runs[last + 1, 0] == runs[first, 0] + 1
        stop = gap + last - first
        if above:
            _join_rows(gaps, root, gap, stop, gap_before, gap, runs[before, 1], runs[first - 1, 2])
            _join_rows(gaps, root, gap_before, gap, gap, stop, runs[first, 1], runs[last, 2])
        if not above or not below:
            for g in range(gap, stop):
                root[find_root(root, g + 1)] = 0
        before, gap_before = first, gap
        first, gap = last + 1, stop
    hole, holes = np.full(found, -1), 0
    for g in range(found):
        least = find_root(root, g + 1) - 1
        if least == g:
            hole[g] = holes
            holes += 1
        elif least >= 0:
            hole[g] = hole[least]
    return gaps, hole, holes


@compiled
def _join_rows(
    gaps: Indices, root: Indices, first: int, last: int, other: int, stop: int, start: int, end: int
) -> None:
    """Join the gaps of a row to those of a neighbouring one, which has runs from ``start`` to ``end``."""
    for g in range(first, last):
        if gaps[g, 1] < start or gaps[g, 2] > end:
            root[find_root(root, g + 1)] = 0
        while other < stop and gaps[other, 2] <= gaps[g, 1]:
            other += 1
        here = other
        while here < stop and gaps[here, 1] < gaps[g, 2]:
            a, b = find_root(root, g + 1), find_root(root, here + 1)
            root[max(a, b)] = min(a, b)
            here += 1


@compiled
def _follow(
    mask: Mask, column: int, row: int, way: int, left: int, top: int, found: Array, count: int
) -> tuple[Array, int, float, float]:
    """Follow a border from a pixel of it; append its pixels, and return them, its length and what it encloses.

    Pixel by pixel with the background at one hand, in the order of S. Suzuki and K. Abe, "Topological Structural
    Analysis of Digitized Binary Images by Border Following", 1985, which is OpenCV's.

    Args:
        mask: ``(h, w)`` uint8, C-contiguous.
        column: Of the first pixel in the mask.
        row: Of the first pixel in the mask.
        way: The step from there to the background.
        left: Image column of the mask's first pixel.
        top: Image row of the mask's first pixel.
        found: ``(S, 2)`` image pixels; a larger array is returned where it is full.
        count: How many of them are taken.
    """
    height, width = mask.shape
    u, v, background, length, area = column, row, way, 0.0, 0
    last_u, last_v = column, row
    while True:
        way = (way - 1) & 7
        last_u, last_v = column + _RIGHT[way], row + _DOWN[way]
        if 0 <= last_u < width and 0 <= last_v < height and mask[last_v, last_u] != 0:
            break
        if way == background:  # a pixel on its own: where it came from is itself
            last_u, last_v = column, row
            break
    while True:
        if count == len(found):
            found = np.concatenate((found, np.empty_like(found)))
        found[count, 0], found[count, 1] = u + left, v + top
        count += 1
        if last_u == column and last_v == row:
            return found, count, 0.0, 0.0
        next_u, next_v = u, v
        for _ in range(8):
            way = (way + 1) & 7
            next_u, next_v = u + _RIGHT[way], v + _DOWN[way]
            if 0 <= next_u < width and 0 <= next_v < height and mask[next_v, next_u] != 0:
                break
        length += math.sqrt(2.0) if way & 1 else 1.0
        area += (u - column) * (next_v - row) - (v - row) * (next_u - column)
        if next_u == column and next_v == row and u == last_u and v == last_v:
            return found, count, length, abs(area) / 2
        u, v = next_u, next_v
        way = (way + 4) & 7
