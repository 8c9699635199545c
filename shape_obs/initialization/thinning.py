"""Thinning: a mask reduced to curves one pixel wide, and the smoothing of a ragged border before it.

Thinning after Guo and Hall, "Parallel Thinning with Two-Subiteration Algorithms", 1989.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled

Mask = npt.NDArray[np.uint8]
Indices = npt.NDArray[np.int64]

_SMOOTH: Final = 1.5  # cells, of a blur that keeps strands three cells apart and four wide; more joins them
_RAGGED: Final = 0.05  # share of the border that the blur moves by a cell if it is ragged; chosen on noisy masks


def _kept(*, west: bool) -> Mask:
    """Return ``(256,)`` 1 for neighbours (lowest bit above, then clockwise) that keep a pixel in one half of a pass."""
    n, ne, e, se, s, sw, w, nw = (np.arange(256) >> np.arange(8)[:, None] & 1).astype(bool)
    one, other = np.stack([ne | e, se | s, sw | w, nw | n]), np.stack([n | ne, e | se, s | sw, w | nw])
    pieces = np.sum(one & ~np.stack([n, e, s, w]), axis=0)
    count = np.minimum(one.sum(axis=0), other.sum(axis=0))
    side = (s | sw | ~nw) & w if west else (n | ne | ~se) & e
    return 1 - ((pieces == 1) & (count >= 2) & (count <= 3) & ~side).astype(np.uint8)


_KEPT: Final = np.stack([_kept(west=True), _kept(west=False)])


def smoothed(grid: Mask) -> Mask:
    """Return a framed mask without the hairs and notches of a ragged border, each of which would become a branch.

    A clean mask is returned as it is: a blur also fills the corners between strands that cross.
    """
    blurred = np.asarray(cv2.GaussianBlur(grid * np.uint8(255), (5, 5), _SMOOTH))
    smooth = np.ascontiguousarray(blurred > 127).view(np.uint8)
    smooth[[0, -1]] = smooth[:, [0, -1]] = 0
    border = np.count_nonzero(smooth[1:] != smooth[:-1]) + np.count_nonzero(smooth[:, 1:] != smooth[:, :-1])
    return smooth if np.count_nonzero(smooth != grid) > _RAGGED * border else grid


def thinned(mask: Mask) -> tuple[Mask, Indices]:
    """Return a mask of 0 and 1 with a border of 0, thinned to curves one pixel wide, and the flat places of those."""
    return thin_pixels(mask, np.flatnonzero(mask.view(np.bool_)))  # NumPy is much quicker for booleans


@compiled("(u1[:,::1], i8[::1])")
def thin_pixels(mask: Mask, pixels: Indices) -> tuple[Mask, Indices]:
    """Return a mask with a border of 0 that is thinned to curves one pixel wide, and the pixels that are left.

    Only pixels whose neighbours have changed are looked at again, so that the time grows with the pixels, however
    thick the mask is.

    Args:
        mask: ``(h, w)`` of 0 and 1.
        pixels: ``(P,)`` flat places where it is 1.
    """
    thin, across = mask.copy(), mask.shape[1]
    is_set = thin.reshape(-1)
    steps = (-across, 1 - across, 1, across + 1, across, across - 1, -1, -across - 1)
    around, is_waiting = np.empty(len(is_set), np.uint8), np.empty(len(is_set), np.uint8)  # a bit for each half pass
    waiting, count = np.empty((2, len(pixels)), np.int64), np.zeros(2, np.int64)
    for at in pixels:
        neighbours = 0
        for k in range(8):
            neighbours |= is_set[at + steps[k]] << k
        around[at], is_waiting[at] = neighbours, 0
        if neighbours < 255:
            is_waiting[at] = 3
            for half in range(2):
                waiting[half, count[half]] = at
                count[half] += 1
    gone, half = np.empty(len(pixels), np.int64), 0
    while count[0] + count[1] > 0:
        removed = 0
        for i in range(count[half]):
            at = waiting[half, i]
            is_waiting[at] &= 2 - half
            if is_set[at] and not _KEPT[half, around[at]]:
                gone[removed] = at
                removed += 1
        count[half] = 0
        for i in range(removed):
            is_set[gone[i]] = 0
        for i in range(removed):
            for k in range(8):
                other = gone[i] + steps[k]
                if is_set[other]:
                    around[other] &= ~(1 << (k + 4) % 8)  # the pixel that is gone lies on the other side of it
                    for each in range(2):
                        if not is_waiting[other] >> each & 1:
                            is_waiting[other] |= 1 << each
                            waiting[each, count[each]] = other
                            count[each] += 1
        half = 1 - half
    left = 0
    for at in pixels:
        if is_set[at]:
            gone[left] = at
            left += 1
    return thin, gone[:left]
