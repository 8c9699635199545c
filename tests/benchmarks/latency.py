"""Measure the stages from an RGB-D frame to 20 points in space at the sizes of real cameras, growth, and memory.

Growth: how the time of a frame grows with the size of the object, the number of points and of shapes.
"""

from __future__ import annotations

import gc
import os
import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.photos import BLUE
from shape_obs.bench.scenes import SIZE, draw_rope, draw_sheet
from shape_obs.configurations.base import Configuration
from shape_obs.configurations.centerline import Centerline
from shape_obs.configurations.contour import Contour
from shape_obs.configurations.surface import Surface
from shape_obs.detector import ShapeDetector
from shape_obs.utils.threads import one_thread
from tests.benchmarks import Size
from tests.benchmarks.interleaved_timing import Method, Timing, Turn, median_ms, time_methods
from tests.benchmarks.scenes.streams import RGBD, classic, cloths, photo, pinhole, ropes, streams
from tests.benchmarks.tables import Row, at_least, at_most, grouped, median

Array = npt.NDArray[np.float64]
Shapes = tuple[Configuration, ...]
Frame = Mapping[Size, RGBD]
Images = dict[str, Any]  # name -> mask, (H, W) uint8, or RGB-D image

WARM_UP: Final = 5  # frames that are not counted
ONE_PASS: Final = "one pass: sumElems"
CLASSIC: Final = "classic segmentation, full frame"
WARM, COLD = "shape_obs, warm", "shape_obs, cold"
SMALL: Final[Size] = (640, 480)
LARGE: Final[Size] = (1280, 800)
# Targets of a warm frame at 640 x 480: passes over the image, and times faster than classic segmentation.
_PASSES: Final = 6
_FASTER: Final = 20
_LARGER: Final = 3.0  # times longer at 1280 x 800
_MEGABYTE: Final = 1e6
_MEMORY_TARGET: Final = 5.0  # megabytes
_MEMORY_SIZE: Final[Size] = (320, 240)
_SCENES: Final = 60  # played forwards and backwards
_LOST: Final = 200  # the object is out of sight once in this number of frames
AREAS: Final = (0.1, 0.2, 0.5, 1.0)  # shares of the object's full area
COUNTS: Final = (20, 50, 100, 200)
ROPE: Final = "pixels of a rope"
CLOTH: Final = "pixels of a cloth"
POINTS: Final = "points on a rope"
NUMBER: Final = "shapes in one RGB-D image"
# Targets: by how many times a frame may take longer from the smallest to the largest.
_GROWTH_TARGETS: Final = {ROPE: 2.0, CLOTH: 2.0, POINTS: 1.5, NUMBER: 2.5}
_COARSE: Final = Contour(name="coarse", n=12)
_NUMBERS: Final[tuple[Shapes, ...]] = ((Contour(),), (Contour(), Surface()), (Contour(), _COARSE, Surface()))


# What grows, its amount (None is the number of pixels of the mask), the name of the image, and the shapes.
_CASES: Final[tuple[tuple[str, int | None, str, Shapes], ...]] = (
    *((ROPE, None, f"rope {area}", (Centerline(n=20),)) for area in AREAS),
    *((CLOTH, None, f"cloth {area}", (Surface(rows=4, cols=8),)) for area in AREAS),
    *((POINTS, n, f"rope {AREAS[-1]}", (Centerline(n=n),)) for n in COUNTS),
    *((NUMBER, len(shapes), "photo", shapes) for shapes in _NUMBERS),
)


Latencies = dict[tuple[Size, str], list[Turn]]  # size and method -> the turns


def latencies(sizes: tuple[Size, ...], frames: int, timing: Timing) -> Latencies:
    """Time the pipeline, one pass over the image and classic segmentation at every size, in turns on one thread.

    Args:
        sizes: (width, height) of the images in pixels.
        frames: Number of counted frames.
        timing: Clock and length of a turn; seed of motion, light and noise. The detector's own stages are always
            timed by the wall clock.
    """
    methods = [method for size in sizes for method in _methods(size)]
    seen = streams(sizes, frames + WARM_UP, timing.seed)
    return time_methods(seen, methods, timing, warm_up=WARM_UP)


def _methods(size: Size) -> Iterator[Method[Frame]]:
    def touch(frame: Frame) -> None:
        cv2.sumElems(frame[size].rgb)
        frame[size].depth.max()

    yield Method((size, ONE_PASS), lambda frame: cv2.sumElems(frame[size].rgb), touch=touch)
    yield Method((size, CLASSIC), lambda frame: classic(frame[size].rgb), touch=touch)
    warm, cold = ShapeDetector([Centerline(n=20)], BLUE), ShapeDetector([Centerline(n=20)], BLUE)
    yield Method((size, WARM), lambda frame: warm.detect(*frame[size]), touch=touch)
    yield Method((size, COLD), lambda frame: cold.detect(*frame[size]), cold.reset, touch)


def total_rows(found: Latencies) -> list[Row]:
    """Return a row for each size and method."""
    medians = {key: median_ms(turns) for key, turns in found.items()}
    return [
        Row(
            image=_name(size),
            method=method,
            median_ms=medians[size, method],
            p95_ms=float(np.percentile([turn.milliseconds for turn in turns], 95)),
            passes=medians[size, method] / medians[size, ONE_PASS],
            faster_than_classic=medians[size, CLASSIC] / medians[size, method],
            refused=sum(not turn.result.ok for turn in turns if method in (WARM, COLD)),
        )
        for (size, method), turns in found.items()
    ]


def stage_rows(found: Latencies) -> list[Row]:
    """Return a row for each size and start with the median of each stage in milliseconds."""
    staged = {key: [turn.result.timings for turn in turns] for key, turns in found.items() if key[1] in (WARM, COLD)}
    names = list(dict.fromkeys(stage for stages in staged.values() for timings in stages for stage in timings))
    return [
        Row(
            image=_name(size), method=method, **{name: median(each.get(name, 0.0) for each in stages) for name in names}
        )
        for (size, method), stages in staged.items()
    ]


def latency_targets(totals: Sequence[Row]) -> list[Row]:
    """Compare the rows of ``total_rows`` with the targets of the pipeline."""
    rows = {(row.image, row.method): row for row in totals}
    small, large = rows.get((_name(SMALL), WARM)), rows.get((_name(LARGE), WARM))
    what = f"{_name(SMALL)} image to 20 points in 3D, warm"
    larger = large.median_ms / small.median_ms if small and large else None
    return [
        at_most(f"{what}: times one pass over the image", _PASSES, small.passes if small else None),
        at_least(
            f"{what}: times faster than classic segmentation", _FASTER, small.faster_than_classic if small else None
        ),
        at_most(f"{_name(LARGE)} against {_name(SMALL)}, warm", _LARGER, larger),
    ]


def _name(size: Size) -> str:
    return f"{size[0]} x {size[1]}"


def growth_rows(frames: int, timing: Timing) -> list[Row]:
    """Time tracked detectors on growing objects, points and shapes, 640 x 480, in turns on one thread.

    Pixels and points are timed from the mask to the points, shapes from the RGB-D image on.

    Args:
        frames: Number of counted frames.
        timing: The clock, and the seed of the motions. Turns have one frame each.

    Returns:
        A row for each point of a growth curve: what grows, its amount (the median number of pixels), the median
        milliseconds of a frame, and the ratio to the smallest amount.
    """
    pixels: dict[str, list[int]] = defaultdict(list)

    def seen() -> Iterator[Images]:
        for frame in _images(frames + WARM_UP, timing.seed):
            for name, image in frame.items():
                if not isinstance(image, RGBD):
                    pixels[name].append(cv2.countNonZero(image))
            yield frame

    methods = [_growing(*case) for case in _CASES]
    found = time_methods(seen(), methods, timing._replace(burst=1), warm_up=WARM_UP, shuffled=True)
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
        at_most(
            f"{grows} from {curve[0].amount} to {curve[-1].amount}", _GROWTH_TARGETS[grows], curve[-1].times_smallest
        )
        for grows, curve in curves.items()
    ]


def _images(frames: int, seed: int) -> Iterator[Images]:
    """Draw a rope and a cloth at every size about the middle of the image, and a photo of the largest cloth."""
    rng, camera = np.random.default_rng(seed), pinhole((SIZE[1], SIZE[0]))
    for rope, sheet in zip(ropes(frames, seed), cloths(frames, seed), strict=True):
        frame: Images = {}
        for area in AREAS:
            scale = area**0.5
            frame[f"rope {area}"] = draw_rope(_shrunk(rope.curve, scale), rope.width * scale).mask
            frame[f"cloth {area}"] = draw_sheet(_shrunk(sheet.points, scale)).mask
        frame["photo"] = photo(rng, sheet.mask, camera)
        yield frame


def _shrunk(points: Array, scale: float) -> Array:
    middle = np.array([SIZE[1] - 1, SIZE[0] - 1]) / 2
    return (points - middle) * scale + middle


def _growing(grows: str, amount: int | None, image: str, shapes: Shapes) -> Method[Images]:
    detector, is_photo = ShapeDetector(shapes, BLUE), image == "photo"

    def touch(frame: Images) -> None:
        cv2.sumElems(frame[image].rgb if is_photo else frame[image])

    def run(frame: Images) -> object:
        return detector.detect(*frame[image]) if is_photo else detector.detect_mask(frame[image])

    return Method((grows, amount, image), run, touch=touch)


def memory_growth(frames: int, timing: Timing, *, warm_up: int = 1000) -> float | None:
    """Return by how many megabytes the process grows while a detector tracks a rope, loses it and finds it again.

    Args:
        frames: Number of RGB-D frames, 320 x 240.
        timing: Seed of motion, light and noise; the rest is ignored, except ``tick``.
        warm_up: Frames before the first measurement of the process.

    Returns:
        None where the system does not report the size of a process.
    """
    scenes = [frame[_MEMORY_SIZE] for frame in streams((_MEMORY_SIZE,), _SCENES, timing.seed)]
    scenes += scenes[-2:0:-1]
    gone = scenes[0]._replace(rgb=scenes[0].rgb[..., ::-1].copy())  # red instead of blue
    detector = ShapeDetector([Centerline(n=20)], BLUE)
    before: float | None = None
    with one_thread():
        for i in range(warm_up + frames):
            if i == warm_up:
                before = resident()
            detector.detect(*(gone if i % _LOST == _LOST - 1 else scenes[i % len(scenes)]))
            timing.tick()
    after = resident()
    return None if before is None or after is None else after - before


def memory_target(frames: int, grown: float | None) -> Row:
    """Compare the growth of the process with its target."""
    return at_most(f"growth of the process over {frames} frames through one detector", _MEMORY_TARGET, grown, " MB")


def resident() -> float | None:
    """Return the resident memory of the process in megabytes; None where the system does not report it."""
    gc.collect()
    table = Path("/proc/self/statm")
    if table.is_file():
        return int(table.read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") / _MEGABYTE
    if sys.platform == "win32":
        return None
    import resource

    # This is the peak: growth shows once the process exceeds it. macOS counts bytes.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _MEGABYTE
