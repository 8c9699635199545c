"""Ropes that cross themselves, are cut by an occluder, or run beside themselves: how they are found cold, how fast.

The tests run slices of this; the timings are for reading only.

How long a cold start takes on tangled masks, beside thinning by scikit-image and the longest path through it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from shape_obs.bench.synthetic.tangles import Tangle, crossing_rope, cut_rope, is_traversed, touching_rope
from shape_obs.configurations import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.polyline import arc_length
from shape_obs.image.region import find_region
from shape_obs.image.roi import Window
from shape_obs.image.segmentation import Segmentation
from shape_obs.initialization.medial_axis import trace
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
    return Centerline(n=N).parameterise(find_region(mask, window, Segmentation.min_area, Segmentation.min_share))


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


Array = npt.NDArray[np.float64]


class ColdSpeed(NamedTuple):
    """Milliseconds per mask.

    Args:
        ours: Median of `find_region` and `trace`.
        peer: Median of the skeleton of scikit-image and the longest path through its pixels.
        ratio: Median over the masks of ours over the peer's, on the same mask in the same run.
    """

    ours: float
    peer: float
    ratio: float


def cold_speed(masks: list[Mask], *, min_area: int = 20, min_share: float = 0.05) -> ColdSpeed:
    """Time the cold start on whole-image masks, in turn with its peer.

    Args:
        masks: (H,W) uint8 each.
        min_area: Of `find_region`.
        min_share: Of `find_region`.

    Raises:
        RuntimeError: scikit-image is not installed.
    """
    try:
        from skimage.morphology import skeletonize
    except ImportError as error:
        raise RuntimeError("cold_speed: the peer needs scikit-image: pip install scikit-image") from error

    def ours(mask: Mask) -> object:
        window = Window(0, 0, mask.shape[1], mask.shape[0])
        return trace(find_region(mask, window, min_area, min_share))

    def peer(mask: Mask) -> object:
        return longest_path(np.asarray(skeletonize(mask > 0)))

    taken = np.array([[_seconds(run, mask) for run in (ours, peer)] for mask in masks])
    median = np.median(taken, axis=0) * 1e3
    return ColdSpeed(float(median[0]), float(median[1]), float(np.median(taken[:, 0] / taken[:, 1])))


def longest_path(skeleton: npt.NDArray[np.bool_]) -> Array:
    """The longest of the shortest paths between pixels of a skeleton, by two sweeps: (P,2) pixels (u, v)."""
    rows, columns = np.nonzero(skeleton)
    index = np.full((skeleton.shape[0] + 2, skeleton.shape[1] + 2), -1)
    index[rows + 1, columns + 1] = np.arange(len(rows))
    first, second, length = [], [], []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        there = index[rows + 1 + down, columns + 1 + right]
        first.append(np.flatnonzero(there >= 0))
        second.append(there[there >= 0])
        length.append(np.full(len(second[-1]), np.hypot(down, right)))
    # Older SciPy's graph functions take no other integers.
    pairs = tuple(np.concatenate(ends).astype(np.int32) for ends in (first, second))
    graph = coo_array((np.concatenate(length), pairs), shape=(len(rows), len(rows))).tocsr()
    reached = dijkstra(graph, directed=False, indices=0)
    start = int(np.argmax(np.where(np.isfinite(reached), reached, -1)))
    reached, came = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
    path = [int(np.argmax(np.where(np.isfinite(reached), reached, -1)))]
    while came[path[-1]] >= 0:
        path.append(int(came[path[-1]]))
    return np.stack([columns[path], rows[path]], axis=1).astype(np.float64)


def _seconds(run: Callable[[Mask], Any], mask: Mask) -> float:
    start = time.perf_counter()
    run(mask)
    return time.perf_counter() - start
