"""Ropes that cross themselves, are cut by an occluder, or run beside themselves: how they are found cold, how fast.

The tests run slices of this; the timings are for reading only.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.bench.cold_speed import longest_path
from shape_obs.bench.tangles import Tangle, crossing_rope, cut_rope, is_traversed, touching_rope
from shape_obs.configurations import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.polyline import arc_length
from shape_obs.image.region import find_region
from shape_obs.image.roi import Window
from shape_obs.image.segmentation import Segmentation
from shape_obs.initialization.medial_axis import medial_axis
from shape_obs.shape import Shape

Mask = npt.NDArray[np.uint8]

SETS: Final[dict[str, Callable[[np.random.Generator], Tangle]]] = {
    "1 crossing": partial(crossing_rope, crossings=1),
    "2 crossings": partial(crossing_rope, crossings=2),
    "3 crossings": partial(crossing_rope, crossings=3),
    "cut, 16 px": partial(cut_rope, crossings=0, band=16),
    "cut, 50 px": partial(cut_rope, crossings=0, band=50),
    "crossing and cut, 16 px": partial(cut_rope, crossings=1, band=16),
    "crossing and cut, 50 px": partial(cut_rope, crossings=1, band=50),
    "side by side": touching_rope,
}
# Points, as many as tell which way a curve runs; the judge's pace needs them no farther apart than a width or two.
N: Final = 60


class TangleResult(NamedTuple):
    """Drawn ropes of one kind, each looked at cold.

    Args:
        rope: Which kind.
        masks: How many.
        right: Share that was found as the rope runs.
        refused: Share that was refused.
        silently_wrong: Share that was accepted and does not run as the rope does.
        hidden: Points that lie under the occluder, on the ropes that were found right.
        called_visible: How many of them were called visible.
        cold_ms: Of `find_region` and the start of the centerline, median.
        detector_ms: Of the whole `detect_mask`, median.
        peer_ms: Of thinning by scikit-image and the longest path through the skeleton, median; None where scikit-image
            is not installed (pip install scikit-image).
        ratio: Median over the masks of cold_ms over peer_ms on the same mask; None with it.
    """

    rope: str
    masks: int
    right: float
    refused: float
    silently_wrong: float
    hidden: int
    called_visible: int
    cold_ms: float
    detector_ms: float
    peer_ms: float | None
    ratio: float | None


def tangled_ropes(per_set: int, seed: int = 0) -> Iterator[TangleResult]:
    """Draw and find ropes of every kind, ``per_set`` of each."""
    for place, (name, draw) in enumerate(SETS.items()):
        rng = np.random.default_rng([seed, place])
        yield _measured(name, [draw(rng) for _ in range(per_set)])


def detected(mask: Mask) -> Shape:
    """A centerline of 60 points, found without a past."""
    return ShapeDetector([Centerline(n=N)]).detect_mask(mask).shapes[0]


def points_hidden(shape: Shape, tangle: Tangle) -> npt.NDArray[np.bool_]:
    """Which points of a shape that was found right belong under the occluder: (N,) bool.

    By their share of the rope's length, so that a bridge that bows differently makes no difference. A point within a
    gap of the occluder's edge may have slid across, and does not count.
    """
    arc = arc_length(tangle.curve)
    gap = arc[-1] / len(shape)
    at = (np.arange(len(shape)) + 0.5) * gap
    reached = [tangle.hidden[np.searchsorted(arc, np.clip(at + off, 0, arc[-1]))] for off in (-gap, 0.0, gap)]
    inside = np.logical_and.reduce(reached)
    forwards = np.linalg.norm(shape.pixels[[0, -1]] - tangle.curve[[0, -1]], axis=1).sum()
    backwards = np.linalg.norm(shape.pixels[[0, -1]] - tangle.curve[[-1, 0]], axis=1).sum()
    return inside if forwards <= backwards else inside[::-1]


def _measured(name: str, tangles: list[Tangle]) -> TangleResult:
    peer = _peer()
    runs = [_cold, detected] if peer is None else [_cold, detected, peer]
    # In turn on every mask: whatever else the machine does slows all of them.
    taken = np.array([[_seconds(run, tangle.mask) for run in runs] for tangle in tangles]) * 1e3
    shapes = [detected(tangle.mask) for tangle in tangles]
    pairs = list(zip(shapes, tangles, strict=True))
    found = [(shape, tangle) for shape, tangle in pairs if shape.ok]
    right = [(shape, tangle) for shape, tangle in found if is_traversed(shape.pixels, tangle)]
    hidden = [points_hidden(shape, tangle) for shape, tangle in right]
    return TangleResult(
        name,
        len(tangles),
        right=len(right) / len(tangles),
        refused=1 - len(found) / len(tangles),
        silently_wrong=(len(found) - len(right)) / len(tangles),
        hidden=int(sum(inside.sum() for inside in hidden)),
        called_visible=int(
            sum((inside & shape.visible).sum() for inside, (shape, _) in zip(hidden, right, strict=True))
        ),
        cold_ms=float(np.median(taken[:, 0])),
        detector_ms=float(np.median(taken[:, 1])),
        peer_ms=None if peer is None else float(np.median(taken[:, 2])),
        ratio=None if peer is None else float(np.median(taken[:, 0] / taken[:, 2])),
    )


def _cold(mask: Mask) -> object:
    window = Window(0, 0, mask.shape[1], mask.shape[0])
    return medial_axis(find_region(mask, window, Segmentation.min_area, Segmentation.min_share))


def _peer() -> Callable[[Mask], object] | None:
    """Thinning by scikit-image and the longest path; None without scikit-image."""
    if find_spec("skimage") is None:
        return None
    from skimage.morphology import skeletonize

    return lambda mask: longest_path(np.asarray(skeletonize(mask > 0)))


def _seconds(run: Callable[[Mask], object], mask: Mask) -> float:
    start = time.perf_counter()
    run(mask)
    return time.perf_counter() - start
