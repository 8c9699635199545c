"""A small network that turns clicks on a photo into the mask of what was clicked.

What it sees is a photo of which the longer side has about 450 pixels, the colours that were clicked, where, and the mask
of the pass before. It was trained on drawings alone, by examples/click_net.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float32]
Image = npt.NDArray[np.uint8]
Pixel = tuple[float, float]

#: What the network sees of each pixel: see ``network_input``.
CHANNELS: Final = 11
# Distances of colours in Lab at which the likeness of a colour falls to 1/e: strict, loose; to colours clicked away.
_STRICT, _LOOSE, _AWAY = 8.0, 25.0, 10.0
_OF_LIGHT: Final = 0.5  # weight of squared differences of lightness: light and shadow differ in it most
_AT, _AROUND = 3.0, 30.0  # pixels from a click at which it falls to 1/e: the place itself, and its surroundings
_FAR: Final = 1e4  # a squared distance in Lab above all that occur


@dataclass(frozen=True, eq=False)
class Clicks:
    """Clicks on one side of the border of an object: on it, or off it.

    In a video the places are those of the frame, or none, and the colours those that were clicked in the first one.

    Args:
        places: ``(K, 2)`` float, (u, v) in pixels of the image that the network sees.
        colours: ``(C, 3)`` float, CIE Lab.
    """

    places: Array
    colours: Array

    @classmethod
    def at(cls, lab: Array, pixels: Sequence[Pixel]) -> Clicks:
        """Return clicks with the colours of an image ``(h, w, 3)``, the median of 3 x 3 pixels around each."""
        height, width = lab.shape[:2]
        places, colours = [], []
        for u, v in pixels:
            x, y = min(max(int(u), 0), width - 1), min(max(int(v), 0), height - 1)
            near = lab[max(0, y - 1) : y + 2, max(0, x - 1) : x + 2].reshape(-1, 3)
            places.append((x, y))
            colours.append(np.median(near, axis=0))
        return cls(np.array(places, np.float32).reshape(-1, 2), np.array(colours, np.float32).reshape(-1, 3))


def as_lab(rgb: Image) -> Array:
    """Return CIE Lab of an image, ``(h, w, 3)`` float32: L 0...100, a and b about -128...127."""
    return np.asarray(cv2.cvtColor(rgb.astype(np.float32) / 255, cv2.COLOR_RGB2LAB), np.float32)


def network_input(rgb: Image, lab: Array, on: Clicks, off: Clicks, previous: Array | None = None) -> Array:
    """Return what the network sees: ``(11, h, w)`` float32.

    The colour, -1...1 (0 to 2); likeness to the clicked colours, strict (3), loose (4) and without lightness (5); to
    colours clicked away (6); clicks on the object, the places (7) and their surroundings (8); clicks off it (9); the
    probability of the pass or frame before (10).

    Args:
        rgb: ``(h, w, 3)`` uint8; h and w are multiples of 16.
        lab: The same in CIE Lab, see ``as_lab``.
        on: Clicks on the object.
        off: Clicks off it.
        previous: ``(h, w)``, 0...1, or None in the first pass.
    """
    height, width = rgb.shape[:2]
    seen = np.zeros((CHANNELS, height, width), np.float32)
    seen[:3] = (rgb.astype(np.float32) / 128 - 1).transpose(2, 0, 1)
    clicked, hue = _distances(lab, on.colours, _OF_LIGHT)  # both squared
    seen[3] = np.exp(-np.sqrt(clicked) / _STRICT)
    seen[4] = np.exp(-np.sqrt(clicked) / _LOOSE)
    seen[5] = np.exp(-np.sqrt(hue) / _STRICT)
    if len(off.colours):
        seen[6] = np.exp(-np.sqrt(_distances(lab, off.colours, _OF_LIGHT)[0]) / _AWAY)
    if len(on.places):
        away = _distance_to(on.places, height, width)
        seen[7] = np.exp(-((away / _AT) ** 2))
        seen[8] = np.exp(-away / _AROUND)
    if len(off.places):
        seen[9] = np.exp(-((_distance_to(off.places, height, width) / _AT) ** 2))
    if previous is not None:
        seen[10] = previous
    return seen


def _distances(lab: Array, colours: Array, of_light: float) -> tuple[Array, Array]:
    """Return the squared distance of each pixel from the nearest colour, and the same without lightness."""
    nearest = np.full(lab.shape[:2], _FAR, np.float32)
    nearest_hue = nearest.copy()
    for colour in colours:
        difference = lab - colour  # (h, w, 3)
        difference *= difference
        hue = difference[..., 1] + difference[..., 2]
        np.minimum(nearest, of_light * difference[..., 0] + hue, out=nearest)
        np.minimum(nearest_hue, hue, out=nearest_hue)
    return nearest, nearest_hue


def _distance_to(places: Array, height: int, width: int) -> Array:
    """Return the distance of each pixel from the nearest place, in pixels: ``(h, w)``."""
    free = np.ones((height, width), np.uint8)
    column = np.clip(places[:, 0].astype(int), 0, width - 1)
    row = np.clip(places[:, 1].astype(int), 0, height - 1)
    free[row, column] = 0
    return np.asarray(cv2.distanceTransform(free, cv2.DIST_L2, 3), np.float32)
