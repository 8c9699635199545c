"""Rectify images: from a lens with distortion to a pinhole camera."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics

#: Fractions of a pixel in OpenCV's fixed-point maps: row x 32 + column.
_STEPS: Final = 32
Maps = tuple[npt.NDArray[np.int16], npt.NDArray[np.uint16]]


@dataclass(frozen=True)
class Rectification:
    """Rectify colour and depth images of one lens.

    Args:
        output: Intrinsics of the results, a pinhole with the size, focal lengths and principal point of the lens.
        maps: OpenCV's fixed-point maps; None for a lens without distortion, whose images stay as they are.
    """

    output: Intrinsics
    maps: Maps | None

    @classmethod
    def of(cls, lens: Intrinsics) -> Rectification:
        """Return the rectification of a lens."""
        output = replace(lens, model="pinhole", coeffs=(0.0,) * 5)
        return cls(output, remap_maps(output, lens) if lens.distorted else None)

    @classmethod
    def from_opencv(
        cls, pinhole: Intrinsics, coefficients: npt.NDArray[np.float64], *, fisheye: bool = False
    ) -> Rectification:
        """Return the rectification of a lens with one of OpenCV's models, which have more terms than ``Intrinsics``.

        Args:
            pinhole: The intrinsics without distortion.
            coefficients: The 4, 5, 8, 12 or 14 distortion coefficients in OpenCV's order; 4 of a fisheye.
            fisheye: Whether the model is that of ``cv2.fisheye``.
        """
        module: Any = cv2.fisheye if fisheye else cv2
        size = (pinhole.width, pinhole.height)
        whole, fraction = module.initUndistortRectifyMap(
            pinhole.matrix, coefficients, np.eye(3), pinhole.matrix, size, cv2.CV_16SC2
        )
        return cls(pinhole, (np.asarray(whole, np.int16), np.asarray(fraction, np.uint16)))

    def colour(self, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Rectify an image of shape ``(H, W, 3)``; black where the lens sees less than the pinhole camera does."""
        return image if self.maps is None else remap(image, self.maps)

    def depth(self, image: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Rectify a depth image of shape ``(H, W)``, aligned to the colour image, without mixing depths."""
        if self.maps is None:
            return image
        nearest = (self._nearest, np.empty(0, np.uint16))
        return np.asarray(cv2.remap(image, *nearest, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT))

    @cached_property
    def _nearest(self) -> npt.NDArray[np.int16]:
        """The nearest pixel of each; ``cv2.remap`` would take the one to the upper left."""
        assert self.maps is not None
        whole, fraction = self.maps
        steps = np.stack([fraction % _STEPS, fraction // _STEPS], axis=-1)
        return (whole + (steps >= _STEPS // 2)).astype(np.int16)


def remap_maps(target: Intrinsics, source: Intrinsics) -> Maps:
    """Return OpenCV's fixed-point maps from each target pixel to the source pixel on the same ray."""
    pixels = np.stack(np.meshgrid(np.arange(target.width), np.arange(target.height)), axis=-1)
    at = source.project(target.rays(pixels)).astype(np.float32)
    whole, fraction = cv2.convertMaps(at[..., 0], at[..., 1], cv2.CV_16SC2)
    return np.asarray(whole, np.int16), np.asarray(fraction, np.uint16)


def remap(image: npt.NDArray[np.uint8], maps: Maps) -> npt.NDArray[np.uint8]:
    """Sample an image at the maps, between pixels linearly; black outside it."""
    return np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), np.uint8)
