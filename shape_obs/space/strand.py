"""Strands: the axis of rope-like samples by geodesic distance, open or closed to a loop.

Geodesic distance over the links between samples is arc length along the rope, however it bends: the two samples that
lie farthest apart are its ends, and the samples at equal distance from one of them are its slices.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from shape_obs.samples import Samples
from shape_obs.space.voxels import Indices

Array = npt.NDArray[np.float64]

_SHORT: Final = 2.5  # widths: a piece shorter than this is a straight line
_SIDE: Final = 0.2  # of a loop's samples, that lie on either side of it at least


def strand(samples: Samples, graph: csr_matrix, piece: Indices, width: float) -> Array:
    """The axis of one connected piece from end to end: (P,3) metres, P >= 2, about a width apart.

    Args:
        samples: Of the whole cloud.
        graph: Their links.
        piece: Indices of the piece's samples.
        width: Of the rope, metres.
    """
    points, weight = samples.points[piece], samples.weight[piece]
    own = graph[piece][:, piece]
    distance = _from(own, int(np.argmax(_from(own, 0))))
    if distance.max() < _SHORT * width:
        return _line(points, weight)
    slices, reach = _slices(points, weight, distance, width)
    # The outer slices' centroids lie half a slice inside of the ends.
    head = _outward(slices[0], slices[1], reach[0])
    tail = _outward(slices[-1], slices[-2], float(distance.max()) - reach[-1])
    return np.concatenate([[head], slices, [tail]])


def loop(samples: Samples, graph: csr_matrix, piece: Indices, width: float) -> Array | None:
    """The axis of a connected piece that closes on itself: (P,3) metres, the first point not repeated; else None.

    The fronts that run from any sample meet on the loop's other side. Without the places where they part and meet, a
    loop falls into two sides, and nothing else does.
    """
    points, weight = samples.points[piece], samples.weight[piece]
    own = graph[piece][:, piece]
    distance = _from(own, 0)
    far = float(distance.max())
    between = np.flatnonzero((distance > 1.5 * width) & (distance < far - 1.5 * width))
    if len(between) < 4:
        return None
    count, label = connected_components(own[between][:, between], directed=False)
    mass = np.bincount(label, minlength=count)
    sides = np.argsort(-mass)[:2]
    if len(sides) < 2 or mass[sides].min() < _SIDE * len(between):
        return None
    one, other = (
        _slices(points[index], weight[index], distance[index], width)[0]
        for index in (between[label == side] for side in sides)
    )
    near, met = (
        np.average(points[where], axis=0, weights=weight[where])[None]
        for where in (distance < width, distance > far - width)
    )
    return np.concatenate([near, one, met, other[::-1]])


def _from(graph: csr_matrix, start: int) -> Array:
    return np.asarray(dijkstra(graph, directed=False, indices=start))


def _slices(points: Array, weight: Array, distance: Array, thickness: float) -> tuple[Array, Array]:
    """Centroids of slices at equal distance, (P,3), and the mean distance of each, (P,)."""
    low = float(distance.min())
    span = float(distance.max()) - low
    count = max(int(span / thickness), 1)
    index = np.minimum(((distance - low) * (count / max(span, 1e-12))).astype(int), count - 1)
    mass = np.bincount(index, weights=weight, minlength=count)
    held = mass > 0
    values = np.column_stack([points, distance])
    sums = np.stack([np.bincount(index, weights=weight * values[:, d], minlength=count) for d in range(4)], axis=1)
    means = sums[held] / mass[held, None]
    return means[:, :3], means[:, 3]


def _line(points: Array, weight: Array) -> Array:
    """A straight line through a short piece, as long as a uniform one of its variance."""
    middle = np.average(points, axis=0, weights=weight)
    offset = points - middle
    values, axes = np.linalg.eigh((weight[:, None] * offset).T @ offset / weight.sum())
    half = np.sqrt(3 * max(values[-1], 1e-18)) * axes[:, -1]
    return np.stack([middle - half, middle + half])


def _outward(last: Array, before: Array, reach: float) -> Array:
    step = last - before
    return last + step * (reach / max(float(np.linalg.norm(step)), 1e-12))
