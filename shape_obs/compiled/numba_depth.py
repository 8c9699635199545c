"""Depth under points of a mask, on Numba."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from shape_obs.compiled.interface import FARTHEST, Array, Mask
from shape_obs.compiled.numba_mask import nearest_pixel


@njit(cache=True, nogil=True)
def _select(values: Array, count: int, place: int) -> float:
    """The value at a place of ``count`` values in order, which are left partly in order (C. A. R. Hoare, 1961)."""
    low, high = 0, count - 1
    while low < high:
        pivot, i, j = values[(low + high) // 2], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if place <= j:
            high = j
        elif place >= i:
            low = i
        else:
            break
    return values[place]


@njit(cache=True, nogil=True)
def median_depth(
    depth: npt.NDArray[Any],
    unit: float,
    mask: Mask,
    left: int,
    top: int,
    points: Array,
    reach: int,
    min_share: float,
) -> Array:
    """See ``Kernels.median_depth``."""
    height, width = mask.shape
    out, near = np.full(len(points), np.nan), np.empty((2 * reach + 1) ** 2)
    for n in range(len(points)):
        column, row = nearest_pixel(points[n, 0]) - left, nearest_pixel(points[n, 1]) - top
        inside = known = 0
        for v in range(max(row - reach, 0), min(row + reach + 1, height)):
            for u in range(max(column - reach, 0), min(column + reach + 1, width)):
                if mask[v, u] != 0:
                    inside += 1
                    z = depth[v + top, u + left] * unit
                    if 0 < z < FARTHEST:
                        near[known] = z
                        known += 1
        if known >= max(min_share * inside, 1):
            upper = _select(near, known, known // 2)
            lower = upper
            if known % 2 == 0:
                lower = near[0]
                for k in range(1, known // 2):
                    lower = max(lower, near[k])
            out[n] = (lower + upper) / 2
    return out
