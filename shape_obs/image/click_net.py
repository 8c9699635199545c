"""A small network that turns clicks on a photo into the mask of what was clicked.

It sees a photo of about 150,000 pixels, the colours that were clicked, where, and the mask of the pass
before. It was trained on drawings alone, by examples/click_net; click_net.md is its card.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from functools import lru_cache
from importlib.resources import files
from threading import Lock
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float32]
Image = npt.NDArray[np.uint8]
Pixel = tuple[float, float]

#: What the network sees of each pixel: see ``network_input``.
CHANNELS: Final = 11
#: Probability from which a pixel is the object's.
HALF: Final = 0.5
#: Pixels of a photo as the network sees it.
PIXELS: Final = 448 * 336
_SIDES: Final = 16  # pixels: what the network sees has sides of a multiple of this, two times at least
# Distances of colours in Lab at which their similarity falls to 1/e: strict, loose; to colours clicked away.
_STRICT, _LOOSE, _AWAY = 8.0, 25.0, 10.0
_OF_LIGHT: Final = 0.5  # weight of squared differences of lightness: light and shadow differ in it most
_AT, _AROUND = 3.0, 30.0  # pixels from a click at which it falls to 1/e: the place itself, and its surroundings
_FAR: Final = 1e4  # a squared distance in Lab above all that occur
_FILE: Final = "click_net.onnx"
_SHA256: Final = "1694bbe31ad596166bcf54c875c3b973bf590545e5d10deca9dd3dc2abaf458f"


class Clicks(NamedTuple):
    """Clicks on the object, or off it. In a video the colours are those of the first frame, the places of the last.

    Args:
        places: ``(K, 2)`` (u, v) in pixels that the network sees.
        colours: ``(C, 3)`` CIE Lab.
    """

    places: Array = np.empty((0, 2), np.float32)
    colours: Array = np.empty((0, 3), np.float32)

    @classmethod
    def at(cls, lab: Array, pixels: Sequence[Pixel] | npt.NDArray[Any]) -> Clicks:
        """Return clicks with the colours of an image ``(h, w, 3)``, the median of 3 x 3 pixels around each."""
        places = np.array(pixels, np.float32).reshape(-1, 2).clip(0, np.array(lab.shape[1::-1]) - 1)
        around = [lab[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2].reshape(-1, 3) for u, v in places.astype(int)]
        return cls(places, np.array([np.median(near, axis=0) for near in around], np.float32).reshape(-1, 3))


def as_lab(rgb: Image) -> Array:
    """Return CIE Lab of an image, ``(h, w, 3)`` float32: L 0...100, a and b about -128...127."""
    return np.asarray(cv2.cvtColor(rgb.astype(np.float32) / 255, cv2.COLOR_RGB2LAB), np.float32)


def network_input(rgb: Image, lab: Array, on: Clicks, off: Clicks, previous: Array | None = None) -> Array:
    """Return what the network sees: ``(11, h, w)`` float32.

    The colour, -1...1 (0 to 2); similarity to the clicked colours, strict (3), loose (4) and without lightness (5); to
    colours clicked away (6); clicks on the object, the places (7) and their surroundings (8); clicks off it (9); the
    probability of the pass or frame before (10).

    Args:
        rgb: ``(h, w, 3)`` uint8; h and w are multiples of 16.
        lab: The same in CIE Lab, see ``as_lab``.
        on: Clicks on the object.
        off: Clicks off it.
        previous: ``(h, w)``, 0...1, or None in the first pass.
    """
    seen = np.zeros((CHANNELS, *rgb.shape[:2]), np.float32)
    seen[:3] = (rgb.astype(np.float32) / 128 - 1).transpose(2, 0, 1)
    colour, hue = distances_of_colours(lab, on.colours)
    seen[3], seen[4], seen[5] = np.exp(-colour / _STRICT), np.exp(-colour / _LOOSE), np.exp(-hue / _STRICT)
    if len(off.colours):
        seen[6] = np.exp(-distances_of_colours(lab, off.colours)[0] / _AWAY)
    if len(on.places):
        away = _distances_from(on.places, seen.shape[1:])
        seen[7], seen[8] = np.exp(-((away / _AT) ** 2)), np.exp(-away / _AROUND)
    if len(off.places):
        seen[9] = np.exp(-((_distances_from(off.places, seen.shape[1:]) / _AT) ** 2))
    if previous is not None:
        seen[10] = previous
    return seen


def distances_of_colours(lab: Array, colours: Array) -> tuple[Array, Array]:
    """Return the distance of each pixel's colour from the nearest of some colours, and the same without lightness."""
    nearest, nearest_hue = (np.full(lab.shape[:2], _FAR, np.float32) for _ in range(2))
    for colour in colours:
        square = (lab - colour) ** 2  # (h, w, 3)
        hue = square[..., 1] + square[..., 2]
        np.minimum(nearest, _OF_LIGHT * square[..., 0] + hue, out=nearest)
        np.minimum(nearest_hue, hue, out=nearest_hue)
    return np.sqrt(nearest), np.sqrt(nearest_hue)


def _distances_from(places: Array, size: Sequence[int]) -> Array:
    """Return the distance of each pixel from the nearest place, in pixels: ``(h, w)``."""
    free = np.ones(size, np.uint8)
    column, row = places.astype(int).clip(0, (size[1] - 1, size[0] - 1)).T
    free[row, column] = 0
    return np.asarray(cv2.distanceTransform(free, cv2.DIST_L2, 3), np.float32)


class Photo:
    """A photo, or a part of one, at the size at which the network sees it.

    Args:
        rgb: ``(H, W, 3)`` uint8.
        pixels: How many the network sees, about.
    """

    def __init__(self, rgb: Image, pixels: int = PIXELS) -> None:
        height, width = rgb.shape[:2]
        ratio = min(1.0, math.sqrt(pixels / (height * width))) / _SIDES
        size = [max(round(side * ratio), 2) * _SIDES for side in (width, height)]
        self.size, self._scale = (width, height), np.array(size) / (width, height)
        self.rgb = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)  # (h, w, 3)
        self.lab = as_lab(self.rgb)

    def here(self, pixels: Sequence[Pixel] | npt.NDArray[Any]) -> Array:
        """Return pixels of the photo as pixels that the network sees, ``(K, 2)``."""
        return ((np.asarray(pixels).reshape(-1, 2) + 0.5) * self._scale - 0.5).astype(np.float32)

    def probability(self, on: Clicks, off: Clicks, previous: Array | None = None, passes: int = 2) -> Array:
        """Return how probable it is that each pixel of the photo is the object's: ``(H, W)``, 0...1."""
        network, lock = load_network()
        for _ in range(passes):
            seen = network_input(self.rgb, self.lab, on, off, previous)
            with lock:  # a network holds the images between its layers
                network.setInput(seen[None])
                previous = 1 / (1 + np.exp(-np.asarray(network.forward(), np.float32)[0, 0]))
        return np.asarray(cv2.resize(np.asarray(previous), self.size, interpolation=cv2.INTER_LINEAR), np.float32)


@lru_cache(maxsize=1)
def load_network() -> tuple[cv2.dnn.Net, Lock]:
    """Load the network, once, in some 10 ms.

    Raises:
        RuntimeError: Its file is missing, damaged, or another one.
    """
    try:
        content = (files("shape_obs.image") / _FILE).read_bytes()
    except OSError as error:
        raise RuntimeError(f"pick: {_FILE} is missing; install shape-obs again.") from error
    if hashlib.sha256(content).hexdigest() != _SHA256:
        raise RuntimeError(f"pick: {_FILE} is damaged, or not the one of this version; install shape-obs again.")
    return cv2.dnn.readNetFromONNX(np.frombuffer(content, np.uint8)), Lock()
