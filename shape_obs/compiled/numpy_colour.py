"""Colours looked up in a table, on NumPy: what is meant, not what is fast."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.compiled.interface import Found, Mask
from shape_obs.compiled.numpy_mask import survey
from shape_obs.image.roi import Window

reads_tables: Final = False  # OpenCV converts and compares faster than NumPy can look up


def table_mask(rgb: npt.NDArray[np.uint8], window: Window, table: npt.NDArray[np.uint64]) -> Mask:
    """See ``Kernels.table_mask``."""
    red, green, blue = np.moveaxis(rgb[window.slices].astype(np.uint32), -1, 0)
    word = table[(red << 10) | (green << 2) | (blue >> 6)]
    return ((word >> (blue & 63).astype(np.uint64)) & np.uint64(1)).astype(np.uint8) * np.uint8(255)


def seek(
    rgb: npt.NDArray[np.uint8],
    window: Window,
    table: npt.NDArray[np.uint64],
    step: int,
    min_area: int,
    min_share: float,
) -> Found:
    """See ``Kernels.seek``."""
    mask = table_mask(rgb, window, table)
    v, u = np.ogrid[window.top : window.top + window.height, window.left : window.left + window.width]
    shift = step // 4 + (step // 2) * ((v // step) & 1)
    looked_at = (v % step == step // 2) & ((u - shift) % step == 0)
    labels = np.asarray(cv2.connectedComponents(mask, connectivity=8)[1])
    mask[~np.isin(labels, labels[looked_at & (mask > 0)])] = 0
    runs, areas, box, dropped = survey(mask, window.left, window.top, min_area, min_share)
    if dropped:
        mask = np.zeros_like(mask)
        for row, start, stop in (runs - [window.top, window.left, window.left]).tolist():
            mask[row, start:stop] = 255
    return Found(mask, runs, areas, box)
