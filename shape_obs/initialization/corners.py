"""The four corners of a sheet, and the four sides between them.

The outline of a quadrilateral turns by about a right angle four times and hardly in between. Its strongest turns are
the candidates. Among all choices of four, the best has the straightest sides, corners that turn most, and a
quadrilateral that fills the outline.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.coons import RIM, TURN_REACH, Rim
from shape_obs.geometry.outline import enclosed_by
from shape_obs.geometry.polyline import arc_length, closed, even_around

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

_CANDIDATES: Final = 10  # strongest turns of an outline, among which four corners are chosen in 210 ways
_LEAST_TURN: Final = 0.35  # rad, 20 degrees: the corners of a sheet turn more, wherever it bends
_NEAR: Final = RIM // 20  # points, half a short side of a sheet of 1:4: how far from its expected place a corner may be


@compiled
def rim_of(outline: Array) -> Rim:
    """Return a clockwise outline ``(P, 2)``, no point repeated, as the rim of a sheet."""
    around = closed(outline)
    arc = arc_length(around)
    points = even_around(around, arc, 0.0, RIM)
    turn = _turns(points)
    step = arc_length(closed(points))[RIM] / RIM
    return Rim(points, turn, _candidates(turn), step, arc[-1] / len(outline))


@compiled
def best_corners(rim: Any) -> Indices:
    """Return ``(4,)`` the points of a ``Rim`` most like the corners of a sheet, clockwise; ``(0,)`` without four."""
    count, whole = len(rim.candidates), max(enclosed_by(rim.points) - RIM / 2, 1e-9)
    best, least, four = np.empty(4, np.int64), np.inf, np.empty(4, np.int64)
    for number in range(1 << count):
        chosen = 0
        for q in range(count):
            if number >> q & 1:
                four[chosen % 4] = rim.candidates[q]
                chosen += 1
        if chosen != 4:
            continue
        cost = twice = 0.0
        for k in range(4):
            p, q = four[k], four[(k + 1) % 4]
            u, v, x, y = rim.points[p, 0], rim.points[p, 1], rim.points[q, 0], rim.points[q, 1]
            chord = max(math.sqrt((x - u) ** 2 + (y - v) ** 2), 1e-9)
            cost += (q - p) % RIM * rim.step / chord - min(rim.turn[p] / (np.pi / 2), 1)
            twice += u * y - v * x
        cost += abs(1 - abs(twice) / 2 / whole)
        if cost < least:
            least = cost
            for k in range(4):
                best[k] = four[k]
    return best if count >= 4 else best[:0]


@compiled
def _turns(points: Array) -> Array:
    """Return ``(400,)`` radians by which a rim turns about each of its points."""
    turn = np.empty(RIM)
    for p in range(RIM):
        here, before, after = points[p], points[p - TURN_REACH], points[(p + TURN_REACH) % RIM]
        x, y, back_x, back_y = after[0] - here[0], after[1] - here[1], here[0] - before[0], here[1] - before[1]
        turn[p] = math.atan2(back_x * y - back_y * x, back_x * x + back_y * y)
    return turn


@compiled
def _candidates(turn: Array) -> Indices:
    """Return ``(Q,)`` the points where a rim turns most, in order."""
    peaks, count = np.empty(RIM, np.int64), 0
    for p in range(RIM):
        if turn[p] > _LEAST_TURN:
            for i in range(p - TURN_REACH, p + TURN_REACH + 1):
                if turn[i % RIM] > turn[p]:
                    break
            else:
                peaks[count] = p
                count += 1
    while count > _CANDIDATES:
        least = 0
        for k in range(count):
            if turn[peaks[k]] < turn[peaks[least]]:
                least = k
        count -= 1
        for k in range(least, count):
            peaks[k] = peaks[k + 1]
    return peaks[:count]


@compiled
def nearest_corners(rim: Array, candidates: Indices, step: float, expected: Array) -> Indices:
    """Return the candidate nearest to each place, or the rim's nearest point if there is none.

    Args:
        rim: ``(400, D)``.
        candidates: ``(Q,)`` the points where it turns most.
        step: Distance between two points.
        expected: ``(4, D)`` clockwise as seen.

    Returns:
        ``(4,)`` points; ``(0,)`` when they are not in order around the rim.
    """
    found = np.empty(4, np.int64)
    for k in range(4):
        found[k], least = nearest_of(rim, range(len(rim)), expected[k])
        corner, near = nearest_of(rim, candidates, expected[k])
        if near < max(_NEAR * step, 2 * least):
            found[k] = corner
    around = 0
    for k in range(4):
        gap = (found[(k + 1) % 4] - found[k]) % RIM
        if gap <= 1:
            return found[:0]
        around += gap
    return found if around == RIM else found[:0]


@compiled
def nearest_of(rim: Array, among: Iterable[int], place: Array) -> tuple[int, float]:
    """Return which of some points of a rim is nearest to a place, and its distance; -1 and infinity for none."""
    least, nearest = np.inf, -1
    for p in among:
        square = 0.0
        for d in range(rim.shape[1]):
            square += (rim[p, d] - place[d]) ** 2
        if square < least:
            least, nearest = square, p
    return nearest, math.sqrt(least)
