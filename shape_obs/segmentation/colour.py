"""Rules that look at the colour of one pixel at a time: they compile to a table."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np
import numpy.typing as npt

from shape_obs.frame import Frame
from shape_obs.roi import Window
from shape_obs.segmentation.base import Segmentation, need


class ColourRule(Segmentation):
    """A pixel rule for which the colour of a pixel alone decides, not its place, its neighbours or the frame.

    Such a rule is compiled to a table of all colours, once, and looked up from then on where that is faster: see
    ``segmentation.table``. The result is the same to the pixel.

    Example:
        >>> @dataclass(frozen=True)
        ... class MostlyRed(ColourRule, kind="mostly_red"):
        ...     lead: int = 40
        ...
        ...     def matches(self, rgb):
        ...         red, green, blue = np.moveaxis(rgb.astype(int), -1, 0)
        ...         return red - np.maximum(green, blue) >= self.lead
    """

    @abstractmethod
    def matches(self, rgb: npt.NDArray[np.uint8]) -> npt.NDArray[Any]:
        """Which pixels of an (h,w,3) uint8 RGB image belong to the object: (h,w), bool, or uint8 0 and 255."""

    def threshold(self, frame: Frame, window: Window) -> npt.NDArray[np.uint8]:
        """(h,w) uint8 mask, 0 or 255."""
        found = np.asarray(self.matches(need(frame.rgb, "rgb", self)[window.slices]))
        return found if found.dtype == np.uint8 else found.astype(bool).view(np.uint8) * np.uint8(255)
