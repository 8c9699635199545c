"""How the time of a frame grows with the size of the object, the number of points and the number of shapes.

What a further shape costs in one pass over a frame.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.backends import LABELS, Backend, backends
from shape_obs.bench.interleaved_timing import Clock, Entrant, turns
from shape_obs.bench.synthetic.disturbances import photographed
from shape_obs.bench.synthetic.ropes import SIZE, draw_rope
from shape_obs.bench.synthetic.sheets import draw_sheet, random_sheet
from shape_obs.bench.synthetic.streams import BLUE, RGBD, cloths, photo, pinhole, ropes
from shape_obs.bench.tables import at_most
from shape_obs.configurations import Centerline, Configuration, Contour, Surface
from shape_obs.detector import ShapeDetector
from shape_obs.image.segmentation import HSVRange
from shape_obs.utils.threads import one_thread

Array = npt.NDArray[np.float64]

Row = dict[str, Any]

Frame = dict[str, Any]  # name -> mask, (H,W) uint8, or RGB-D image


WARM_UP: Final = 5  # frames that are not counted

AREAS: Final = (0.1, 0.2, 0.5, 1.0)  # of the object's full area

COUNTS: Final = (20, 50, 100, 200)

ROPE: Final = "pixels of a rope"

CLOTH: Final = "pixels of a cloth"

POINTS: Final = "points on a rope"

NUMBER: Final = "shapes in one RGB-D image"

# What is asked: from the smallest to the largest a frame takes at most so many times as long.
_ASKED: Final = {ROPE: 2.0, CLOTH: 2.0, POINTS: 1.5, NUMBER: 2.5}

_SHAPES: Final[tuple[tuple[Configuration, ...], ...]] = (
    (Contour(),),
    (Contour(), Surface()),
    (Contour(), Contour(name="coarse", n=12), Surface()),
)


class _Case(NamedTuple):
    """One point of a growth curve: what grows, how much of it there is, what is looked for, and in which image."""

    grows: str
    amount: int | None  # None: as many as the mask has pixels
    shapes: tuple[Configuration, ...]
    image: str


_CASES: Final = (
    *(_Case(ROPE, None, (Centerline(n=20),), f"rope {area}") for area in AREAS),
    *(_Case(CLOTH, None, (Surface(rows=4, cols=8),), f"cloth {area}") for area in AREAS),
    *(_Case(POINTS, n, (Centerline(n=n),), f"rope {AREAS[-1]}") for n in COUNTS),
    *(_Case(NUMBER, len(shapes), shapes, "photo") for shapes in _SHAPES),
)


class Growth(NamedTuple):
    """One point of a growth curve, measured.

    Args:
        grows: What grows.
        amount: How much of it there is; of pixels the median over the frames.
        backend: What the detector ran on.
        median: Milliseconds of a frame.
    """

    grows: str
    amount: int
    backend: Backend
    median: float


def growths(frames: int, seed: int, clock: Clock = "wall", tick: Callable[[], Any] = lambda: None) -> list[Growth]:
    """Time tracked detectors on growing objects, points and shapes, 640 x 480, all in turn, on one thread.

    Pixels and points are timed from the mask to the points, shapes from the RGB-D image on.

    Args:
        frames: How many are counted.
        seed: Of the motions.
        clock: What counts the time.
        tick: Called after each frame.
    """
    cases: dict[str, tuple[_Case, Backend]] = {
        f"{i} {backend}": (case, backend) for i, case in enumerate(_CASES) for backend in backends()
    }
    spent: dict[str, list[float]] = defaultdict(list)
    pixels: dict[str, list[int]] = defaultdict(list)

    def instants() -> Iterator[Frame]:
        for frame in _frames(frames + WARM_UP, seed):
            for name, mask in frame.items():
                if not isinstance(mask, RGBD):
                    pixels[name].append(cv2.countNonZero(mask))
            yield frame
            tick()

    with one_thread():
        for turn in turns(instants(), [_entrant(name, *case) for name, case in cases.items()], clock, seed):
            if turn.frame >= WARM_UP:
                spent[turn.name].append(turn.milliseconds)
    return [
        Growth(case.grows, case.amount or int(np.median(pixels[case.image])), backend, float(np.median(spent[name])))
        for name, (case, backend) in cases.items()
    ]


def growth_rows(found: list[Growth]) -> list[Row]:
    """A row for each point of a growth curve."""
    rows = []
    for point in found:
        smallest = _curve(found, point.grows, point.backend)[0]
        row = {"grows": point.grows, "amount": point.amount, "backend": LABELS[point.backend]}
        rows.append(row | {"median_ms": point.median, "times_smallest": point.median / smallest.median})
    return rows


def growth_claims(found: list[Growth]) -> list[Row]:
    """What is asked of the growth, what was seen."""
    rows = []
    for grows, bound in _ASKED.items():
        for backend, label in LABELS.items():
            curve = _curve(found, grows, backend)
            seen = curve[-1].median / curve[0].median if curve else None
            ends = f" from {curve[0].amount} to {curve[-1].amount}" if curve else ""
            rows.append(at_most(f"{grows}{ends}, {label}", bound, seen))
    return rows


def _curve(found: list[Growth], grows: str, backend: Backend) -> list[Growth]:
    return [point for point in found if (point.grows, point.backend) == (grows, backend)]


def _frames(frames: int, seed: int) -> Iterator[Frame]:
    """A rope and a cloth at every size, about the middle of the image, and a photo of the cloth at its largest."""
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


def _entrant(name: str, case: _Case, backend: Backend) -> Entrant[Frame]:
    detector = ShapeDetector(case.shapes, BLUE, backend=backend)

    def touch(frame: Frame) -> None:
        image = frame[case.image]
        cv2.sumElems(image.rgb if isinstance(image, RGBD) else image)

    def run(frame: Frame) -> object:
        image = frame[case.image]
        return detector.detect(*image) if isinstance(image, RGBD) else detector.detect_mask(image)

    return Entrant(name, run, touch=touch)


_BLUE: Final = HSVRange(low=(100, 80, 25), high=(130, 255, 255))

_LISTS: Final[tuple[tuple[str, tuple[Configuration, ...]], ...]] = (
    ("contour", (Contour(),)),
    ("surface", (Surface(),)),
    ("contour + surface", (Contour(), Surface())),
    ("2 contours + surface", (Contour(), Contour(name="coarse", n=12), Surface())),
    ("2 contours + 2 surfaces", (Contour(), Contour(name="coarse", n=12), Surface(), Surface(name="fine", rows=8))),
)


class PassResult(NamedTuple):
    """One detector over the same frames, 640 x 480, tracked; medians in milliseconds.

    Args:
        shapes: What it looks for.
        number: How many shapes.
        frame_ms: Segmentation and region, once a frame.
        shapes_ms: Fitting and ordering, all shapes.
        total_ms: All of it.
        per_shape: The total over the first row's.
    """

    shapes: str
    number: int
    frame_ms: float
    shapes_ms: float
    total_ms: float
    per_shape: float


def shared_passes(frames: int = 60, seed: int = 0) -> Iterator[PassResult]:
    """Lists of shapes of growing length over one sheet; the detectors take turns on every frame."""
    rng = np.random.default_rng(seed)
    image = photographed(rng, random_sheet(rng, 1.6, 20.0).mask, 1.5, 4.0)
    detectors = [ShapeDetector(shapes, _BLUE) for _, shapes in _LISTS]
    spent: list[list[tuple[float, float, float]]] = [[] for _ in detectors]
    for _ in range(frames):
        for times, detector in zip(spent, detectors, strict=True):
            stages = detector.detect(image).timings
            frame = stages["segmentation"]
            times.append((frame, stages["fit"] + stages["lift"], stages["total"]))
    medians = [np.median(times[1:], axis=0) for times in spent]
    for (name, shapes), (frame, fit, total) in zip(_LISTS, medians, strict=True):
        yield PassResult(name, len(shapes), float(frame), float(fit), float(total), float(total / medians[0][2]))
