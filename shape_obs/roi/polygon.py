"""The inside of a polygon."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.roi.base import ROI, Window, clipped


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
        """The bounding box of the polygon, clipped to the image."""
        corners = np.asarray(self.points, dtype=np.float64)
        low, high = np.floor(corners.min(axis=0)).astype(int), np.ceil(corners.max(axis=0)).astype(int) + 1
        return clipped((int(low[0]), int(low[1]), int(high[0]), int(high[1])), size, self)

    def blank(self, mask: npt.NDArray[np.uint8], window: Window) -> npt.NDArray[np.uint8]:
        """The mask with 0 outside the polygon."""
        inside = np.zeros(mask.shape, np.uint8)
        corners = np.asarray(self.points, dtype=np.float64) - (window.left, window.top)
        cv2.fillPoly(inside, [np.round(corners).astype(np.int32)], 255)
        return np.asarray(cv2.bitwise_and(mask, inside), dtype=np.uint8)
