"""Polylines in any dimension: arc length, interpolation, smooth curves, equidistant points."""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled

Array = npt.NDArray[np.float64]

# Chords are equalised this often, or until their gaps differ by no more than this share.
_EQUALISING_PASSES: Final = 40
_EQUAL: Final = 2e-3
# When chords are equalised, no point leaves its arc position by more than this share of a gap: where a hairpin is
# narrower than a gap, equal chords would move points off their material.
MAX_SHIFT: Final = 0.35
# Around an outline with many corners, each of which shortens a chord, equal chords need more room.
MAX_SHIFT_AROUND: Final = 1.5


@compiled("(f8[:,::1],)")
def arc_length(curve: Array) -> Array:
    """Return the arc length from the first point to each point: ``(P, D)`` -> ``(P,)``."""
    square = np.zeros(len(curve))
    for d in range(curve.shape[1]):
        for p in range(1, len(curve)):
            square[p] += (curve[p, d] - curve[p - 1, d]) ** 2
    return np.cumsum(np.sqrt(square))


@compiled("(f8[:,::1], f8[::1], f8[::1])")
def interpolate(curve: Array, arc: Array, at: Array) -> Array:
    """Return the points of a polyline at arc positions: ``(P, D)``, ``(P,)``, ``(N,)`` -> ``(N, D)``."""
    last, dimension = len(curve) - 1, curve.shape[1]
    out = np.empty((len(at), dimension))
    before = 0
    for n in range(len(at)):
        here = min(max(at[n], arc[0]), arc[last])
        if arc[before] > here or arc[min(before + 8, last)] < here:  # far from the one before
            before, beyond = 0, last
            while before < beyond:
                middle = (before + beyond + 1) // 2
                before, beyond = (middle, beyond) if arc[middle] < here else (before, middle - 1)
        while before < last - 1 and arc[before + 1] < here:
            before += 1
        after = min(before + 1, last)
        gap = arc[after] - arc[before]
        share = (here - arc[before]) / gap if gap > 0 else 0.0
        for d in range(dimension):
            out[n, d] = curve[before, d] + share * (curve[after, d] - curve[before, d])
    return out


@compiled("(f8[:,::1], i8, b1)")
def catmull_rom(nodes: Array, subdivisions: int, closed: bool) -> Array:
    """Return a smooth curve through nodes that may be unevenly spaced.

    Cubic Hermite pieces over the chord length with the three-point tangents of E. Catmull and R. Rom, "A Class of
    Local Interpolating Splines", 1974.

    Args:
        nodes: ``(K, D)``, K >= 3, no two neighbours equal.
        subdivisions: Pieces between two nodes.
        closed: Whether the last node is followed by the first.

    Returns:
        ``((K - 1) * subdivisions + 1, D)`` points, the nodes among them; ``(K * subdivisions, D)`` if closed.
    """
    size, dimension = nodes.shape
    pieces = size if closed else size - 1
    gap = np.empty(pieces)
    for k in range(pieces):
        square = 0.0
        for d in range(dimension):
            square += (nodes[(k + 1) % size, d] - nodes[k, d]) ** 2
        gap[k] = max(np.sqrt(square), 1e-9)
    tangent = np.empty((size, dimension))
    for k in range(size):
        if closed or 0 < k < size - 1:
            before, after = gap[k - 1], gap[k % pieces]
            for d in range(dimension):
                back = (nodes[k, d] - nodes[k - 1, d]) / before
                ahead = (nodes[(k + 1) % size, d] - nodes[k, d]) / after
                tangent[k, d] = (back * after + ahead * before) / (before + after)
    if not closed:
        for d in range(dimension):
            tangent[0, d] = 2 * (nodes[1, d] - nodes[0, d]) / gap[0] - tangent[1, d]
            tangent[-1, d] = 2 * (nodes[-1, d] - nodes[-2, d]) / gap[-1] - tangent[-2, d]
    out = np.empty((pieces * subdivisions + (0 if closed else 1), dimension))
    for i in range(subdivisions):
        t = i / subdivisions
        here, there = (1 + 2 * t) * (1 - t) ** 2, t * t * (3 - 2 * t)
        leaving, arriving = t * (1 - t) * (1 - t), t * (1 - t) * t
        for k in range(pieces):
            after = (k + 1) % size
            for d in range(dimension):
                out[k * subdivisions + i, d] = (
                    here * nodes[k, d]
                    + there * nodes[after, d]
                    + gap[k] * (leaving * tangent[k, d] - arriving * tangent[after, d])
                )
    if not closed:
        for d in range(dimension):
            out[-1, d] = nodes[-1, d]
    return out


def straightened(values: Array, window: int, closed: bool = False) -> Array:
    """Smooth values along the first axis by fitting a line to the neighbours of each.

    The filter of A. Savitzky and M. J. E. Golay, "Smoothing and Differentiation of Data by Simplified Least Squares
    Procedures", 1964, of first order. ``scipy.signal.savgol_filter`` gives the same with its modes "interp" and
    "wrap", but fits the lines at both ends again at each call, which takes half a millisecond.

    Args:
        values: ``(P, ...)``, P >= window.
        window: How many neighbours, odd. The outermost values of an open row take the line of the outermost window.
        closed: Whether the last value is followed by the first.
    """
    half, count = window // 2, len(values)
    if closed:
        values, count = np.concatenate([values[-half:], values, values[:half]]), count + 2 * half
    total = np.cumsum(values, axis=0)
    middle = total[window - 1 :].copy()
    middle[1:] -= total[: count - window]
    middle /= window
    if closed:
        return middle
    first = _end_lines(window)
    head, tail = first @ values[:window], first[::-1, ::-1] @ values[-window:]
    return np.concatenate([head, middle, tail])


@cache
def _end_lines(window: int) -> Array:
    """Return the weights of the line through a window for its first half: ``(half, window)``."""
    at = np.arange(window) - window // 2
    return (1 / window + np.outer(at, at) / float(at @ at))[: window // 2]


def resample(curve: Array, count: int) -> Array:
    """Return ``count`` points of equal arc length from end to end: ``(P, D)`` -> ``(count, D)``."""
    curve = np.ascontiguousarray(curve, dtype=np.float64)
    arc = arc_length(curve)
    return interpolate(curve, arc, np.linspace(0.0, arc[-1], count))


@compiled
def even_points(curve: Array, arc: Array, count: int, centers: bool) -> Array:
    """Return ``count`` points of equal arc length along a polyline.

    Args:
        curve: ``(P, D)``.
        arc: ``(P,)`` its arc length, or any other measure along it.
        count: How many.
        centers: Whether the points lie at the middle of ``count`` equal pieces; else the first and the last lie at the
            curve's ends.
    """
    at = np.empty(count)
    for n in range(count):
        at[n] = ((n + 0.5) / count if centers else n / max(count - 1, 1)) * arc[-1]
    return interpolate(curve, arc, at)


@compiled
def closed(points: Array) -> Array:
    """Return ``(P, D)`` points with the first one repeated at the end: ``(P + 1, D)``."""
    size, dimension = points.shape
    out = np.empty((size + 1, dimension))
    for p in range(size):
        for d in range(dimension):
            out[p, d] = points[p, d]
    for d in range(dimension):
        out[size, d] = points[0, d]
    return out


@compiled
def even_around(curve: Array, arc: Array, begin: float, count: int) -> Array:
    """Return ``(count, D)`` points of equal arc length around a closed curve, from an arc position on.

    Args:
        curve: ``(P, D)``, the last point the first, see ``closed``.
        arc: ``(P,)`` its arc length.
        begin: Arc position of the first point.
        count: How many.
    """
    at, whole = np.empty(count), arc[-1]
    for k in range(count):
        at[k] = begin % whole + k * (whole / count)
        if at[k] >= whole:
            at[k] -= whole
    return interpolate(curve, arc, at)


@compiled("(f8[:,::1], f8[::1], f8)")
def starting_at(points: Array, arc: Array, start: float) -> Array:
    """Return the points of a closed curve ``(P, D)`` from an arc position on, with a first one there: P or P + 1.

    Args:
        points: ``(P, D)``, the first one not repeated.
        arc: ``(P + 1,)`` arc length, or any other measure along it, the last entry the whole.
        start: The place.
    """
    count, whole = len(points), arc[-1]
    same, start = 1e-9 * whole, start % whole
    if start + same >= whole:
        start = 0.0
    after = 1
    while arc[after] < start + same:
        after += 1
    before = after - 1 if start - arc[after - 1] <= same else after  # the point is there already
    out, at = np.empty((1 + count - after + before, points.shape[1])), after
    first = even_around(closed(points), arc, start, 1)
    for p in range(len(out)):
        for d in range(points.shape[1]):
            out[p, d] = first[0, d] if p == 0 else points[at, d]
        at = at if p == 0 else at + 1
        at = 0 if at == count else at
    return out


@compiled
def equal_chords(
    points: Array, arc: Array, metric: Array, metric_arc: Array, count: int, margin: float, max_shift: float
) -> tuple[Array, Array]:
    """Return ``count`` >= 2 points of a curve that have equal chords in another space, and their arc positions there.

    Args:
        points: ``(P, D)``.
        arc: ``(P,)`` arc length.
        metric: ``(P, D')`` the same curve in the space in which chords are to be equal.
        metric_arc: ``(P,)`` arc length there.
        count: How many.
        margin: How far the first and the last lie from the curve's ends, in that space.
        max_shift: No point leaves its position by arc length by more than so many gaps.
    """
    gap = (metric_arc[-1] - 2 * margin) / (count - 1)
    at, wanted = np.empty(count), np.empty(count)
    for k in range(count):
        at[k] = margin + gap * k
    for _ in range(_EQUALISING_PASSES):
        chord = arc_length(interpolate(metric, metric_arc, at))
        least, most = np.inf, 0.0
        for k in range(count):
            wanted[k] = chord[-1] * k / (count - 1)
            if k > 0:
                least, most = min(least, chord[k] - chord[k - 1]), max(most, chord[k] - chord[k - 1])
        if most - least < _EQUAL * chord[-1] / count:
            break
        moved = interpolate(at.reshape(count, 1), chord, wanted)
        for k in range(count):
            even = margin + gap * k
            at[k] = min(max(moved[k, 0], even - max_shift * gap), even + max_shift * gap)
    along = interpolate(arc.reshape(len(arc), 1), metric_arc, at).reshape(count)
    return interpolate(points, arc, along), at


def nearest_on(curve: Array, points: Array) -> tuple[Array, Array]:
    """Return where a polyline is nearest to each point: ``(P, D)``, ``(N, D)`` -> arc positions, distances ``(N,)``.

    Both are NaN for a point that is not finite, and for all points if the polyline is not.

    Raises:
        ValueError: The polyline has fewer than two points.
    """
    curve, points = (np.ascontiguousarray(each, dtype=np.float64) for each in (curve, points))
    if len(curve) < 2:
        raise ValueError(f"curve: expected at least two points, got {len(curve)}.")
    return nearest_along(curve, arc_length(curve), points)


@compiled("(f8[:,::1], f8[::1], f8[:,::1])")
def nearest_along(curve: Array, arc: Array, points: Array) -> tuple[Array, Array]:
    """Return what ``nearest_on`` does, for a curve of known arc lengths ``(P,)``."""
    at, distance = np.full(len(points), np.nan), np.full(len(points), np.nan)
    for n in range(len(points) if np.isfinite(arc[-1]) else 0):
        square, p, share = nearest_piece(curve, points[n], 0, len(curve) - 1)
        if square < np.inf:
            at[n], distance[n] = arc[p] + share * (arc[p + 1] - arc[p]), np.sqrt(square)
    return at, distance


@compiled
def nearest_vertex(points: Array, place: Array) -> int:
    """Return which of ``(P, D)`` points is nearest to a place ``(D,)``, the first of several."""
    best, least = 0, np.inf
    for p in range(len(points)):
        square = 0.0
        for d in range(points.shape[1]):
            square += (points[p, d] - place[d]) ** 2
        best, least = (p, square) if square < least else (best, least)
    return best


@compiled
def nearest_piece(curve: Array, point: Array, first: int, stop: int) -> tuple[float, int, float]:
    """Return how near some pieces of a polyline come to a point.

    Args:
        curve: ``(P, D)``.
        point: ``(D,)``.
        first: The first of the pieces; piece p begins at point p of the curve.
        stop: The piece after the last.

    Returns:
        The squared distance, inf without pieces; the nearest piece; the share of this piece before the nearest place.
    """
    best, nearest, where = np.inf, first, 0.0
    for p in range(first, stop):
        along = length = off = 0.0
        for d in range(len(point)):
            side = curve[p + 1, d] - curve[p, d]
            along += (point[d] - curve[p, d]) * side
            length += side * side
        share = min(max(along / max(length, 1e-300), 0.0), 1.0)
        for d in range(len(point)):
            off += (point[d] - curve[p, d] - share * (curve[p + 1, d] - curve[p, d])) ** 2
        if off < best:
            best, nearest, where = off, p, share
    return best, nearest, where
