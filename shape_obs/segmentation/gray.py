"""Segmentation by brightness."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.segmentation.colour import ColourRule


@dataclass(frozen=True)
class GrayRange(ColourRule, kind="gray"):
    """Pixels whose luma (ITU-R BT.601) lies in a range, bounds included.

    Args:
        low: Darkest, 0...255.
        high: Brightest, 0...255.
    """

    low: int = 0
    high: int = 255

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.low <= self.high <= 255:
            raise ValueError(f"gray: expected 0 <= low <= high <= 255, got low {self.low} and high {self.high}.")

    def matches(self, rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """(h,w,3) uint8 -> (h,w) uint8 mask, 0 or 255."""
        gray = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
        return np.asarray(cv2.inRange(gray, np.array([self.low]), np.array([self.high])), dtype=np.uint8)
