"""What thinning and contour tracing give for the same frames: as many points as the pixels happen to make."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Final, Literal

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.sheets import Sheet
from shape_obs.bench.table.frames import Name, Scene
from shape_obs.bench.turns import CLOCKS, Clock
from shape_obs.geometry.polyline import nearest_on
from shape_obs.metrics import in_order

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]
Tracing = Literal["thinning", "contours", "corners"]


@dataclass(frozen=True)
class Trace:
    """One tracing of one frame.

    Args:
        frame: Which one of the run.
        points: How many.
        start: Where the first of them lies on the material, as a share of the known curve's length.
        ordered: They follow each other along the known curve.
        tips: Of a thinned mask, pixels with one neighbour: a rope has two ends; else 0.
        ms: Milliseconds.
    """

    frame: int
    points: int
    start: float
    ordered: bool
    tips: int
    ms: float


def _thinned(mask: Mask) -> Array:
    from skimage.morphology import skeletonize

    left, top, width, height = cv2.boundingRect(mask)
    rows, columns = np.nonzero(skeletonize(mask[top : top + height, left : left + width] > 0))
    return np.stack([columns + left, rows + top], axis=1).astype(np.float64)


def _traced(approximation: int) -> Callable[[Mask], Array]:
    def trace(mask: Mask) -> Array:
        contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, approximation)
        return np.asarray(max(contours, key=cv2.contourArea), dtype=np.float64).reshape(-1, 2)

    return trace


_RUN: Final[dict[Tracing, Callable[[Mask], Array]]] = {
    "thinning": _thinned,
    "contours": _traced(cv2.CHAIN_APPROX_NONE),
    "corners": _traced(cv2.CHAIN_APPROX_SIMPLE),
}
OF: Final[dict[Tracing, Name]] = {"thinning": "centerline", "contours": "contour", "corners": "contour"}


def missing(tracing: Tracing) -> str:
    """Why a tracing cannot be run here; empty if it can."""
    if tracing == "thinning" and find_spec("skimage") is None:
        return "scikit-image is not installed (OpenCV's thinning is in opencv-contrib alone)"
    return ""


def traced(tracing: Tracing, chunk: Iterable[tuple[int, Scene]], clock: Clock = "wall") -> Iterator[Trace]:
    """A tracing over the numbered frames of one chunk."""
    run, now = _RUN[tracing], CLOCKS[clock]
    for frame, scene in chunk:
        assert not isinstance(scene.truth, Sheet)
        begin = now()
        points = run(scene.mask)
        ms = 1e3 * (now() - begin)
        closed = OF[tracing] == "contour"
        curve = np.concatenate([scene.truth, scene.truth[:1]]) if closed else scene.truth
        length = float(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum())
        arc = nearest_on(curve, points)[0]
        ordered = any(in_order(way, length if closed else None) for way in (arc, arc[::-1]))
        tips = 0 if closed else _tips(points)
        yield Trace(frame, len(points), float(arc[0]) / length, ordered, tips, ms)


def _tips(points: Array) -> int:
    """How many of (P,2) pixels have one neighbour among them."""
    low = points.min(axis=0).astype(int) - 1
    column, row = (points.astype(int) - low).T
    picture = np.zeros((row.max() + 2, column.max() + 2), np.uint8)
    picture[row, column] = 1
    around = cv2.filter2D(picture, -1, np.ones((3, 3), np.float32), borderType=cv2.BORDER_CONSTANT)
    return int(np.sum(around[row, column] == 2))
