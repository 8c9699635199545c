"""Regions of interest (the whole image, a rectangle, a polygon): a window of pixels, and what to blank in it."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from math import ceil, floor
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.spec import Spec


class Window(NamedTuple):
    """An upright rectangle of pixels; ``slices`` cuts it out of an image without a copy."""

    left: int
    top: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Row and column slices."""
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)


class Place(NamedTuple):
    """Where a region is in one frame.

    Args:
        region: A region that stands still; None where it is not known.
        memory: State that the region needs with the next frame.
        reason: Why it is not known; empty if it is.
    """

    region: ROI | None
    memory: Any = None
    reason: str = ""


class ROI(Spec, family="roi", modules={"markers": "shape_obs.image.marker_roi"}):
    """A region of interest: the window to read, and what to blank in it."""

    @abstractmethod
    def window(self, size: tuple[int, int]) -> Window:
        """Return the pixels to read of an image of ``size`` = ``(H, W)``.

        Raises:
            ValueError: The region leaves nothing of the image.
        """

    def blank(self, mask: npt.NDArray[np.uint8], window: Window) -> npt.NDArray[np.uint8]:
        """Return the mask with 0 outside the region; the mask given stays as it is."""
        return mask

    def place(self, rgb: npt.NDArray[np.uint8] | None, memory: Any) -> Place:
        """Return where the region is in a frame; most stand still. A region that moves overrides this.

        Args:
            rgb: ``(H, W, 3)`` uint8, RGB; None where there is only a mask or depth.
            memory: What ``place`` has returned with the frame before; None at the first frame and after a reset. The
                detector keeps it: it can be copied and pickled, and is never changed in place.

        Raises:
            ValueError: The region needs a colour image, and there is none.
        """
        return Place(self)


def clipped(box: tuple[int, int, int, int], size: tuple[int, int], roi: ROI) -> Window:
    """Return the part of a box (left, top, right, bottom) that lies in an image of ``size`` = ``(H, W)``.

    Raises:
        ValueError: None of it.
    """
    left, top = max(box[0], 0), max(box[1], 0)
    right, bottom = min(box[2], size[1]), min(box[3], size[0])
    if right <= left or bottom <= top:
        raise ValueError(f"the region of interest {roi} lies outside the image of {size[1]} x {size[0]} pixels.")
    return Window(left, top, right - left, bottom - top)


@dataclass(frozen=True)
class Rectangle(ROI, kind="rectangle"):
    """An upright rectangle.

    Args:
        left: First column, pixels.
        top: First row, pixels.
        width: Columns.
        height: Rows.
    """

    left: int
    top: int
    width: int
    height: int

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.width < 1 or self.height < 1:
            raise ValueError(f"Rectangle: width and height must be positive, got {self.width} x {self.height}.")

    def window(self, size: tuple[int, int]) -> Window:
        """Return the part of the rectangle that lies in the image."""
        box = (self.left, self.top, self.left + self.width, self.top + self.height)
        return clipped(box, size, self)


@dataclass(frozen=True)
class Polygon(ROI, kind="polygon"):
    """The inside of a polygon.

    Args:
        points: Three or more (u, v) corners, pixels.
    """

    points: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.points) < 3:
            raise ValueError(f"Polygon: needs at least three corners, got {len(self.points)}.")
        if not np.all(np.isfinite(self.points)):
            raise ValueError(f"Polygon: corners must be finite, got {self.points}.")

    def window(self, size: tuple[int, int]) -> Window:
        """Return the bounding box of the polygon, clipped to the image."""
        columns, rows = zip(*self.points, strict=True)
        first, last = (floor(min(columns)), floor(min(rows))), (ceil(max(columns)), ceil(max(rows)))
        return clipped((*first, last[0] + 1, last[1] + 1), size, self)

    def blank(self, mask: npt.NDArray[np.uint8], window: Window) -> npt.NDArray[np.uint8]:
        """Return the mask with 0 outside the polygon."""
        inside = np.zeros(mask.shape, np.uint8)
        corners = np.asarray(self.points, dtype=np.float64) - (window.left, window.top)
        cv2.fillPoly(inside, [np.round(corners).astype(np.int32)], 255)
        return np.asarray(cv2.bitwise_and(mask, inside), dtype=np.uint8)


@dataclass(frozen=True)
class Whole(ROI, kind="whole"):
    """The whole image."""

    def window(self, size: tuple[int, int]) -> Window:
        """Return the whole image."""
        return Window(0, 0, size[1], size[0])
