"""Moving objects as sequences of masks: what the detector and its peers are timed on.

RGB-D streams of a moving rope at the sizes of real cameras: what the whole pipeline is timed on.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import count
from typing import Any, Final, Literal, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.synthetic.blobs import moving_blob
from shape_obs.bench.synthetic.disturbances import photographed
from shape_obs.bench.synthetic.ropes import Rope, draw_rope, moving_rope
from shape_obs.bench.synthetic.sheets import Sheet, draw_sheet, moving_sheet
from shape_obs.camera import Intrinsics
from shape_obs.configurations import Centerline, Configuration, Contour, Surface
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.samples import mask_pixels
from shape_obs.image.segmentation import HSVRange

Array = npt.NDArray[np.float64]

Mask = npt.NDArray[np.uint8]

Name = Literal["rope", "contour", "cloth"]

Drawn = tuple[Mask, Array | None]


SPEED: Final = 10.0  # pixels by which the fastest point moves from one frame to the next

ROPE_AREA: Final = (7_000, 9_000)

_ASPECT: Final = 2.0  # of the cloth: the cells of a 4 x 8 lattice are about square

_ENLARGED: Final = 1.17  # brings such a cloth of `moving_sheet` to 40,000 pixels

_INWARDS: Final = 0.7  # of its way about the middle of the image, so that it stays inside


class Scene(NamedTuple):
    """One frame of a work.

    Args:
        mask: (H,W) uint8, 0 or 255.
        pixels: (M,2) (u, v), what a clusterer is given: every pixel of the mask; for a contour those of the outline.
        curve: (P,2) pixels, the known line that the points belong on, in order, an outline's from any point on; None
            for a cloth.
        ours: (N,2) the points that the detector finds, for methods that start from them.
    """

    mask: Mask
    pixels: Array
    curve: Array | None
    ours: Array


@dataclass(frozen=True)
class Work:
    """A task for every method alike.

    Args:
        name: What moves.
        configuration: What the detector is told.
        scenes: The frames.
    """

    name: Name
    configuration: Configuration
    scenes: tuple[Scene, ...]

    @property
    def n(self) -> int:
        """How many points are asked for."""
        return self.configuration.count

    @property
    def grid(self) -> tuple[int, int]:
        """The points as rows and columns, for methods that want a lattice: one row, or the surface's."""
        spec = self.configuration
        return (spec.rows, spec.cols) if isinstance(spec, Surface) else (1, self.n)

    @property
    def samples(self) -> int:
        """M, the median number of pixels that a clusterer is given."""
        return int(np.median([len(scene.pixels) for scene in self.scenes]))


def work(name: Name, frames: int, seed: int) -> Work:
    """A sequence of 640 x 480 masks.

    Args:
        name: ``"rope"``: 20 points along about 8,000 pixels; ``"contour"``: 32 points around about 600 pixels of an
            outline; ``"cloth"``: 4 x 8 points over about 40,000 pixels.
        frames: How many.
        seed: Of shape and motion.
    """
    if name == "rope":
        return _work(name, Centerline(n=20), ((rope.mask, rope.curve) for rope in ropes(frames, seed)))
    if name == "contour":
        return _work(name, Contour(n=32), _blobs(frames, seed))
    return _work(name, Surface(rows=4, cols=8), ((sheet.mask, None) for sheet in cloths(frames, seed)))


def _work(name: Name, spec: Configuration, drawn: Iterable[Drawn]) -> Work:
    detector = ShapeDetector([spec], backend="numpy")
    scenes = []
    for mask, curve in drawn:
        pixels = outline_pixels(mask) if name == "contour" else mask_pixels(mask).astype(np.float64)
        scenes.append(Scene(mask, pixels, curve, detector.detect_mask(mask).shapes[0].pixels.astype(np.float64)))
    return Work(name, spec, tuple(scenes))


def ropes(frames: int, seed: int) -> list[Rope]:
    """The first moving rope from ``seed`` on that stays inside 640 x 480 pixels and covers about 8,000 of them."""
    tried = (list(moving_rope(np.random.default_rng(s), SPEED, frames, length=540.0, width=15.0)) for s in count(seed))
    return next(found for found in tried if all(_fits(rope.mask) for rope in found))


def _blobs(frames: int, seed: int) -> Iterator[Drawn]:
    for blob in moving_blob(np.random.default_rng(seed), turn=0.02, speed=SPEED, swell=0.3, frames=frames):
        yield blob.mask, np.concatenate([blob.outline, blob.outline[:1]])


def cloths(frames: int, seed: int) -> Iterator[Sheet]:
    """A moving cloth of about 40,000 pixels within 640 x 480, twice as long as wide."""
    for sheet in moving_sheet(np.random.default_rng(seed), SPEED, frames, aspect=_ASPECT):
        height, width = sheet.mask.shape
        middle, image = sheet.points.mean(axis=(0, 1)), np.array([width, height]) / 2
        yield draw_sheet((sheet.points - middle) * _ENLARGED + image + (middle - image) * _INWARDS)


def outline_pixels(mask: Mask) -> Array:
    """(M,2) (u, v) every pixel on the outline of the largest object, in order."""
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.asarray(max(contours, key=len), dtype=np.float64).reshape(-1, 2)


def _fits(mask: Mask) -> bool:
    """Whether a rope stays off the border of its image and has the size that is asked for."""
    cut = mask[[0, -1]].any() or mask[:, [0, -1]].any()
    return not cut and ROPE_AREA[0] <= cv2.countNonZero(mask) <= ROPE_AREA[1]


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
