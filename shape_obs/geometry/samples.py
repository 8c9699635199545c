"""What a clusterer sees: weighted points, the mask's pixels gathered into square cells."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.image.roi import Window


@dataclass(frozen=True)
class Samples:
    """Weighted points.

    Args:
        points: (M,D) centroids: pixels for D = 2, metres for D = 3.
        weight: (M,) how many pixels (points) each stands for.
        scale: Edge of the cells, in the unit of ``points``.
    """

    points: npt.NDArray[np.float64]
    weight: npt.NDArray[np.float64]
    scale: float

    def __len__(self) -> int:
        return len(self.points)


def mask_pixels(mask: npt.NDArray[np.uint8]) -> npt.NDArray[np.int32]:
    """(M,2) pixels (u, v) of a mask; OpenCV 4 returns (M,1,2), OpenCV 5 (M,2), both None for an empty one."""
    found = cv2.findNonZero(mask)
    if found is None:
        return np.zeros((0, 2), np.int32)
    return np.asarray(found, dtype=np.int32).reshape(-1, 2)


def single(pixels: npt.NDArray[np.int32], window: Window) -> Samples:
    """(M,2) pixels of a window, each a sample of its own."""
    return Samples(pixels + np.array([window.left, window.top], dtype=np.float64), np.ones(len(pixels)), 1.0)
