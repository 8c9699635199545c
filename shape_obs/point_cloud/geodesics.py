"""The axis of a rope-like cloud by geodesic distance: strands joined end to end across gaps, or closed to a ring.

Geodesic distance over the links between samples is arc length along the rope, however it bends: the two samples that
lie farthest apart are its ends, and the samples at equal distance from one of them are its slices.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.observed import Samples
from shape_obs.geometry.polyline import arc_length, catmull_rom, resample
from shape_obs.point_cloud.voxels import Indices

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_SHORT: Final = 2.5  # widths: a piece shorter than this is a straight line
_SIDE: Final = 0.2  # of a loop's samples, that lie on either side of it at least
_POINTS: Final = 129
_REACH: Final = 3.0  # widths: from how far inside of an end its direction is taken
# A bridge of more than so many widths that turns its strands by more than this (the sum of 1 - cos at both ends; a
# hidden half turn has 2) joins what no single rope would.
_JUMP: Final = 3.0
_TURN: Final = 1.5
_RING_GAP: Final = 0.25  # of an interrupted ring's length: what it misses at most where its ends meet


def strand(samples: Samples, graph: csr_matrix, piece: Indices, width: float) -> Array:
    """Return the axis of one connected piece from end to end: ``(P, 3)`` metres, P >= 2, about a width apart.

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
    """Return the axis of a piece that closes on itself, ``(P, 3)`` in metres, no point repeated; else None.

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
        _slices(points[side], weight[side], distance[side], width)[0] for side in (between[label == k] for k in sides)
    )
    near, met = (
        np.average(points[where], axis=0, weights=weight[where])[None]
        for where in (distance < width, distance > far - width)
    )
    return np.concatenate([near, one, met, other[::-1]])


def _from(graph: csr_matrix, start: int) -> Array:
    return np.asarray(dijkstra(graph, directed=False, indices=start))


def _slices(points: Array, weight: Array, distance: Array, thickness: float) -> tuple[Array, Array]:
    """Return the centroids of slices at equal distance, ``(P, 3)``, and the mean distance of each, ``(P,)``."""
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
    """Return a straight line through a short piece, as long as a uniform one of its variance."""
    middle = np.average(points, axis=0, weights=weight)
    offset = points - middle
    values, axes = np.linalg.eigh((weight[:, None] * offset).T @ offset / weight.sum())
    half = np.sqrt(3 * max(values[-1], 1e-18)) * axes[:, -1]
    return np.stack([middle - half, middle + half])


def _outward(last: Array, before: Array, reach: float) -> Array:
    step = last - before
    return last + step * (reach / max(float(np.linalg.norm(step)), 1e-12))


class Chain(NamedTuple):
    """An axis from tip to tip.

    Args:
        points: ``(P, 3)`` metres, evenly spread.
        bridged: ``(P,)`` bool: in a gap.
        doubt: Why no single rope can be like that; empty if one can.
    """

    points: Array
    bridged: Mask
    doubt: str


def chain(samples: Samples, graph: csr_matrix, components: Sequence[Indices], width: float) -> Chain:
    """Join the strands of a cloud, nearest and straightest first.

    Args:
        samples: Of the cloud.
        graph: Their links.
        components: Indices of each connected piece's samples.
        width: Of the rope, metres.
    """
    strands = [strand(samples, graph, piece, width) for piece in components]
    gaps: list[tuple[Array, Array]] = []
    doubt = ""
    while len(strands) > 1:
        options = [
            (*_bridge(strands[i][::a], strands[j][::b], width), i, j, a, b)
            for i, j in combinations(range(len(strands)), 2)
            for a, b in product((-1, 1), (1, -1))
        ]
        length, turn, i, j, a, b = min(options, key=lambda option: option[0] * (1 + option[1]))
        if length > _JUMP * width and turn > _TURN:
            doubt = f"the cloud falls into pieces that no single rope joins: a gap of {length:.3f} m at a sharp turn"
        after, before = strands.pop(j)[::b], strands.pop(i)[::a]
        gaps.append((before[-1], after[0]))
        strands.append(np.concatenate([before, after]))
    return Chain(resample(strands[0], _POINTS), _within(strands[0], gaps), doubt)


def ring(samples: Samples, graph: csr_matrix, components: Sequence[Indices], width: float) -> Array | None:
    """Return the axis of a closed rope, gaps bridged, ``(P, 3)`` in metres, smooth and even; else None."""
    around = loop(samples, graph, components[0], width) if len(components) == 1 else None
    if around is None:
        broken = chain(samples, graph, components, width)
        length = float(arc_length(broken.points)[-1])
        gap = float(np.linalg.norm(broken.points[0] - broken.points[-1]))
        if broken.doubt or gap > _RING_GAP * length:
            return None
        around = resample(broken.points, max(round(length / width), 8))
    curve = FittedCurve.through(catmull_rom(around, 4, True), np.zeros(4 * len(around), bool), closed=True)
    return curve.even(max(round(4 * curve.size / width), 32))


def _bridge(before: Array, after: Array, width: float) -> tuple[float, float]:
    """Return the length of a straight bridge, and how far it turns from both strands: the sum of 1 - cos."""
    gap = after[0] - before[-1]
    length = float(np.linalg.norm(gap))
    ways = (before[-1] - _inside(before[::-1], width), _inside(after, width) - after[0])
    sizes = (max(length * float(np.linalg.norm(way)), 1e-18) for way in ways)
    return length, sum(1 - float(gap @ way) / size for way, size in zip(ways, sizes, strict=True))


def _inside(curve: Array, width: float) -> Array:
    """Return the point of a curve a few widths from its start."""
    return curve[min(int(np.searchsorted(arc_length(np.ascontiguousarray(curve)), _REACH * width)), len(curve) - 1)]


def _within(axis: Array, gaps: Sequence[tuple[Array, Array]]) -> Mask:
    """Return which of evenly spread points of an axis lie in a gap, given by the axis' points at both its sides."""
    arc = arc_length(np.ascontiguousarray(axis))
    at = np.linspace(0, arc[-1], _POINTS)
    inside = np.zeros(_POINTS, bool)
    for ends in gaps:
        first, last = sorted(float(arc[np.argmin(np.sum((axis - end) ** 2, axis=1))]) for end in ends)
        inside |= (at > first) & (at < last)
    return inside
