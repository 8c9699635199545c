"""What a camera and a table do to a drawn rope: salt and pepper, ragged edges, uneven light, image noise."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

Mask = npt.NDArray[np.uint8]
Image = npt.NDArray[np.uint8]

_ROPE: Final = (40.0, 80.0, 200.0)
_TABLE: Final = (150.0, 150.0, 145.0)


def salted(rng: np.random.Generator, mask: Mask, share: float) -> Mask:
    """Flip a share of all pixels of a mask."""
    return np.where(rng.random(mask.shape) < share, 255 - mask, mask).astype(np.uint8)


def ragged(rng: np.random.Generator, mask: Mask, depth: float) -> Mask:
    """Move the border of a mask in and out by ``depth`` pixels rms, in bites about five pixels long."""
    inside = cv2.distanceTransform(mask, cv2.DIST_L2, 5)
    outside = cv2.distanceTransform(255 - mask, cv2.DIST_L2, 5)
    bites = cv2.GaussianBlur(rng.normal(size=mask.shape).astype(np.float32), (0, 0), 2.0)
    bites *= depth / float(bites.std())
    return np.where(inside - outside > bites, 255, 0).astype(np.uint8)


def photographed(rng: np.random.Generator, mask: Mask, contrast: float, noise: float) -> Image:
    """A blue rope on a gray table, as an (H,W,3) uint8 RGB image.

    Args:
        rng: Draws the direction of the light, and the noise.
        mask: (H,W) the rope.
        contrast: The light is this many times brighter in one corner of the image than in the other.
        noise: Of the image, gray levels rms.
    """
    height, width = mask.shape
    angle = rng.uniform(0, 2 * np.pi)
    v, u = np.mgrid[:height, :width]
    along = u / width * np.cos(angle) + v / height * np.sin(angle)
    along = (along - along.min()) / np.ptp(along)
    light = contrast ** (along - 1.0)
    scene = np.where(mask[..., None] > 0, _ROPE, _TABLE) * light[..., None]
    return np.clip(np.rint(scene + rng.normal(0, noise, scene.shape)), 0, 255).astype(np.uint8)
