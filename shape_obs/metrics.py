"""How good N points are: as cluster centres of M pixels, in their spacing, and against a known curve.

References:
    P. J. Rousseeuw, "Silhouettes: a graphical aid to the interpretation and validation of cluster analysis", Journal of
    Computational and Applied Mathematics 20, 1987.
    T. Calinski and J. Harabasz, "A dendrite method for cluster analysis", Communications in Statistics 3, 1974.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import cdist

from shape_obs.geometry.polyline import nearest_on
from shape_obs.geometry.topology import Grid, Topology

Array = npt.NDArray[np.float64]
Labels = npt.NDArray[np.intp]

_BLOCK: Final = 2_000_000  # distances at a time: 16 MB
# By so much the bounds are widened, so that rounding never throws away the nearest cluster.
_ROUNDING: Final = 1e-9


def nearest(points: npt.ArrayLike, centres: npt.ArrayLike) -> Labels:
    """Return ``(M,)`` the index of the centre that is nearest to each point: ``(M, D)``, ``(K, D)`` -> ``(M,)``."""
    data, nodes = np.asarray(points, dtype=np.float64), np.asarray(centres, dtype=np.float64)
    middle = data.mean(axis=0)
    nodes = nodes - middle
    return np.argmax((data - middle) @ nodes.T - 0.5 * np.sum(nodes**2, axis=1), axis=1)


def silhouette(points: npt.ArrayLike, labels: npt.ArrayLike, *, sample: int | None = None, seed: int = 0) -> float:
    """Return the mean of (b - a) / max(a, b): a and b are a point's mean distances to its own and the nearest cluster.

    Distances are exact and to all points. Only few clusters need them: the mean distance of x to cluster c lies between
    ``|x - mean_c|`` and ``sqrt(|x - mean_c|^2 + variance_c)``.

    Args:
        points: ``(M, D)``.
        labels: ``(M,)`` whole numbers.
        sample: Of how many points, drawn at random, the mean is taken; None takes all. a and b are exact still.
        seed: Of the lot.

    Raises:
        ValueError: Shapes that do not fit together, fewer than 2 clusters, or as many as points.
    """
    clusters = _clusters(points, labels)
    chosen: slice | Labels = slice(None)
    if sample is not None and sample < len(clusters.points):
        if sample < 1:
            raise ValueError(f"sample: expected None or at least 1, got {sample}.")
        chosen = np.random.default_rng(seed).choice(len(clusters.points), sample, replace=False)
    x, own = clusters.points[chosen], clusters.label[chosen]
    row = np.arange(len(x))
    low = cdist(x, clusters.mean)
    high = np.sqrt(low**2 + clusters.variance)
    high[row, own] = np.inf
    needed = low <= high.min(axis=1, keepdims=True) * (1 + _ROUNDING)
    needed[row, own] = True
    total = np.full(low.shape, np.inf)
    for k, members in enumerate(clusters.members()):
        asking = np.flatnonzero(needed[:, k])
        for block in np.array_split(asking, max(-(-len(asking) * len(members) // _BLOCK), 1)):
            total[block, k] = cdist(x[block], members).sum(axis=1)
    a = total[row, own] / np.maximum(clusters.size[own] - 1, 1)
    total[row, own] = np.inf
    b = (total / clusters.size).min(axis=1)
    largest = np.maximum(a, b)
    # A cluster of one has no silhouette, and neither have clusters that lie in one place.
    defined = (clusters.size[own] > 1) & (largest > 0)
    return float(np.mean(np.where(defined, (b - a) / np.where(defined, largest, 1.0), 0.0)))


def calinski_harabasz(points: npt.ArrayLike, labels: npt.ArrayLike) -> float:
    """Return the variance between clusters over variance within them, each by its degrees of freedom; it grows with M.

    Args:
        points: ``(M, D)``.
        labels: ``(M,)`` whole numbers; ``nearest`` gives those of centres.

    Raises:
        ValueError: Shapes that do not fit together, fewer than 2 clusters, or as many as points.
    """
    clusters = _clusters(points, labels)
    size, groups = len(clusters.points), len(clusters.size)
    between = float(clusters.size @ np.sum((clusters.mean - clusters.points.mean(axis=0)) ** 2, axis=1))
    within = float(clusters.size @ clusters.variance)
    return 1.0 if within == 0 else between * (size - groups) / (within * (groups - 1))


def spacing_cv(points: npt.ArrayLike, layout: Topology, valid: npt.NDArray[np.bool_] | None = None) -> float:
    """Return standard deviation over mean of the gaps between neighbours; on a lattice that of the worse direction.

    Args:
        points: ``(N, D)`` in order.
        layout: How they are connected.
        valid: ``(N,)`` bool: only gaps between two such points count; None counts all.

    Returns:
        0 for equal gaps; NaN where there is no gap to count.
    """
    places, edges = np.asarray(points, dtype=np.float64), layout.edges()
    if valid is not None:
        edges = edges[valid[edges].all(axis=1)]
    gap = np.linalg.norm(places[edges[:, 1]] - places[edges[:, 0]], axis=1)
    right = edges[:, 1] - edges[:, 0] == 1
    ways = (gap[right], gap[~right]) if isinstance(layout, Grid) else (gap,)
    return max((float(way.std() / way.mean()) for way in ways if len(way)), default=float("nan"))


def distance(points: npt.ArrayLike, curve: npt.ArrayLike, *, closed: bool = False) -> Array:
    """Return the exact distances ``(N,)`` of ``(N, D)`` points to a polyline ``(P, D)``, closed if ``closed``."""
    line = np.asarray(curve, dtype=np.float64)
    return nearest_on(np.concatenate([line, line[:1]]) if closed else line, np.asarray(points))[1]


def coverage(points: npt.ArrayLike, layout: Topology, pixels: npt.ArrayLike, reach: float) -> float:
    """Return the share of an object that lies near its points as they are joined, 0...1.

    Args:
        points: ``(N, D)`` in order.
        layout: How they are connected: a chain or ring is the polyline through them, a lattice the sheet of its cells,
            each as two triangles.
        pixels: ``(M, D)`` the object, all of it.
        reach: How far off an object's pixel may lie, in the unit of ``points``: of a rope half its width. Points at the
            centres of equal pieces leave half a gap at each end, which counts as not covered beyond this.
    """
    places, grains = np.asarray(points, dtype=np.float64), np.asarray(pixels, dtype=np.float64)
    off = np.full(len(grains), np.inf)
    for pair in layout.edges():
        off = np.minimum(off, nearest_on(places[pair], grains)[1])
    if isinstance(layout, Grid):
        for corners in _triangles(layout):
            off = np.where(_faces(places[corners], grains, reach), 0.0, off)
    return float(np.mean(off <= reach))


def in_order(places: npt.ArrayLike, period: float | None = None) -> bool:
    """Return whether ``(N,)`` places along a curve strictly increase; around a closed one of length ``period`` once."""
    along = np.asarray(places, dtype=np.float64)
    if period is None:
        return bool(np.all(np.diff(along) > 0))
    step = np.diff(along, append=along[:1]) % period
    return bool(np.all(step > 0) and abs(step.sum() / period - 1) < 0.5)


class _Clusters(NamedTuple):
    """Points by cluster: ``(M, D)``, ``(M,)`` labels from 0, and of each cluster its size, mean and total variance."""

    points: Array
    label: Labels
    size: npt.NDArray[np.int64]
    mean: Array
    variance: Array

    def members(self) -> Iterator[Array]:
        """Return the points of each cluster."""
        sorted_points = self.points[np.argsort(self.label, kind="stable")]
        yield from np.split(sorted_points, np.cumsum(self.size)[:-1])


def _clusters(points: npt.ArrayLike, labels: npt.ArrayLike) -> _Clusters:
    data, given = np.asarray(points, dtype=np.float64), np.asarray(labels)
    if data.ndim != 2 or given.shape != data.shape[:1]:
        raise ValueError(f"expected points (M, D) and labels (M,), got {data.shape} and {given.shape}.")
    held, label = np.unique(given, return_inverse=True)
    label = label.reshape(-1)
    if not 2 <= len(held) < len(data):
        raise ValueError(f"expected 2 clusters or more, and fewer than points; got {len(held)} of {len(data)} points.")
    count = np.bincount(label)
    mean = np.stack([np.bincount(label, weights=column) for column in data.T], axis=1) / count[:, None]
    variance = np.bincount(label, weights=np.sum((data - mean[label]) ** 2, axis=1)) / count
    return _Clusters(data, label, count, mean, variance)


def _triangles(layout: Grid) -> Iterator[Labels]:
    """Return two triangles for each cell of a lattice, as indices ``(3,)``."""
    at = np.arange(layout.size).reshape(layout.rows, layout.cols)
    for cell in np.stack([at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]], axis=-1).reshape(-1, 4):
        yield cell[[0, 1, 2]]
        yield cell[[0, 2, 3]]


def _faces(triangle: Array, points: Array, reach: float) -> npt.NDArray[np.bool_]:
    """Return whether a point's foot on the plane of a triangle ``(3, D)`` lies within it, at most ``reach`` away."""
    sides, away = triangle[1:] - triangle[0], points - triangle[0]
    gram = sides @ sides.T
    if np.linalg.det(gram) <= 1e-12 * gram.trace() ** 2:  # no area: its sides are enough
        return np.zeros(len(points), bool)
    share = np.linalg.solve(gram, sides @ away.T).T
    inside = (share >= 0).all(axis=1) & (share.sum(axis=1) <= 1)
    return inside & (np.sum((away - share @ sides) ** 2, axis=1) <= reach**2)
