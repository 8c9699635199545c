"""What all pixel rules share: clean-up by opening and closing, and the area threshold."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.frame import Frame
from shape_obs.roi import Window
from shape_obs.spec import Spec


@dataclass(frozen=True, kw_only=True)
class Segmentation(Spec, family="segmentation"):
    """A pixel rule with its clean-up.

    Args:
        open: Edge of the square for morphological opening, pixels; 0 leaves it out. An object thinner than this
            vanishes.
        close: Edge of the square for morphological closing, pixels; 0 leaves it out. A gap narrower than this fills.
        min_area: Components with fewer pixels are dropped.
        min_share: Components smaller than this share of the largest are dropped; 1 keeps the largest alone, as the
            paper does. A cable that something crosses falls into several components, hence the default.
    """

    open: int = 0
    close: int = 0
    min_area: int = 20
    min_share: float = 0.05

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.open < 0 or self.close < 0 or self.min_area < 1:
            raise ValueError(
                f"{self.kind}: open and close must be >= 0 and min_area >= 1, "
                f"got {self.open}, {self.close} and {self.min_area}."
            )
        if not 0 <= self.min_share <= 1:
            raise ValueError(f"{self.kind}: min_share must lie in 0...1, got {self.min_share}.")

    def apply(self, frame: Frame, window: Window) -> npt.NDArray[np.uint8]:
        """The mask of ``window``: (h,w) uint8, 0 or 255, after opening and closing."""
        return self.clean(self.threshold(frame, window))

    def clean(self, mask: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """A mask after opening and closing; it is overwritten."""
        for size, operation in ((self.open, cv2.MORPH_OPEN), (self.close, cv2.MORPH_CLOSE)):
            if size > 1:
                square = cv2.getStructuringElement(cv2.MORPH_RECT, (size, size))
                cv2.morphologyEx(mask, operation, square, dst=mask)
        return mask

    @abstractmethod
    def threshold(self, frame: Frame, window: Window) -> npt.NDArray[np.uint8]:
        """The bare rule: (h,w) uint8, 0 or 255."""


def need(image: npt.NDArray[Any] | None, name: str, rule: Segmentation) -> npt.NDArray[Any]:
    """The image that a rule reads, or an error that says which is missing."""
    if image is None:
        raise ValueError(f"segmentation {rule.kind!r} needs {name}, but the frame has none.")
    return image
