"""Measure the stages from an RGB-D frame to 20 points in space, at the sizes of real cameras, and the memory."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from shape_obs.bench import Clock, Size
from shape_obs.bench.interleaved_timing import Method, Tick, Turn, by_method, interleaved_timing, median_ms
from shape_obs.bench.synthetic.images import BLUE
from shape_obs.bench.synthetic.streams import RGBD, classic, streams
from shape_obs.bench.tables import Row, at_least, at_most, median
from shape_obs.configurations.centerline import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.utils.threads import one_thread

Frame = Mapping[Size, RGBD]

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


Latencies = dict[tuple[Size, str], list[Turn]]  # size and method -> the turns


def latencies(
    sizes: tuple[Size, ...], frames: int, seed: int, clock: Clock = "wall", burst: int = 1, tick: Tick = lambda: None
) -> Latencies:
    """Time the pipeline, one pass over the image and classic segmentation at every size, in turns on one thread.

    Args:
        sizes: (width, height) of the images in pixels.
        frames: Number of counted frames.
        seed: Seed of motion, light and noise.
        clock: The clock. The detector's own stages are always timed by the wall clock.
        burst: Frames in a turn.
        tick: Called after each frame.
    """
    methods = [method for size in sizes for method in _methods(size)]
    seen = streams(sizes, frames + WARM_UP, seed)
    turns = interleaved_timing(seen, methods, clock, burst=burst, warm_up=WARM_UP, tick=tick)
    return by_method(methods, turns)


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


def memory_growth(frames: int, seed: int, *, warm_up: int = 1000, tick: Tick = lambda: None) -> float | None:
    """Return by how many megabytes the process grows while a detector tracks a rope, loses it and finds it again.

    Args:
        frames: Number of RGB-D frames, 320 x 240.
        seed: Seed of motion, light and noise.
        warm_up: Frames before the first measurement of the process.
        tick: Called after each frame.

    Returns:
        None where the system does not report the size of a process.
    """
    scenes = [frame[_MEMORY_SIZE] for frame in streams((_MEMORY_SIZE,), _SCENES, seed)]
    scenes += scenes[-2:0:-1]
    gone = scenes[0]._replace(rgb=scenes[0].rgb[..., ::-1].copy())  # red instead of blue
    detector = ShapeDetector([Centerline(n=20)], BLUE)
    before: float | None = None
    with one_thread():
        for i in range(warm_up + frames):
            if i == warm_up:
                before = resident()
            detector.detect(*(gone if i % _LOST == _LOST - 1 else scenes[i % len(scenes)]))
            tick()
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


def _name(size: Size) -> str:
    return f"{size[0]} x {size[1]}"
