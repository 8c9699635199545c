"""Masks as rows of pixels, on NumPy: cells, look-ups."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.compiled.interface import FAR_OFF, Array, Indices, Mask
from shape_obs.compiled.numpy_pieces import pieces


def survey(
    mask: Mask, left: int, top: int, min_area: float, min_share: float
) -> tuple[Indices, Indices, tuple[int, int, int, int], bool]:
    """See ``Kernels.survey``."""
    u, v, width, height = cv2.boundingRect(mask)
    if not width:
        return np.empty((0, 3), np.intp), np.empty(0, np.intp), (left, top, 0, 0), False
    crop, left, top = mask[v : v + height, u : u + width], left + u, top + v
    found = _runs(crop, left, top)
    lengths = found[:, 2] - found[:, 1]
    if _is_one_piece(found, crop):  # nothing to sort out, as on most frames
        label, count, areas = None, 1, lengths.sum(keepdims=True)
    else:
        label, count = pieces(found)
        areas = np.bincount(label, lengths, count).astype(np.int64)
    keep = areas >= max(min_area, min_share * int(areas.max()))
    kept = -np.sort(-areas[keep])
    if len(kept) == count:
        return found, kept, (left, top, width, height), False
    found = found[:0] if label is None else found[keep[label]]
    if not len(found):
        return found, kept, (left - u, top - v, 0, 0), True
    left, top = int(found[:, 1].min()), int(found[0, 0])
    return found, kept, (left, top, int(found[:, 2].max()) - left, int(found[-1, 0]) - top + 1), True


def _is_one_piece(runs: Indices, crop: Mask) -> bool:
    """Whether the pixels of a mask hang together; seen at once where there is one run in each row."""
    if len(runs) == len(crop):
        _, start, stop = runs.T
        if bool(((start[1:] <= stop[:-1]) & (start[:-1] <= stop[1:])).all()):
            return True
    # Of what lies in a hole, the contour is an outer one too.
    table = cv2.findContours(crop, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)[1]
    return np.count_nonzero(np.asarray(table).reshape(-1, 4)[:, 3] < 0) == 1


def _runs(mask: npt.NDArray[Any], left: int, top: int) -> Indices:
    """The rows of pixels of a mask."""
    height, width = mask.shape
    framed = np.zeros((height, width + 2), bool)  # every run has a pixel before and behind it
    np.not_equal(mask, 0, out=framed[:, 1:-1])
    flat = framed.ravel()
    edges = (flat[1:] != flat[:-1]).nonzero()[0]
    found = np.empty((len(edges) // 2, 3), np.int64)
    begin = edges[::2]
    np.divmod(begin, width + 2, out=(found[:, 0], found[:, 1]))
    np.add(found[:, 1], edges[1::2] - begin, out=found[:, 2])
    found += (top, left, left)
    return found


def cells(runs: Indices, size: int) -> tuple[Array, Array]:
    """See ``Kernels.cells``."""
    if not len(runs):
        return np.empty((0, 2)), np.empty(0)
    row, start, stop = runs.T.copy()
    first, last, down = start // size, (stop - 1) // size, row // size
    pieces = last - first + 1
    past = pieces.cumsum()
    # Runs are cut where they pass from one column of cells to the next.
    run = np.arange(len(row)).repeat(pieces)
    column = np.arange(len(run)) + (first - past + pieces)[run]
    begin = column * size
    end = begin + size
    begin[past - pieces], end[past - 1] = start, stop
    count = (end - begin).astype(np.float64)
    left = int(first.min())
    cell = column + ((down - down[0]) * (int(last.max()) - left + 1) - left)[run]
    number = np.bincount(cell, count)
    held = number.nonzero()[0]
    weight, points = number[held].astype(np.float64), np.empty((len(held), 2))
    np.divide(np.bincount(cell, (begin + end - 1) * count)[held], 2 * weight, out=points[:, 0])
    np.divide(np.bincount(cell, row[run] * count)[held], weight, out=points[:, 1])
    return points, weight


def nearest_pixels(points: Array) -> npt.NDArray[np.intp]:
    """Return the pixels nearest to (N,2) points; one off every image for NaN and for what no integer can hold."""
    return np.rint(np.fmin(np.fmax(points, -FAR_OFF), FAR_OFF)).astype(np.intp)


def carried(mask: Mask, left: int, top: int, points: Array, reach: int) -> npt.NDArray[np.bool_]:
    """See ``Kernels.carried``."""
    pixel = nearest_pixels(points)
    u, v = pixel[:, 0] - left, pixel[:, 1] - top
    height, width = mask.shape
    if len(u) and reach <= min(u.min(), v.min()) and u.max() < width - reach and v.max() < height - reach:
        flat, place = mask.ravel(), v * width + u
        on = flat[place] != 0
        off = (~on).nonzero()[0]
        if len(off):  # few are off, and only those have to look around
            on[off] = flat[place[off, None] + around(width, reach)].any(axis=1)
        return on
    beside = np.arange(-reach, reach + 1)
    u, v = u[:, None, None] + beside, v[:, None, None] + beside[:, None]
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    return np.asarray((inside & (mask[np.where(inside, v, 0), np.where(inside, u, 0)] > 0)).any(axis=(1, 2)))


@lru_cache
def around(width: int, reach: int) -> Indices:
    """How far the pixels around one lie from it in an image of this width."""
    at = np.arange(-reach, reach + 1)
    return (at[:, None] * width + at).ravel()
