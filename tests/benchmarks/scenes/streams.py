"""Draw moving objects as sequences of masks for methods that are compared: a rope, a contour and a cloth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import count
from typing import Final, Literal, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import SIZE, Rope, draw_sheet, moving_blob, moving_rope, moving_sheet
from shape_obs.configurations.base import Configuration
from shape_obs.configurations.centerline import Centerline
from shape_obs.configurations.contour import Contour
from shape_obs.configurations.surface import Surface
from shape_obs.detector import ShapeDetector

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]
Name = Literal["rope", "contour", "cloth"]
_SPEED: Final = 10.0  # pixels by which the fastest point moves per frame
_ROPE_AREA: Final = (7_000, 9_000)  # pixels


class Scene(NamedTuple):
    """One frame of a work."""

    mask: Mask  # (H, W) uint8, 0 or 255
    pixels: Array  # the input of a clusterer, (M, 2) pixels (u, v): all pixels of the mask, or of a contour's outline
    # the known line on which the points belong, (P, 2) pixels in order; an outline may begin anywhere. None for a
    # cloth
    curve: Array | None
    ours: Array  # the points of the detector, (N, 2), for methods that start from them


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
        spec, drawn = Centerline(n=20), ((rope.mask, rope.curve) for rope in _ropes(frames, seed))
    elif name == "contour":
        blobs = moving_blob(np.random.default_rng(seed), turn=0.02, speed=_SPEED, swell=0.3, frames=frames)
        spec, drawn = Contour(n=32), ((b.mask, np.concatenate([b.outline, b.outline[:1]])) for b in blobs)
    else:
        # Twice as long as wide: its cells are about square. Its way is scaled, so that it stays inside when enlarged.
        sheets = moving_sheet(np.random.default_rng(seed), _SPEED, frames, aspect=2.0)
        image, points = np.array(SIZE[::-1]) / 2, (sheet.points for sheet in sheets)
        scaled = (1.17 * each - 0.47 * each.mean(axis=(0, 1)) + 0.3 * image for each in points)
        spec, drawn = Surface(rows=4, cols=8), ((draw_sheet(each).mask, None) for each in scaled)
    detector, scenes = ShapeDetector([spec]), []
    for mask, curve in drawn:
        pixels = outline_pixels(mask) if name == "contour" else np.argwhere(mask)[:, ::-1].astype(np.float64)
        scenes.append(Scene(mask, pixels, curve, detector.detect_mask(mask).shapes[0].pixels.astype(np.float64)))
    return Work(name, spec, tuple(scenes))


def _ropes(frames: int, seed: int) -> list[Rope]:
    """Return the first moving rope from ``seed`` on that keeps off the border and covers about 8,000 pixels."""
    tried = (list(moving_rope(np.random.default_rng(s), _SPEED, frames, length=540.0, width=15.0)) for s in count(seed))

    def fits(mask: Mask) -> bool:
        cut = mask[[0, -1]].any() or mask[:, [0, -1]].any()
        return not cut and _ROPE_AREA[0] <= cv2.countNonZero(mask) <= _ROPE_AREA[1]

    return next(found for found in tried if all(fits(rope.mask) for rope in found))


def outline_pixels(mask: Mask, approximation: int = cv2.CHAIN_APPROX_NONE) -> Array:
    """Return pixels on the outline of the largest object in order, ``(M, 2)`` (u, v); by default all of them."""
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, approximation)
    return np.asarray(max(contours, key=cv2.contourArea), dtype=np.float64).reshape(-1, 2)
