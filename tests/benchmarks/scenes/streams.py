"""Draw moving objects as sequences of masks and as RGB-D streams at the sizes of real cameras, for measuring speed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import count
from typing import Any, Final, Literal, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.photos import BLUE, photographed
from shape_obs.bench.scenes import Rope, Sheet, draw_rope, draw_sheet, moving_blob, moving_rope, moving_sheet
from shape_obs.camera import Intrinsics
from shape_obs.configurations.base import Configuration
from shape_obs.configurations.centerline import Centerline
from shape_obs.configurations.contour import Contour
from shape_obs.configurations.surface import Surface
from shape_obs.detector import ShapeDetector
from tests.benchmarks import Size

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]
Name = Literal["rope", "contour", "cloth"]

SPEED: Final = 10.0  # pixels by which the fastest point moves per frame
ROPE_AREA: Final = (7_000, 9_000)  # pixels
_ASPECT: Final = 2.0  # of the cloth, so that the cells of a 4 x 8 lattice are about square
_ENLARGED: Final = 1.17  # enlarges such a cloth to about 40,000 pixels
_INWARDS: Final = 0.7  # scales the cloth's way about the middle of the image, so that it stays inside
_BASE: Final[Size] = (640, 480)
_LIGHT: Final = 1.5  # contrast of the light between corners of the image
_NOISE: Final = 4.0  # gray levels
_TABLE, _OBJECT = 700, 690  # distance in millimetres
_DEPTH_NOISE: Final = 1.5  # millimetres
_HOLES: Final = 0.01  # share of pixels without depth
_FOCAL: Final = 386.0  # pixels at 640 x 480, as in a D455


class Scene(NamedTuple):
    """One frame of a work.

    Args:
        mask: ``(H, W)`` uint8, 0 or 255.
        pixels: The input of a clusterer, ``(M, 2)`` pixels (u, v): all pixels of the mask, or of a contour's outline.
        curve: The known line on which the points belong, (P, 2) pixels in order; an outline may begin anywhere. None
            for a cloth.
        ours: The points of the detector, ``(N, 2)``, for methods that start from them.
    """

    mask: Mask
    pixels: Array
    curve: Array | None
    ours: Array


@dataclass(frozen=True)
class Work:
    """A task that every method performs: a configuration and the frames of a moving object."""

    name: Name
    configuration: Configuration
    scenes: tuple[Scene, ...]

    @property
    def n(self) -> int:
        """The number of points."""
        return self.configuration.layout.size

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns for methods that use a lattice; one row unless the shape is a surface."""
        spec = self.configuration
        return (spec.rows, spec.cols) if isinstance(spec, Surface) else (1, self.n)

    @property
    def samples(self) -> int:
        """M, the median number of pixels that a clusterer is given."""
        return int(np.median([len(scene.pixels) for scene in self.scenes]))


def work(name: Name, frames: int, seed: int) -> Work:
    """Draw a sequence of 640 x 480 masks.

    Args:
        name: ``"rope"``: 20 points along about 8,000 pixels; ``"contour"``: 32 points around about 600 pixels of an
            outline; ``"cloth"``: 4 x 8 points over about 40,000 pixels.
        frames: Number of frames.
        seed: Seed of shape and motion.
    """
    spec: Configuration
    drawn: Iterable[tuple[Mask, Array | None]]
    if name == "rope":
        spec, drawn = Centerline(n=20), ((rope.mask, rope.curve) for rope in ropes(frames, seed))
    elif name == "contour":
        blobs = moving_blob(np.random.default_rng(seed), turn=0.02, speed=SPEED, swell=0.3, frames=frames)
        spec, drawn = Contour(n=32), ((b.mask, np.concatenate([b.outline, b.outline[:1]])) for b in blobs)
    else:
        spec, drawn = Surface(rows=4, cols=8), ((sheet.mask, None) for sheet in cloths(frames, seed))
    detector, scenes = ShapeDetector([spec]), []
    for mask, curve in drawn:
        pixels = outline_pixels(mask) if name == "contour" else np.argwhere(mask)[:, ::-1].astype(np.float64)
        scenes.append(Scene(mask, pixels, curve, detector.detect_mask(mask).shapes[0].pixels.astype(np.float64)))
    return Work(name, spec, tuple(scenes))


def ropes(frames: int, seed: int) -> list[Rope]:
    """Return the first moving rope from ``seed`` on that stays inside 640 x 480 pixels and covers about 8,000."""
    tried = (list(moving_rope(np.random.default_rng(s), SPEED, frames, length=540.0, width=15.0)) for s in count(seed))
    return next(found for found in tried if all(_fits(rope.mask) for rope in found))


def cloths(frames: int, seed: int) -> Iterator[Sheet]:
    """Draw a moving cloth of about 40,000 of 640 x 480 pixels, twice as long as wide."""
    for sheet in moving_sheet(np.random.default_rng(seed), SPEED, frames, aspect=_ASPECT):
        height, width = sheet.mask.shape
        middle, image = sheet.points.mean(axis=(0, 1)), np.array([width, height]) / 2
        yield draw_sheet((sheet.points - middle) * _ENLARGED + image + (middle - image) * _INWARDS)


def outline_pixels(mask: Mask, approximation: int = cv2.CHAIN_APPROX_NONE) -> Array:
    """Return pixels on the outline of the largest object in order, ``(M, 2)`` (u, v); by default all of them."""
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, approximation)
    return np.asarray(max(contours, key=cv2.contourArea), dtype=np.float64).reshape(-1, 2)


def _fits(mask: Mask) -> bool:
    """Return whether a rope keeps off the border of its image and covers ``ROPE_AREA``."""
    cut = mask[[0, -1]].any() or mask[:, [0, -1]].any()
    return not cut and ROPE_AREA[0] <= cv2.countNonZero(mask) <= ROPE_AREA[1]


class RGBD(NamedTuple):
    """One frame of a camera.

    Args:
        rgb: ``(H, W, 3)`` uint8.
        depth: ``(H, W)`` uint16 in millimetres, 0 = invalid.
        camera: The intrinsics of this size.
    """

    rgb: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.uint16]
    camera: Intrinsics


def streams(sizes: tuple[Size, ...], frames: int, seed: int) -> Iterator[dict[Size, RGBD]]:
    """Draw the rope of ``ropes`` at every image size, enlarged with the image's height.

    Args:
        sizes: (width, height) in pixels.
        frames: Number of frames.
        seed: Seed of the motion, light and noise.
    """
    rng = np.random.default_rng(seed)
    cameras = {size: pinhole(size) for size in sizes}
    for rope in ropes(frames, seed):
        yield {size: photo(rng, resized(rope, size).mask, camera) for size, camera in cameras.items()}


def pinhole(size: Size) -> Intrinsics:
    """Return a camera with the field of view of a D455."""
    focal = _FOCAL * size[1] / _BASE[1]
    return Intrinsics(*size, focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2)


def resized(rope: Rope, size: Size) -> Rope:
    """Draw a rope of a 640 x 480 image in the middle of an image of another size, scaled by the height."""
    scale = size[1] / _BASE[1]
    curve = (rope.curve + 0.5) * scale - 0.5
    curve[:, 0] += (size[0] - _BASE[0] * scale) / 2
    return draw_rope(curve, rope.width * scale, size=(size[1], size[0]))


def photo(rng: np.random.Generator, mask: Mask, camera: Intrinsics) -> RGBD:
    """Draw a blue object on a gray table, with noise in colour and depth, holes, and light from one side."""
    depth = np.where(mask > 0, _OBJECT, _TABLE) + rng.normal(0, _DEPTH_NOISE, mask.shape)
    depth[rng.random(mask.shape) < _HOLES] = 0
    return RGBD(photographed(rng, mask, _LIGHT, _NOISE), np.rint(depth).astype(np.uint16), camera)


def classic(rgb: npt.NDArray[np.uint8]) -> Any:
    """Segment the full frame in the usual way: threshold in HSV, open, close, connected components."""
    mask = cv2.inRange(cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV), np.array(BLUE.low), np.array(BLUE.high))
    square = cv2.getStructuringElement(cv2.MORPH_RECT, (3, 3))
    mask = cv2.morphologyEx(cv2.morphologyEx(mask, cv2.MORPH_OPEN, square), cv2.MORPH_CLOSE, square)
    return cv2.connectedComponentsWithStats(mask, connectivity=8)
