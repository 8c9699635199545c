"""Outlines of masks on Numba."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from shape_obs.compiled import numpy_outline
from shape_obs.compiled.interface_outline import Array, Box, Indices, Mask

# Eight steps, anticlockwise as seen from the one to the right.
_RIGHT = np.array([1, 1, 0, -1, -1, -1, 0, 1])
_DOWN = np.array([0, -1, -1, -1, 0, 1, 1, 1])


def traced(mask: Mask, runs: Indices, left: int, top: int, box: Box) -> tuple[Array, float, float]:
    """See ``OutlineKernels.traced``; masks with holes are left to OpenCV."""
    if has_holes(runs):
        return numpy_outline.traced(mask, runs, left, top, box)
    outline, length = followed_border(mask, runs[0, 1] - left, runs[0, 0] - top, left, top)
    return outline, length, 0.0


@njit(cache=True, nogil=True)
def has_holes(runs: Indices) -> bool:
    """Whether a piece of (R,3) rows of pixels has holes: it has as many as rows touch more often than R - 1 times."""
    touching, above = 0, 0
    for at in range(len(runs)):
        row, start, stop = runs[at, 0], runs[at, 1], runs[at, 2]
        while runs[above, 0] < row - 1 or (runs[above, 0] == row - 1 and runs[above, 2] < start):
            above += 1
        other = above
        while runs[other, 0] == row - 1 and runs[other, 1] <= stop:
            touching += 1
            other += 1
    return touching > len(runs) - 1


@njit(cache=True, nogil=True)
def followed_border(mask: Mask, column: int, row: int, left: int, top: int) -> tuple[Array, float]:
    """The outer border of the piece whose first pixel is given, and its length.

    Pixel by pixel with the background at one hand, in the order of S. Suzuki and K. Abe, "Topological Structural
    Analysis of Digitized Binary Images by Border Following", 1985, which is OpenCV's.
    """
    height, width = mask.shape
    found, count = np.empty((1024, 2)), 0
    u, v, way, length = column, row, 4, 0.0
    last_u, last_v = column, row
    while True:
        way = (way - 1) % 8
        last_u, last_v = column + _RIGHT[way], row + _DOWN[way]
        if 0 <= last_u < width and 0 <= last_v < height and mask[last_v, last_u] != 0:
            break
        if way == 4:  # a pixel on its own
            found[0, 0], found[0, 1] = column + left, row + top
            return found[:1].copy(), 0.0
    while True:
        if count == len(found):
            larger = np.empty((2 * count, 2))
            for at in range(count):
                larger[at, 0], larger[at, 1] = found[at, 0], found[at, 1]
            found = larger
        found[count, 0], found[count, 1] = u + left, v + top
        count += 1
        next_u, next_v = u, v
        for _ in range(8):
            way = (way + 1) % 8
            next_u, next_v = u + _RIGHT[way], v + _DOWN[way]
            if 0 <= next_u < width and 0 <= next_v < height and mask[next_v, next_u] != 0:
                break
        length += math.sqrt(2.0) if way % 2 else 1.0
        if next_u == column and next_v == row and u == last_u and v == last_v:
            return found[:count].copy(), length
        u, v = next_u, next_v
        way = (way + 4) % 8
