"""How long the stages take from an RGB-D frame to 20 points in space, at the sizes of real cameras.

How much the process grows while one detector sees frame after frame.
"""

from __future__ import annotations

import gc
import os
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np

from shape_obs.bench.backends import LABELS, Backend, backends, ours
from shape_obs.bench.interleaved_timing import Clock, Entrant, turns
from shape_obs.bench.synthetic.streams import BLUE, RGBD, Size, classic, streams
from shape_obs.bench.tables import at_least, at_most
from shape_obs.configurations import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.shape import Detection
from shape_obs.utils.threads import one_thread

Row = dict[str, Any]

Frame = Mapping[Size, RGBD]


WARM_UP: Final = 5  # frames that are not counted

ONE_PASS: Final = "one pass: sumElems"

CLASSIC: Final = "classic segmentation, full frame"

SMALL: Final[Size] = (640, 480)

LARGE: Final[Size] = (1280, 800)

# What is asked at 640 x 480, warm: at most so many passes, and so many times faster than the classic segmentation.
_PASSES: Final[dict[Backend, float]] = {"numpy": 40, "numba": 6}

_FASTER: Final[dict[Backend, float]] = {"numpy": 4, "numba": 20}

_LARGER: Final = 3.0


@dataclass
class Latency:
    """What one method took at one size.

    Args:
        milliseconds: Of each frame.
        stages: Milliseconds by stage of each frame, as the detector tells them.
        refused: Frames without a shape.
    """

    milliseconds: list[float] = field(default_factory=list)
    stages: list[Mapping[str, float]] = field(default_factory=list)
    refused: int = 0

    @property
    def median(self) -> float:
        """Milliseconds."""
        return float(np.median(self.milliseconds))

    @property
    def late(self) -> float:
        """Milliseconds that 95 % of the frames keep to."""
        return float(np.percentile(self.milliseconds, 95))


Latencies = dict[tuple[Size, str], Latency]


def latencies(
    sizes: tuple[Size, ...],
    frames: int,
    seed: int,
    clock: Clock = "wall",
    burst: int = 1,
    tick: Callable[[], Any] = lambda: None,
) -> Latencies:
    """Time the whole pipeline beside one pass over the image and beside the classic segmentation.

    Every method at every size runs on every frame, in turn, on one thread.

    Args:
        sizes: (width, height) of the images, pixels.
        frames: How many are counted.
        seed: Of motion, light and noise.
        clock: What counts the time; the stages are told by the detector, in time that passes.
        burst: Frames in a turn.
        tick: Called after each frame.

    Returns:
        Size, method -> times.
    """
    found: Latencies = defaultdict(Latency)
    keys: dict[str, tuple[Size, str]] = {}
    entrants: list[Entrant[Frame]] = []
    for size in sizes:
        for entrant in _entrants(size):
            keys[entrant.name] = size, entrant.name.split(" | ")[1]
            entrants.append(entrant)
    with one_thread():
        for turn in turns(_ticking(streams(sizes, frames + WARM_UP, seed), tick), entrants, clock, burst=burst):
            if turn.frame < WARM_UP:
                continue
            latency = found[keys[turn.name]]
            latency.milliseconds.append(turn.milliseconds)
            if isinstance(turn.result, Detection):
                latency.stages.append(turn.result.timings)
                latency.refused += not turn.result.ok
    return {key: found[key] for key in keys.values()}


def total_rows(found: Latencies) -> list[Row]:
    """A row for each size and method."""
    rows = []
    for (size, method), latency in found.items():
        passes, segmented = found[size, ONE_PASS].median, found[size, CLASSIC].median
        row = {"image": _name(size), "method": method, "median_ms": latency.median, "p95_ms": latency.late}
        row |= {"passes": latency.median / passes, "faster_than_classic": segmented / latency.median}
        rows.append(row | {"refused": latency.refused})
    return rows


def stage_rows(found: Latencies) -> list[Row]:
    """A row for each size and way of running the detector: the median of each stage, milliseconds."""
    told = {key: latency.stages for key, latency in found.items() if latency.stages}
    names = list(dict.fromkeys(stage for stages in told.values() for timings in stages for stage in timings))
    return [
        {"image": _name(size), "method": method}
        | {name: float(np.median([timings.get(name, 0.0) for timings in stages])) for name in names}
        for (size, method), stages in told.items()
    ]


def latency_claims(found: Latencies) -> list[Row]:
    """What is asked of the whole pipeline, what was seen."""
    rows = []

    def median(size: Size, method: str) -> float | None:
        return found[size, method].median if (size, method) in found else None

    for backend, label in LABELS.items():
        mine, larger = median(SMALL, ours(backend, "warm")), median(LARGE, ours(backend, "warm"))
        what = f"{_name(SMALL)} image to 20 points in 3D, {label}, warm"
        passes = _over(mine, median(SMALL, ONE_PASS))
        rows.append(at_most(f"{what}: times one pass over the image", _PASSES[backend], passes))
        faster = _over(median(SMALL, CLASSIC), mine)
        rows.append(at_least(f"{what}: times faster than classic segmentation", _FASTER[backend], faster))
        rows.append(at_most(f"{_name(LARGE)} against {_name(SMALL)}, {label}, warm", _LARGER, _over(larger, mine)))
    return rows


def _entrants(size: Size) -> Iterator[Entrant[Frame]]:
    def touch(frame: Frame) -> None:
        cv2.sumElems(frame[size].rgb)
        frame[size].depth.max()

    def name(method: str) -> str:
        return f"{_name(size)} | {method}"

    yield Entrant(name(ONE_PASS), lambda frame: cv2.sumElems(frame[size].rgb), touch=touch)
    yield Entrant(name(CLASSIC), lambda frame: classic(frame[size].rgb), touch=touch)
    for start in ("warm", "cold"):
        for backend in backends():
            detector = ShapeDetector([Centerline(n=20)], BLUE, backend=backend)
            run = _detection(detector, size)
            entrant = Entrant(name(ours(backend, start)), run, touch=touch)
            yield entrant if start == "warm" else Entrant(entrant.name, run, detector.reset, touch)


def _detection(detector: ShapeDetector, size: Size) -> Callable[[Frame], Detection]:
    return lambda frame: detector.detect(*frame[size])


def _over(value: float | None, other: float | None) -> float | None:
    return None if value is None or other is None else value / other


def _name(size: Size) -> str:
    return f"{size[0]} x {size[1]}"


def _ticking(frames: Iterable[Frame], tick: Callable[[], Any]) -> Iterator[Frame]:
    for frame in frames:
        yield frame
        tick()


MEMORY_WARM_UP: Final = 1_000  # frames after which the process is weighed first

SIZE: Final = (320, 240)

_SCENES: Final = 60  # played forwards and backwards

_LOST: Final = 200  # each time after so many frames the object is out of sight

_MEMORY_TARGET: Final = 5.0  # megabytes

_MEGABYTE: Final = 1e6


def memory_growth(
    frames: int,
    seed: int,
    *,
    backend: Literal["auto", "numpy", "numba"] = "auto",
    warm_up: int = MEMORY_WARM_UP,
    tick: Callable[[], Any] = lambda: None,
) -> float | None:
    """Megabytes by which the process grows while a detector follows a rope, loses it and finds it again.

    Args:
        frames: How many, RGB-D, 320 x 240.
        seed: Of motion, light and noise.
        backend: What the detector runs on.
        warm_up: Frames before, after which the process is weighed for the first time.
        tick: Called after each frame.

    Returns:
        None where the system does not tell a process's size.
    """
    scenes = [frame[SIZE] for frame in streams((SIZE,), _SCENES, seed)]
    scenes += scenes[-2:0:-1]
    gone = scenes[0]._replace(rgb=scenes[0].rgb[..., ::-1].copy())  # red instead of blue
    detector = ShapeDetector([Centerline(n=20)], BLUE, backend=backend)
    before: float | None = None
    with one_thread():
        for i in range(warm_up + frames):
            if i == warm_up:
                before = resident()
            detector.detect(*(gone if i % _LOST == _LOST - 1 else scenes[i % len(scenes)]))
            tick()
    after = resident()
    return None if before is None or after is None else after - before


def memory_claims(frames: int, grown: float | None) -> list[dict[str, Any]]:
    """What is asked of the memory, what was seen."""
    return [at_most(f"growth of the process over {frames} frames through one detector", _MEMORY_TARGET, grown, " MB")]


def resident() -> float | None:
    """Megabytes of memory that the process holds; None where the system does not tell."""
    gc.collect()
    table = Path("/proc/self/statm")
    if table.is_file():
        return int(table.read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") / _MEGABYTE
    if sys.platform == "win32":
        return None
    import resource

    # The largest that it ever was: growth shows once it goes beyond. macOS counts bytes.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _MEGABYTE
