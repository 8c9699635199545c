"""Crossings of polylines in a plane, and the heights at which ropes lie over each other there."""

from __future__ import annotations

from itertools import combinations
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Steepest slope of a rope that is laid over another one.
_SLOPE: Final = 0.35
#: Gap in metres between two ropes that are laid over each other: they fall by it, and nothing is pushed apart.
_GAP: Final = 5e-4
#: Sine of the smallest angle at which ropes are laid over each other.
_SHARPEST: Final = 0.5
#: Smallest distance of a crossing from the ends of both ropes, as a fraction of their length.
_FREE: Final = 0.18
_ROUNDS: Final = 40


class Crossing(NamedTuple):
    """A place where one rope lies over another one or over itself.

    Args:
        above: Number of the upper rope.
        above_at: Place of the crossing on the upper rope, as a fraction 0 ... 1 of its length from end 0.
        below: Number of the lower rope.
        below_at: Place of the crossing on the lower rope.
        pixel: Its pixel (u, v) in the camera's image.
    """

    above: int
    above_at: float
    below: int
    below_at: float
    pixel: tuple[float, float]


def intersections(one: Array, other: Array) -> Array:
    """Return where two polylines ``(N, 2)`` and ``(M, 2)`` intersect: ``(X, 2)`` places, in segments from the start."""
    a, b = one[:-1, None], other[None, :-1]
    u, v, w = np.diff(one, axis=0)[:, None], np.diff(other, axis=0)[None], b - a
    area = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    area[np.abs(area) < 1e-9 * np.linalg.norm(u, axis=-1) * np.linalg.norm(v, axis=-1)] = np.nan  # parallel
    with np.errstate(invalid="ignore"):
        s = (w[..., 0] * v[..., 1] - w[..., 1] * v[..., 0]) / area
        t = (w[..., 0] * u[..., 1] - w[..., 1] * u[..., 0]) / area
        i, j = np.nonzero((s >= 0) & (s < 1) & (t >= 0) & (t < 1))
    return np.column_stack([i + s[i, j], j + t[i, j]])


def self_intersections(line: Array) -> Array:
    """Return where a polyline ``(N, 2)`` intersects itself: ``(X, 2)`` places, the earlier one first."""
    places = intersections(line, line)
    return places[np.floor(places[:, 1]) - np.floor(places[:, 0]) > 1.5]


def stacked(lines: Array, radius: float, rng: np.random.Generator) -> Array | None:
    """Draw which rope lies over which at each crossing, and return heights at which none meets another one.

    Args:
        lines: Axes of the ropes seen from above, ``(K, N, 2)`` in metres.
        radius: Radius of the ropes in metres.
        rng: Random generator.

    Returns:
        Heights of the axes above the table, ``(K, N)`` in metres; None if a rope crosses no other one, if ropes run
        side by side, cross at a small angle or next to an end, or would have to be steeper than ropes are laid.
    """
    heights = np.full((len(lines), len(lines[0])), radius)
    lifts: list[tuple[int, slice, int, slice]] = []
    for one, other in combinations(range(len(lines)), 2):
        found = _reaches(lines[one], lines[other], radius)
        if found is None:
            return None
        for first, second in found:
            over = rng.random() < 0.5
            lifts.append((one, first, other, second) if over else (other, second, one, first))
    if len({above for above, *_ in lifts} | {below for _, _, below, _ in lifts}) < len(lines):
        return None
    fall = _SLOPE * float(np.linalg.norm(lines[0][2] - lines[0][1]))
    for _ in range(_ROUNDS):
        before = heights.copy()
        for above, here, below, there in lifts:
            top = heights[below, there].max() + 2 * radius + _GAP
            heights[above, here] = np.maximum(heights[above, here], top)
        for i in range(1, heights.shape[1]):
            heights[:, i] = np.maximum(heights[:, i], heights[:, i - 1] - fall)
            heights[:, -1 - i] = np.maximum(heights[:, -1 - i], heights[:, -i] - fall)
        if np.array_equal(before, heights):
            on_table = heights[:, [0, 1, -2, -1]] == radius
            return heights if on_table.all() else None
    return None


def _reaches(one: Array, other: Array, radius: float) -> list[tuple[slice, slice]] | None:
    """Return the vertices of two ropes that are near each crossing; None if they meet elsewhere or at a small angle."""
    ways = [np.diff(line, axis=0) for line in (one, other)]
    gaps = np.linalg.norm(one[:, None] - other, axis=2)
    # Two vertices of ropes that touch are at most this far apart: by a diameter, and by half a link along each.
    touching = gaps < 2 * radius + float(np.linalg.norm(ways[0][1])) / 2
    out = []
    for s, t in intersections(one, other):
        u, v = ways[0][int(s)], ways[1][int(t)]
        sine = abs(float(u[0] * v[1] - u[1] * v[0])) / float(np.linalg.norm(u) * np.linalg.norm(v))
        if sine < _SHARPEST or not _FREE < min(s, t) / len(ways[0]) < max(s, t) / len(ways[0]) < 1 - _FREE:
            return None
        half = 2 * radius / sine / float(np.linalg.norm(u))
        spans = [slice(max(int(p - half), 0), int(np.ceil(p + half)) + 1) for p in (s, t)]
        touching[spans[0], spans[1]] = False
        out.append((spans[0], spans[1]))
    return None if touching.any() else out
