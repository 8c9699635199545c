"""Hand: something that comes into the picture now and then and lies over the object."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

SKIN: Final = (205, 150, 125)
#: Above the table, metres.
_HEIGHT: Final = 0.06
_WIDTH: Final = 56  # pixels at 480 rows
#: Frames of a visit, and of its coming and going.
_STAY: Final = 30
_COMING: Final = 6


class Hand:
    """An arm from the lower edge of the picture that ends over a point of the object.

    Args:
        share: Of the time, 0 ... 1, that it is in the picture; a visit takes a second at 30 Hz.
        seed: Of when it comes and where it reaches.

    Raises:
        ValueError: No share.
    """

    def __init__(self, share: float, seed: int) -> None:
        if not 0 <= share < 1:
            raise ValueError(f"occluder: expected a share from 0 (never) to below 1, got {share}.")
        # Visits of _STAY frames, with such breaks between them that they take up this share.
        self._comes = 0.0 if share == 0 else min(1.0, share / (1 - share) / _STAY)
        self._random = np.random.default_rng([seed, 0x4A4D])
        self._frame, self._reach = _STAY, 0.0

    def draw(self, rgb: npt.NDArray[np.uint8], metres: npt.NDArray[np.float32], points: npt.NDArray[Any]) -> bool:
        """Draw it into a picture, where it is there.

        Args:
            rgb: (H,W,3) uint8, changed.
            metres: (H,W) depth, changed.
            points: (n,2) pixels of the object, in order.

        Returns:
            Whether any of it is in the picture.
        """
        if self._frame >= _STAY:
            if self._random.random() >= self._comes:
                return False
            self._frame, self._reach = 0, self._random.uniform(0, len(points) - 1)
        height, width = metres.shape
        goal, out = points[round(self._reach)], np.array([0.5 * width, 1.2 * height])
        share = min(1.0, (self._frame + 1) / _COMING, (_STAY - self._frame) / _COMING)
        tip = out + share * (goal - out)
        self._frame += 1
        mask = np.zeros(metres.shape, np.uint8)
        begin, end = ((round(float(u)), round(float(v))) for u, v in (out, tip))
        cv2.line(mask, begin, end, 1, round(_WIDTH * height / 480))
        covered = mask > 0
        if not covered.any():
            return False
        rgb[covered] = SKIN
        metres[covered] = np.maximum(metres[covered] - np.float32(_HEIGHT), np.float32(0.05))
        return True
