"""Measure how the time of a frame grows with the size of the object, the number of points and of shapes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench import Clock
from shape_obs.bench.interleaved_timing import Method, Tick, by_method, interleaved_timing, median_ms
from shape_obs.bench.synthetic.images import BLUE
from shape_obs.bench.synthetic.ropes import SIZE, draw_rope
from shape_obs.bench.synthetic.sheets import draw_sheet
from shape_obs.bench.synthetic.streams import RGBD, cloths, photo, pinhole, ropes
from shape_obs.bench.tables import Row, at_most, grouped
from shape_obs.configurations.base import Configuration
from shape_obs.configurations.centerline import Centerline
from shape_obs.configurations.contour import Contour
from shape_obs.configurations.surface import Surface
from shape_obs.detector import ShapeDetector

Array = npt.NDArray[np.float64]
Shapes = tuple[Configuration, ...]
Frame = dict[str, Any]  # name -> mask, (H, W) uint8, or RGB-D image

WARM_UP: Final = 5  # frames that are not counted
AREAS: Final = (0.1, 0.2, 0.5, 1.0)  # shares of the object's full area
COUNTS: Final = (20, 50, 100, 200)
ROPE: Final = "pixels of a rope"
CLOTH: Final = "pixels of a cloth"
POINTS: Final = "points on a rope"
NUMBER: Final = "shapes in one RGB-D image"
# Targets: by how many times a frame may take longer from the smallest to the largest.
_TARGETS: Final = {ROPE: 2.0, CLOTH: 2.0, POINTS: 1.5, NUMBER: 2.5}
_COARSE: Final = Contour(name="coarse", n=12)
_NUMBERS: Final[tuple[Shapes, ...]] = ((Contour(),), (Contour(), Surface()), (Contour(), _COARSE, Surface()))


# What grows, its amount (None is the number of pixels of the mask), the name of the image, and the shapes.
_CASES: Final[tuple[tuple[str, int | None, str, Shapes], ...]] = (
    *((ROPE, None, f"rope {area}", (Centerline(n=20),)) for area in AREAS),
    *((CLOTH, None, f"cloth {area}", (Surface(rows=4, cols=8),)) for area in AREAS),
    *((POINTS, n, f"rope {AREAS[-1]}", (Centerline(n=n),)) for n in COUNTS),
    *((NUMBER, len(shapes), "photo", shapes) for shapes in _NUMBERS),
)


def growth_rows(frames: int, seed: int, clock: Clock = "wall", tick: Tick = lambda: None) -> list[Row]:
    """Time tracked detectors on growing objects, points and shapes, 640 x 480, in turns on one thread.

    Pixels and points are timed from the mask to the points, shapes from the RGB-D image on.

    Args:
        frames: Number of counted frames.
        seed: Seed of the motions.
        clock: The clock.
        tick: Called after each frame.

    Returns:
        A row for each point of a growth curve: what grows, its amount (the median number of pixels), the median
        milliseconds of a frame, and the ratio to the smallest amount.
    """
    pixels: dict[str, list[int]] = defaultdict(list)

    def seen() -> Iterator[Frame]:
        for frame in _frames(frames + WARM_UP, seed):
            for name, image in frame.items():
                if not isinstance(image, RGBD):
                    pixels[name].append(cv2.countNonZero(image))
            yield frame

    methods = [_method(*case) for case in _CASES]
    found = by_method(methods, interleaved_timing(seen(), methods, clock, seed, warm_up=WARM_UP, tick=tick))
    rows: list[Row] = []
    smallest: dict[str, float] = {}
    for (grows, known, image), turns in found.items():
        median, amount = median_ms(turns), known or int(np.median(pixels[image]))
        ratio = median / smallest.setdefault(grows, median)
        rows.append(Row(grows=grows, amount=amount, median_ms=median, times_smallest=ratio))
    return rows


def growth_targets(rows: list[Row]) -> list[Row]:
    """Compare the growth with its targets."""
    curves = grouped(rows, lambda row: row.grows)
    return [
        at_most(f"{grows} from {curve[0].amount} to {curve[-1].amount}", _TARGETS[grows], curve[-1].times_smallest)
        for grows, curve in curves.items()
    ]


def _frames(frames: int, seed: int) -> Iterator[Frame]:
    """Draw a rope and a cloth at every size about the middle of the image, and a photo of the largest cloth."""
    rng, camera = np.random.default_rng(seed), pinhole((SIZE[1], SIZE[0]))
    for rope, sheet in zip(ropes(frames, seed), cloths(frames, seed), strict=True):
        frame: Frame = {}
        for area in AREAS:
            scale = area**0.5
            frame[f"rope {area}"] = draw_rope(_shrunk(rope.curve, scale), rope.width * scale).mask
            frame[f"cloth {area}"] = draw_sheet(_shrunk(sheet.points, scale)).mask
        frame["photo"] = photo(rng, sheet.mask, camera)
        yield frame


def _shrunk(points: Array, scale: float) -> Array:
    middle = np.array([SIZE[1] - 1, SIZE[0] - 1]) / 2
    return (points - middle) * scale + middle


def _method(grows: str, amount: int | None, image: str, shapes: Shapes) -> Method[Frame]:
    detector, is_photo = ShapeDetector(shapes, BLUE), image == "photo"

    def touch(frame: Frame) -> None:
        cv2.sumElems(frame[image].rgb if is_photo else frame[image])

    def run(frame: Frame) -> object:
        return detector.detect(*frame[image]) if is_photo else detector.detect_mask(frame[image])

    return Method((grows, amount, image), run, touch=touch)
