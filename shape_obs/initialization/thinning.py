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

# Blur of a mask before it is thinned, cells. Strands three cells apart stay apart, and four cells wide they stay.
_SMOOTH: Final = 1.2
_RAGGED: Final = 0.05  # of the border that the blur moves by a cell: at least so much is ragged


def _kept(half: int) -> Mask:
    """Return ``(256,)`` 1 for neighbours (lowest bit above, then clockwise) that keep a pixel in half a pass."""
    n, ne, e, se, s, sw, w, nw = (np.arange(256) >> np.arange(8)[:, None] & 1).astype(bool)
    one, other = np.stack([ne | e, se | s, sw | w, nw | n]), np.stack([n | ne, e | se, s | sw, w | nw])
    pieces = np.sum(one & ~np.stack([n, e, s, w]), axis=0)
    count = np.minimum(one.sum(axis=0), other.sum(axis=0))
    side = (s | sw | ~nw) & w if half == 0 else (n | ne | ~se) & e
    return 1 - ((pieces == 1) & (count >= 2) & (count <= 3) & ~side).astype(np.uint8)


_KEPT: Final = np.stack([_kept(0), _kept(1)])


def smoothed(grid: Mask) -> Mask:
    """Return a framed mask without the hairs and notches of a ragged border, each of which would become a branch.

    A clean mask is returned as it is: a blur also fills the corners between strands that cross.
    """
    blurred = np.asarray(cv2.GaussianBlur(grid * np.uint8(255), (0, 0), _SMOOTH))
    smooth = np.ascontiguousarray(blurred > 127).view(np.uint8)
    smooth[[0, -1]] = smooth[:, [0, -1]] = 0
    border = np.count_nonzero(smooth[1:] != smooth[:-1]) + np.count_nonzero(smooth[:, 1:] != smooth[:, :-1])
    return smooth if np.count_nonzero(smooth != grid) > _RAGGED * border else grid


@compiled("(u1[:,::1],)")
def thinned(mask: Mask) -> Mask:
    """Return a mask of 0 and 1 with a border of 0, thinned to curves one pixel wide: ``(h, w)`` uint8.

    Only pixels whose neighbours have changed are looked at again, so that the time grows with the pixels, however
    thick the mask is.
    """
    thin, across = mask.copy(), mask.shape[1]
    is_set = thin.reshape(-1)
    steps = (-across, 1 - across, 1, across + 1, across, across - 1, -1, -across - 1)
    pixels = np.flatnonzero(is_set)
    waiting, count = np.stack((pixels, pixels)), np.full(2, len(pixels))
    is_waiting = np.zeros((2, len(is_set)), np.bool_)
    for at in pixels:
        is_waiting[0, at] = is_waiting[1, at] = True
    gone, half = np.empty(len(pixels), np.int64), 0
    while count[0] + count[1] > 0:
        removed = 0
        for i in range(count[half]):
            at = waiting[half, i]
            is_waiting[half, at] = False
            if is_set[at]:
                around = 0
                for k in range(8):
                    around |= is_set[at + steps[k]] << k
                if not _KEPT[half, around]:
                    gone[removed] = at
                    removed += 1
        count[half] = 0
        for i in range(removed):
            is_set[gone[i]] = 0
        for i in range(removed):
            for k in range(8):
                other = gone[i] + steps[k]
                for each in range(2):
                    if is_set[other] and not is_waiting[each, other]:
                        is_waiting[each, other] = True
                        waiting[each, count[each]] = other
                        count[each] += 1
        half = 1 - half
    return thin
