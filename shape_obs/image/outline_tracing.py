"""Trace the outline of a component of a mask, pixel by pixel."""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]

SPECK: Final = 20  # pixels around a hole; shorter ones are noise
# Eight steps, anticlockwise as seen from the one to the right.
_RIGHT = np.array([1, 1, 0, -1, -1, -1, 0, 1])
_DOWN = np.array([0, -1, -1, -1, 0, 1, 1, 1])


def trace_with_holes(mask: Mask, left: int, top: int) -> tuple[Array, float, float]:
    """Trace the outline of a component that fills its mask, and measure its holes, with OpenCV.

    Returns:
        The outline and its length as ``trace_outline`` returns them, and the length of the outlines of the holes,
        pixels, specks left out.
    """
    contours, table = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    parents = np.asarray(table).reshape(-1, 4)[:, 3].tolist()
    outline = np.asarray(contours[parents.index(-1)]).reshape(-1, 2) + (float(left), float(top))
    inner = [hole for hole, parent in zip(contours, parents, strict=True) if parent >= 0 and len(hole) >= SPECK]
    length = float(np.hypot(*(outline - np.roll(outline, 1, axis=0)).T).sum())
    return outline, length, sum(cv2.arcLength(hole, closed=True) for hole in inner)


@compiled
def has_holes(runs: Indices) -> bool:
    """Return whether a component of ``(R, 3)`` runs has holes: then runs touch more often than R - 1 times."""
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


@compiled
def follow_border(mask: Mask, column: int, row: int, left: int, top: int) -> tuple[Array, float]:
    """Follow the outer border of the component whose first pixel is given; return its pixels and its length.

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
            return found[:1], 0.0
    while True:
        if count == len(found):
            found = np.concatenate((found, np.empty_like(found)))
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
            return found[:count], length
        u, v = next_u, next_v
        way = (way + 4) % 8
