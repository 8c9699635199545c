"""A small network that turns clicks on a photo into the mask of what was clicked, and follows it through a video.

It sees a photo whose longer side has about 450 pixels, the colours that were clicked, where, and the mask of the pass
before. It was trained on drawings alone, by examples/click_net; click_net.md is its card.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from threading import Lock
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.frame import Frame
from shape_obs.image.roi import Window
from shape_obs.image.segmentation import Expected, FollowingRule, need
from shape_obs.spec import SpecError

Array = npt.NDArray[np.float32]
Image = npt.NDArray[np.uint8]
Pixel = tuple[float, float]

#: What the network sees of each pixel: see ``network_input``.
CHANNELS: Final = 11
# Distances of colours in Lab at which the likeness of a colour falls to 1/e: strict, loose; to colours clicked away.
_STRICT, _LOOSE, _AWAY = 8.0, 25.0, 10.0
_OF_LIGHT: Final = 0.5  # weight of squared differences of lightness: light and shadow differ in it most
_AT, _AROUND = 3.0, 30.0  # pixels from a click at which it falls to 1/e: the place itself, and its surroundings
_FILE: Final = "click_net.onnx"
_SHA256: Final = ""
_SIDES: Final = 16  # pixels: what the network sees has sides of a multiple of this
# Pixels of the longer side of what the network sees: a whole photo, and the surroundings of a track. A frame is looked
# at once, in a third of the time.
LONGEST, _LONGEST_NEAR = 448, 320
_CONTEXT: Final = 32  # pixels around a search window that the network sees as well
#: Probability from which a pixel is the object's.
HALF: Final = 0.5
_NOWHERE: Final = np.empty((0, 2), np.float32)
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


class Photo:
    """A photo, or a part of one, at the size at which the network sees it.

    Args:
        rgb: ``(H, W, 3)`` uint8.
        longest: Pixels of its longer side at most.

    Attributes:
        rgb: ``(h, w, 3)`` uint8; h and w are multiples of 16.
        lab: The same in CIE Lab.
        scale: Of u and of v from the photo's pixels to these.
    """

    def __init__(self, rgb: Image, longest: int) -> None:
        height, width = rgb.shape[:2]
        ratio = min(1.0, longest / max(height, width))
        size = tuple(max(_SIDES, round(side * ratio / _SIDES) * _SIDES) for side in (width, height))
        self.size = height, width
        self.rgb = np.ascontiguousarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)
        self.lab = as_lab(self.rgb)
        self.scale = np.array([size[0] / width, size[1] / height])

    def here(self, pixels: Sequence[Pixel] | npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        """Return pixels of the photo as pixels that the network sees, ``(K, 2)``."""
        return (np.asarray(pixels, np.float64).reshape(-1, 2) + 0.5) * self.scale - 0.5

    def probability(self, on: Clicks, off: Clicks, previous: Array | None = None, passes: int = 2) -> Array:
        """Return how probable it is that each pixel of the photo is the object's: ``(H, W)`` float32, 0...1."""
        for _ in range(passes):
            previous = run_network(network_input(self.rgb, self.lab, on, off, previous))
        assert previous is not None
        return np.asarray(cv2.resize(previous, self.size[::-1], interpolation=cv2.INTER_LINEAR), np.float32)


def run_network(seen: Array) -> Array:
    """Return the probability of each pixel, ``(h, w)``, of what ``network_input`` gives, ``(11, h, w)``."""
    network, lock = load_network()
    with lock:  # a network holds the images between its layers
        network.setInput(seen[None])
        logits = np.asarray(network.forward())[0, 0]
    return np.asarray(1 / (1 + np.exp(-logits)), np.float32)


@lru_cache(maxsize=1)
def load_network() -> tuple[cv2.dnn.Net, Lock]:
    """Load the network, once, in some 10 ms.

    Raises:
        RuntimeError: Its file is missing, damaged, or another one.
    """
    path = files("shape_obs.image") / _FILE
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RuntimeError(f"clicks: {_FILE} is missing; install shape-obs again.") from error
    if hashlib.sha256(content).hexdigest() != _SHA256:
        raise RuntimeError(f"clicks: {_FILE} is damaged, or not the one of this version; install shape-obs again.")
    return cv2.dnn.readNetFromONNX(np.frombuffer(content, np.uint8)), Lock()


@dataclass(frozen=True)
class ClickNet(FollowingRule, kind="click_net"):
    """Pixels that a small network takes for the object that was clicked, in each frame.

    ``propose_segmentation`` chooses it where colours alone do not separate the object from all else. It looks around
    the place where the track expects the object; what is lost is looked for everywhere by the colours of the clicks.

    Args:
        picks: (u, v) of the clicks on the object; kept for the record, no pixel is read there again.
        nots: (u, v) of the clicks that are not on the object.
        object: The colours under the clicks on it, (L, a, b) of CIE Lab; L 0...100.
        background: Those under the other clicks.
    """

    picks: tuple[tuple[float, float], ...] = ()
    nots: tuple[tuple[float, float], ...] = ()
    object: tuple[tuple[float, float, float], ...] = ()
    background: tuple[tuple[float, float, float], ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.object or not np.isfinite([*self.object, *self.background]).all():
            raise SpecError(
                f"click_net: expected at least one colour (L, a, b) of the object, got {self.object}; "
                "shape_obs.clicks.propose_segmentation(rgb, picks) reads them from an image, as "
                "`shape-obs detect IMAGE --pick u,v` does."
            )

    def prepare(self) -> None:
        """Load the network."""
        load_network()

    def threshold(self, frame: Frame, window: Window) -> npt.NDArray[np.bool_]:
        """Look everywhere in a window, by the colours alone, and once more by what was found."""
        photo = Photo(need(frame.rgb, "rgb", self)[window.slices], LONGEST)
        return photo.probability(*self._clicks(_NOWHERE), passes=2) > HALF

    def threshold_near(self, frame: Frame, window: Window, expected: Expected) -> npt.NDArray[np.bool_]:
        """Look around the nodes that are expected."""
        rgb = need(frame.rgb, "rgb", self)
        left, top = max(window.left - _CONTEXT, 0), max(window.top - _CONTEXT, 0)
        seen = np.s_[top : window.top + window.height + _CONTEXT, left : window.left + window.width + _CONTEXT]
        photo = Photo(rgb[seen], _LONGEST_NEAR)
        before = cv2.resize(expected.mask[seen], photo.rgb.shape[1::-1], interpolation=cv2.INTER_AREA)
        on, off = self._clicks(photo.here(expected.nodes - (left, top)))
        found = photo.probability(on, off, np.asarray(before, np.float32), passes=1)
        return found[window.top - top :, window.left - left :][: window.height, : window.width] > HALF

    def _clicks(self, places: npt.NDArray[np.floating[Any]]) -> tuple[Clicks, Clicks]:
        """Return clicks of the colours that were clicked, at other places."""
        off = np.array(self.background, np.float32).reshape(-1, 3)
        return Clicks(places.astype(np.float32), np.array(self.object, np.float32)), Clicks(_NOWHERE, off)
