"""Disturb drawn objects: salt and pepper, ragged edges, uneven light, image noise, and a hand over a moving rope."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, Literal, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.synthetic.ropes import Rope, moving_rope
from shape_obs.image.segmentation import HSVRange

Mask = npt.NDArray[np.uint8]
Image = npt.NDArray[np.uint8]
# Segments the objects of ``photographed``.
BLUE: Final = HSVRange(low=(100, 80, 25), high=(130, 255, 255))
_ROPE: Final = (40.0, 80.0, 200.0)
_TABLE: Final = (150.0, 150.0, 145.0)
Array = npt.NDArray[np.float64]
Where = Literal["start", "end", "middle"]
_HAND: Final = 34.0  # width of the hand in pixels
_AWAY: Final = 0.2  # share of the frames before the hand arrives, and after it has left


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
    """Draw a blue rope on a gray table as an (H, W, 3) uint8 RGB image.

    Args:
        rng: Draws the direction of the light and the noise.
        mask: The rope, (H, W).
        contrast: Ratio of the light in the brightest corner of the image to the light in the darkest one.
        noise: RMS noise of the image in gray levels.
    """
    height, width = mask.shape
    angle = rng.uniform(0, 2 * np.pi)
    v, u = np.mgrid[:height, :width]
    along = u / width * np.cos(angle) + v / height * np.sin(angle)
    along = (along - along.min()) / np.ptp(along)
    light = contrast ** (along - 1.0)
    scene = np.where(mask[..., None] > 0, _ROPE, _TABLE) * light[..., None]
    return np.clip(np.rint(scene + rng.normal(0, noise, scene.shape)), 0, 255).astype(np.uint8)


class Hidden(NamedTuple):
    """One frame of a rope under a hand.

    Args:
        rope: The rope with its whole mask.
        mask: The visible part of the mask, (H, W) uint8.
        share: Covered share of the rope's length.
    """

    rope: Rope
    mask: npt.NDArray[np.uint8]
    share: float


def hidden_rope(
    rng: np.random.Generator, speed: float, share: float, where: Where, *, creep: int = 0, frames: int = 180
) -> Iterator[Hidden]:
    """Draw a moving rope with a hand over a part of it during the middle three fifths of the frames.

    Args:
        rng: Draws the motion.
        speed: Speed of the fastest point in pixels per frame.
        share: Share of the length that the hand covers.
        where: The covered part.
        creep: Frames over which the hand comes and goes; 0 at once.
        frames: Number of frames.
    """
    for index, rope in enumerate(moving_rope(rng, speed, frames)):
        inside = min(index - _AWAY * frames, (1 - _AWAY) * frames - index)
        covered = share * float(np.clip((inside + 1) / (creep + 1), 0, 1))
        yield Hidden(rope, _under_hand(rope, covered, where), covered)


def _under_hand(rope: Rope, share: float, where: Where) -> npt.NDArray[np.uint8]:
    mask = rope.mask.copy()
    count = round(share * len(rope.curve))
    if count >= 2:
        first = {"start": 0, "end": len(rope.curve) - count, "middle": (len(rope.curve) - count) // 2}[where]
        line = np.rint(rope.curve[first : first + count]).astype(np.int32)
        cv2.polylines(mask, [line], False, 0, round(_HAND))
    return mask
