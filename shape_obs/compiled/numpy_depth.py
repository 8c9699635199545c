"""Depth under points of a mask, on NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from shape_obs.compiled.interface import FARTHEST, Array, Indices, Mask
from shape_obs.compiled.numpy_mask import around, nearest_pixels


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
    inside, z = _gathered(depth, mask, left, top, nearest_pixels(points), reach)
    z = z * unit
    valid = z > 0
    valid &= z < FARTHEST
    valid &= inside
    known = valid.sum(axis=1)
    enough = known >= np.maximum(min_share * inside.sum(axis=1), 1)
    np.copyto(z, np.inf, where=~valid)
    z.sort(axis=1)  # what is not known comes last
    start, values = np.arange(0, z.size, z.shape[1]), z.ravel()
    median = (values[start + (known - 1) // 2] + values[start + known // 2]) / 2
    return np.where(enough, median, np.nan).astype(np.float64)


def _gathered(
    depth: npt.NDArray[Any], mask: Mask, left: int, top: int, pixel: Indices, reach: int
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[Any]]:
    """Around each of (N,2) pixels: (N,S) whether the mask has a pixel there, (N,S) its depth."""
    (height, width), (u, v) = mask.shape, pixel.T
    column, row = u - left, v - top
    if (
        len(u)
        and reach <= min(column.min(), row.min())
        and column.max() < width - reach
        and row.max() < height - reach
        and depth.flags.c_contiguous
    ):
        inside = mask.ravel()[(row * width + column)[:, None] + around(width, reach)] != 0
        return inside, depth.ravel()[(v * depth.shape[1] + u)[:, None] + around(depth.shape[1], reach)]
    across, down = np.divmod(np.arange((2 * reach + 1) ** 2), 2 * reach + 1)[::-1]
    column, row = column[:, None] + (across - reach), row[:, None] + (down - reach)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    inside &= mask[row, column] != 0
    return inside, depth[np.where(inside, row + top, 0), np.where(inside, column + left, 0)]
