"""Measure cold starts on ropes that cross themselves, are cut by an occluder, or run next to themselves."""

from __future__ import annotations

import timeit
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from shape_obs.configurations.centerline import Centerline
from shape_obs.geometry.polyline import arc_length
from shape_obs.image.find_region import find_region
from shape_obs.image.roi import Window
from shape_obs.image.segmentation import Segmentation
from shape_obs.initialization.medial_axis import medial_axis
from shape_obs.shape import Shape
from tests.benchmarks import Mask, cold
from tests.benchmarks.rope_scores import is_traversed
from tests.benchmarks.scenes.tangles import Tangle, crossing_rope, cut_rope, touching_rope
from tests.benchmarks.tables import Row, median

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
# The comparison with the truth needs points no farther apart than a width or two.
N: Final = 60


def tangled_ropes(per_set: int, seed: int = 0) -> Iterator[Row]:
    """Draw and detect ``per_set`` ropes of every kind, each of them cold.

    Yields:
        ``rope``: the kind; ``right``: share that was found as the rope runs; ``refused``: share that was refused;
        ``silently_wrong``: share that was accepted and does not run as the rope does; ``hidden``: points under the
        occluder, on the ropes that were found right, and ``called_visible`` how many of them were reported visible;
        ``cold_ms``: median time of ``find_region`` and the start of the centerline; ``detector_ms``: that of
        ``detect_mask``; ``peer_ms``: that of thinning by scikit-image and the longest path; ``ratio``: median over the
        masks of ``cold_ms`` over ``peer_ms`` on the same mask. Without scikit-image both are None.
    """
    for index, (name, draw) in enumerate(SETS.items()):
        rng = np.random.default_rng([seed, index])
        yield _measured(name, [draw(rng) for _ in range(per_set)])


def detected(mask: Mask) -> Shape:
    """Detect a centerline of 60 points without a track."""
    return cold(Centerline(n=N), mask)


def points_hidden(shape: Shape, tangle: Tangle) -> npt.NDArray[np.bool_]:
    """Return which points of a rightly found shape belong under the occluder: ``(N,)`` bool.

    A point is located by its share of the rope's length, so that the form of a bridge makes no difference. Points
    within a gap of the occluder's edge do not count.
    """
    arc = arc_length(np.ascontiguousarray(tangle.curve))
    gap = arc[-1] / len(shape)
    at = (np.arange(len(shape)) + 0.5) * gap
    reached = [tangle.hidden[np.searchsorted(arc, np.clip(at + off, 0, arc[-1]))] for off in (-gap, 0.0, gap)]
    inside = np.logical_and.reduce(reached)
    ends = shape.pixels[[0, -1]]
    forwards, backwards = (np.linalg.norm(ends - tangle.curve[way], axis=1).sum() for way in ([0, -1], [-1, 0]))
    return inside if forwards <= backwards else inside[::-1]


def longest_path(skeleton: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
    """Return the longest shortest path between pixels of a skeleton, by two sweeps: ``(P, 2)`` pixels (u, v)."""
    rows, columns = np.nonzero(skeleton)
    index = np.full((skeleton.shape[0] + 2, skeleton.shape[1] + 2), -1)
    index[rows + 1, columns + 1] = np.arange(len(rows))
    first, second, length = [], [], []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        there = index[rows + 1 + down, columns + 1 + right]
        first.append(np.flatnonzero(there >= 0))
        second.append(there[there >= 0])
        length.append(np.full(len(second[-1]), np.hypot(down, right)))
    # The graph functions of older SciPy versions take only 32-bit integers.
    pairs = tuple(np.concatenate(ends).astype(np.int32) for ends in (first, second))
    graph = coo_array((np.concatenate(length), pairs), shape=(len(rows), len(rows))).tocsr()
    reached = dijkstra(graph, directed=False, indices=0)
    start = int(np.argmax(np.where(np.isfinite(reached), reached, -1)))
    reached, previous = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
    path = [int(np.argmax(np.where(np.isfinite(reached), reached, -1)))]
    while previous[path[-1]] >= 0:
        path.append(int(previous[path[-1]]))
    return np.stack([columns[path], rows[path]], axis=1).astype(np.float64)


def _measured(name: str, tangles: list[Tangle]) -> Row:
    runs: list[Callable[[Mask], object]] = [_start, detected]
    if find_spec("skimage") is not None:
        from skimage.morphology import skeletonize

        runs.append(lambda mask: longest_path(np.asarray(skeletonize(mask > 0))))
    # All methods run on every mask in turn, so that other load on the machine slows all of them.
    taken = np.array([[1e3 * timeit.timeit(partial(run, tangle.mask), number=1) for run in runs] for tangle in tangles])
    shapes = [detected(tangle.mask) for tangle in tangles]
    found = [(shape, tangle) for shape, tangle in zip(shapes, tangles, strict=True) if shape.ok]
    right = [(shape, tangle) for shape, tangle in found if is_traversed(shape.pixels, tangle)]
    hidden = [points_hidden(shape, tangle) for shape, tangle in right]
    cold_ms, detector_ms, *peer = np.median(taken, axis=0).tolist()
    return Row(
        rope=name,
        masks=len(tangles),
        right=len(right) / len(tangles),
        refused=1 - len(found) / len(tangles),
        silently_wrong=(len(found) - len(right)) / len(tangles),
        hidden=int(sum(inside.sum() for inside in hidden)),
        called_visible=int(sum((some & each.visible).sum() for some, (each, _) in zip(hidden, right, strict=True))),
        cold_ms=cold_ms,
        detector_ms=detector_ms,
        peer_ms=peer[0] if peer else None,
        ratio=median(taken[:, 0] / taken[:, 2]) if peer else None,
    )


def _start(mask: Mask) -> object:
    window = Window(0, 0, mask.shape[1], mask.shape[0])
    return medial_axis(find_region(mask, window, Segmentation.min_area, Segmentation.min_share))
