"""Segmentation by distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shape_obs.frame import MILLIMETRE, Frame
from shape_obs.roi import Window
from shape_obs.segmentation.base import Segmentation, need


@dataclass(frozen=True)
class DepthRange(Segmentation, kind="depth"):
    """Pixels whose depth lies in a range, bounds included; invalid depth never does.

    Args:
        near: Metres along the optical axis.
        far: Metres along the optical axis.
    """

    near: float
    far: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.near <= self.far or not np.isfinite(self.far):
            raise ValueError(f"depth: expected 0 < near <= far in metres, got near {self.near} and far {self.far}.")

    def threshold(self, frame: Frame, window: Window) -> npt.NDArray[np.uint8]:
        """(h,w) uint8 mask, 0 or 255."""
        depth = need(frame.depth, "depth", self)[window.slices]
        if depth.dtype == np.uint16:
            low, high = max(np.ceil(self.near / MILLIMETRE - 1e-6), 1), np.floor(self.far / MILLIMETRE + 1e-6)
            inside = (depth >= low) & (depth <= high)
        else:
            inside = (depth >= self.near) & (depth <= self.far)
        return np.asarray(inside).view(np.uint8) * np.uint8(255)
