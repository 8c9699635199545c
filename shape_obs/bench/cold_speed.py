"""How long a cold start takes on tangled masks, beside thinning by scikit-image and the longest path through it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from shape_obs.image.region import find_region
from shape_obs.image.roi import Window
from shape_obs.initialization.medial_axis import trace

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]


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
