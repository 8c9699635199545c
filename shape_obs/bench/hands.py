"""A moving rope and a hand that hides a part of it: which points can be seen, and where they are, is known."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, Literal, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.motion import moving_rope
from shape_obs.bench.ropes import Rope

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
