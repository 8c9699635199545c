"""Segmentation by a range of hue, saturation and value."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.segmentation.colour import ColourRule

HUES = 180


@dataclass(frozen=True)
class HSVRange(ColourRule, kind="hsv"):
    """Pixels whose colour lies in a box of HSV space, bounds included.

    Args:
        low: (h, s, v), OpenCV's scale: h 0...179, s and v 0...255.
        high: (h, s, v). A hue below ``low``'s wraps around: red is ``low=(170, ...)``, ``high=(10, ...)``.
    """

    low: tuple[int, int, int]
    high: tuple[int, int, int]

    def __post_init__(self) -> None:
        super().__post_init__()
        top = (HUES - 1, 255, 255)
        for name, bound in (("low", self.low), ("high", self.high)):
            if len(bound) != 3 or any(not 0 <= value <= limit for value, limit in zip(bound, top, strict=True)):
                raise ValueError(f"hsv: {name} must be (h 0...179, s 0...255, v 0...255), got {bound}.")
        for i, name in ((1, "saturation"), (2, "value")):
            if self.low[i] > self.high[i]:
                raise ValueError(
                    f"hsv: low {name} {self.low[i]} is above high {name} {self.high[i]}; only hue wraps around."
                )

    def matches(self, rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """(h,w,3) uint8 -> (h,w) uint8 mask, 0 or 255."""
        hsv = cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV)
        if self.low[0] <= self.high[0]:
            return _in_range(hsv, self.low, self.high)
        mask = _in_range(hsv, self.low, (HUES - 1, *self.high[1:]))
        return mask | _in_range(hsv, (0, *self.low[1:]), self.high)


def _in_range(hsv: npt.NDArray[Any], low: tuple[int, int, int], high: tuple[int, int, int]) -> npt.NDArray[np.uint8]:
    return np.asarray(cv2.inRange(hsv, np.array(low, np.uint8), np.array(high, np.uint8)), dtype=np.uint8)
