"""Depth under points of a mask, on NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from shape_obs.kernels.interface import FARTHEST, Array, Mask


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
    offsets = np.arange(-reach, reach + 1)
    pixel = np.rint(points).astype(np.intp)
    u, v = pixel[:, :1] + np.tile(offsets, len(offsets)), pixel[:, 1:] + np.repeat(offsets, len(offsets))
    column, row = u - left, v - top
    inside = (column >= 0) & (column < mask.shape[1]) & (row >= 0) & (row < mask.shape[0])
    if inside.all():
        inside = mask[row, column] != 0
    else:
        inside &= mask[np.where(inside, row, 0), np.where(inside, column, 0)] != 0
        u, v = np.where(inside, u, 0), np.where(inside, v, 0)
    z = depth[v, u] * unit
    z[~(inside & (z > 0) & (z < FARTHEST))] = np.nan
    known = len(offsets) ** 2 - np.count_nonzero(np.isnan(z), axis=1)
    enough = known >= np.maximum(min_share * np.count_nonzero(inside, axis=1), 1)
    out = np.full(len(points), np.nan)
    if enough.any():
        z = np.sort(z[enough], axis=1)  # what is not known comes last
        rows, known = np.arange(len(z)), known[enough]
        out[enough] = (z[rows, (known - 1) // 2] + z[rows, known // 2]) / 2
    return out
