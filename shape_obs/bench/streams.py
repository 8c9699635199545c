"""RGB-D streams of a moving rope at the sizes of real cameras: what the whole pipeline is timed on."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.disturbances import photographed
from shape_obs.bench.ropes import Rope, draw_rope
from shape_obs.bench.workloads import ropes
from shape_obs.camera import Intrinsics
from shape_obs.image.segmentation import HSVRange

Mask = npt.NDArray[np.uint8]
Size = tuple[int, int]

BLUE: Final = HSVRange(low=(100, 80, 25), high=(130, 255, 255))
SIZES: Final[tuple[Size, ...]] = ((320, 240), (640, 480), (848, 480), (1280, 720), (1280, 800))
_BASE: Final = (640, 480)
_LIGHT: Final = 1.5  # brighter in one corner than in the other
_NOISE: Final = 4.0  # gray levels
_TABLE, _OBJECT = 700, 690  # millimetres
_DEPTH_NOISE: Final = 1.5  # millimetres
_HOLES: Final = 0.01  # share of pixels without depth
_FOCAL: Final = 386.0  # pixels at 640 x 480, as a D455's


class RGBD(NamedTuple):
    """One frame of a camera.

    Args:
        rgb: (H,W,3) uint8.
        depth: (H,W) uint16 millimetres, 0 = invalid.
        camera: Of this size.
    """

    rgb: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.uint16]
    camera: Intrinsics


def streams(sizes: tuple[Size, ...], frames: int, seed: int) -> Iterator[dict[Size, RGBD]]:
    """The same moving rope of 8,000 pixels at 640 x 480, seen at every size: it grows with the image's height.

    Args:
        sizes: (width, height), pixels.
        frames: How many.
        seed: Of the motion, light and noise.
    """
    rng = np.random.default_rng(seed)
    cameras = {size: pinhole(size) for size in sizes}
    for rope in ropes(frames, seed):
        yield {size: photo(rng, resized(rope, size).mask, camera) for size, camera in cameras.items()}


def pinhole(size: Size) -> Intrinsics:
    """A camera with the view of a D455's."""
    focal = _FOCAL * size[1] / _BASE[1]
    return Intrinsics(*size, focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2)


def resized(rope: Rope, size: Size) -> Rope:
    """A rope of a 640 x 480 image drawn in the middle of one of another size, as large as its height allows."""
    scale = size[1] / _BASE[1]
    curve = (rope.curve + 0.5) * scale - 0.5
    curve[:, 0] += (size[0] - _BASE[0] * scale) / 2
    return draw_rope(curve, rope.width * scale, size=(size[1], size[0]))


def photo(rng: np.random.Generator, mask: Mask, camera: Intrinsics) -> RGBD:
    """A blue object on a gray table, with noise in colour and depth, holes, and light from one side."""
    depth = np.where(mask > 0, _OBJECT, _TABLE) + rng.normal(0, _DEPTH_NOISE, mask.shape)
    depth[rng.random(mask.shape) < _HOLES] = 0
    return RGBD(photographed(rng, mask, _LIGHT, _NOISE), np.rint(depth).astype(np.uint16), camera)


def classic(rgb: npt.NDArray[np.uint8]) -> Any:
    """Segmentation as it is usually written, over the full frame: threshold in HSV, open, close, components."""
    mask = cv2.inRange(cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV), np.array(BLUE.low), np.array(BLUE.high))
    square = cv2.getStructuringElement(cv2.MORPH_RECT, (3, 3))
    mask = cv2.morphologyEx(cv2.morphologyEx(mask, cv2.MORPH_OPEN, square), cv2.MORPH_CLOSE, square)
    return cv2.connectedComponentsWithStats(mask, connectivity=8)
