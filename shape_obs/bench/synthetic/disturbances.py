"""What a camera and a table do to a drawn rope: salt and pepper, ragged edges, uneven light, image noise.

A moving rope and a hand that hides a part of it: which points can be seen, and where they are, is known.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, Literal, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.synthetic.ropes import Rope, moving_rope

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


Array = npt.NDArray[np.float64]

Where = Literal["start", "end", "middle"]


_HAND: Final = 34.0  # pixels across

_AWAY: Final = 0.2  # of the frames, before the hand comes and after it has left


class Hidden(NamedTuple):
    """One frame.

    Args:
        rope: The rope; its mask is the whole one.
        mask: (H,W) uint8, what the hand leaves to see.
        share: How much of the rope's length the hand covers.
    """

    rope: Rope
    mask: npt.NDArray[np.uint8]
    share: float


def hidden_rope(
    rng: np.random.Generator, speed: float, share: float, where: Where, *, creep: int = 0, frames: int = 180
) -> Iterator[Hidden]:
    """A moving rope of which a hand covers a share for the middle three fifths of the frames.

    Args:
        rng: Draws the motion.
        speed: Of the fastest point, pixels per frame.
        share: Of the length that the hand covers.
        where: Which end, or the middle.
        creep: Frames over which the hand comes and goes; 0 for at once.
        frames: How many.
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
