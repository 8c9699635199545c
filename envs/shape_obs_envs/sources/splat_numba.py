"""The inner loop of ``Splat`` on Numba: the same sums in the same order as there, so the same pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

_HALF = np.float32(0.5)
_ZERO, _ONE = np.float32(0), np.float32(1)
_NOTHING = np.uint16(65535)
_LARGEST = np.float32(65535)


@njit(cache=True, nogil=True, error_model="numpy")
def splat(
    metres: npt.NDArray[np.float32],
    rays: npt.NDArray[np.float32],
    shift: npt.NDArray[np.float32],
    scale: Any,
    margin: Any,
    height: int,
    width: int,
) -> npt.NDArray[np.uint16]:
    """Carry a depth image (H,W) in metres over to an image of height x width; see ``Splat``."""
    out = np.full((height, width), _NOTHING)
    columns = metres.shape[1]
    value = np.empty(columns, np.uint16)
    left, right = np.empty(columns, np.int32), np.empty(columns, np.int32)
    top, bottom = np.empty(columns, np.int32), np.empty(columns, np.int32)
    a, b, c = shift[0], shift[1], shift[2]
    high, wide = np.float32(height), np.float32(width)
    for row in range(metres.shape[0]):
        for i in range(columns):  # no branches, so that the compiler takes several pixels at once
            z = metres[row, i]
            begin = z * rays[2, row, i] + c
            end = z * rays[2, row + 1, i + 1] + c
            near = np.floor((begin + end) * _HALF * scale + _HALF)
            known = (z > _ZERO) & (near >= _ONE) & (near < _LARGEST)
            x0 = np.ceil((z * rays[0, row, i] + a) / begin - margin)
            x1 = np.ceil((z * rays[0, row + 1, i + 1] + a) / end + margin)
            y0 = np.ceil((z * rays[1, row, i] + b) / begin - margin)
            y1 = np.ceil((z * rays[1, row + 1, i + 1] + b) / end + margin)
            # Within the image; comparisons this way round make what is no number an empty footprint.
            x0, y0 = x0 if x0 < wide else wide, y0 if y0 < high else high
            x1, y1 = x1 if x1 > _ZERO else _ZERO, y1 if y1 > _ZERO else _ZERO
            left[i] = np.int32(x0 if x0 > _ZERO else _ZERO)
            top[i] = np.int32(y0 if y0 > _ZERO else _ZERO)
            right[i] = np.int32((x1 if x1 < wide else wide) if known else _ZERO)
            bottom[i] = np.int32(y1 if y1 < high else high)
            value[i] = np.uint16(near if known else _ZERO)
        for i in range(columns):
            for v in range(top[i], bottom[i]):
                for u in range(left[i], right[i]):
                    if value[i] < out[v, u]:
                        out[v, u] = value[i]
    for v in range(height):
        for u in range(width):
            if out[v, u] == _NOTHING:
                out[v, u] = 0
    return out
