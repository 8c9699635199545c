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
from shape_obs.geometry.coons import AROUND, TURN_REACH, SheetOutline
from shape_obs.geometry.outline import enclosed_by
from shape_obs.geometry.polyline import arc_length, closed, even_around

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

_CANDIDATES: Final = 10  # strongest turns of an outline, among which four corners are chosen in 210 ways
_LEAST_TURN: Final = 0.35  # rad, 20 degrees: the corners of a sheet turn more, wherever it bends
_NEAR: Final = AROUND // 20  # points from where a corner is expected, at most: half a short side of a sheet of 1:4


@compiled
def sheet_outline(traced: Array) -> SheetOutline:
    """Return a clockwise outline ``(P, 2)``, no point repeated, as the outline of a sheet."""
    around = closed(traced)
    arc = arc_length(around)
    points = even_around(around, arc, 0.0, AROUND)
    turn = _turns(points)
    step = arc_length(closed(points))[AROUND] / AROUND
    return SheetOutline(points, turn, _candidates(turn), step, arc[-1] / len(traced))


@compiled
def best_corners(outline: Any) -> Indices:
    """Return ``(4,)`` the points of a ``SheetOutline`` most like its corners, clockwise; ``(0,)`` without four."""
    count, whole = len(outline.candidates), max(enclosed_by(outline.points) - AROUND / 2, 1e-9)
    best, least, four = np.empty(4, np.int64), np.inf, np.empty(4, np.int64)
    for number in range(1 << count):
        chosen = 0
        for q in range(count):
            if number >> q & 1:
                four[chosen % 4] = outline.candidates[q]
                chosen += 1
        if chosen != 4:
            continue
        cost = twice = 0.0
        for k in range(4):
            p, q = four[k], four[(k + 1) % 4]
            u, v, x, y = outline.points[p, 0], outline.points[p, 1], outline.points[q, 0], outline.points[q, 1]
            chord = max(math.sqrt((x - u) ** 2 + (y - v) ** 2), 1e-9)
            cost += (q - p) % AROUND * outline.step / chord - min(outline.turn[p] / (np.pi / 2), 1)
            twice += u * y - v * x
        cost += abs(1 - abs(twice) / 2 / whole)
        if cost < least:
            least = cost
            for k in range(4):
                best[k] = four[k]
    return best if count >= 4 else best[:0]


@compiled
def _turns(points: Array) -> Array:
    """Return ``(400,)`` radians by which an outline turns about each of its points."""
    turn = np.empty(AROUND)
    for p in range(AROUND):
        here, before, after = points[p], points[p - TURN_REACH], points[(p + TURN_REACH) % AROUND]
        x, y, back_x, back_y = after[0] - here[0], after[1] - here[1], here[0] - before[0], here[1] - before[1]
        turn[p] = math.atan2(back_x * y - back_y * x, back_x * x + back_y * y)
    return turn


@compiled
def _candidates(turn: Array) -> Indices:
    """Return ``(Q,)`` the points where an outline turns most, in order."""
    peaks, count = np.empty(AROUND, np.int64), 0
    for p in range(AROUND):
        if turn[p] > _LEAST_TURN:
            for i in range(p - TURN_REACH, p + TURN_REACH + 1):
                if turn[i % AROUND] > turn[p]:
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
def nearest_corners(outline: Array, candidates: Indices, step: float, expected: Array) -> Indices:
    """Return the candidate nearest to each place, or the outline's nearest point if there is none.

    Args:
        outline: ``(400, D)``.
        candidates: ``(Q,)`` the points where it turns most.
        step: Distance between two points.
        expected: ``(4, D)`` clockwise as seen.

    Returns:
        ``(4,)`` points; ``(0,)`` when they are not in order around the outline.
    """
    found = np.empty(4, np.int64)
    for k in range(4):
        found[k], least = nearest_of(outline, range(len(outline)), expected[k])
        corner, near = nearest_of(outline, candidates, expected[k])
        if near < max(_NEAR * step, 2 * least):
            found[k] = corner
    around = 0
    for k in range(4):
        gap = (found[(k + 1) % 4] - found[k]) % AROUND
        if gap <= 1:
            return found[:0]
        around += gap
    return found if around == AROUND else found[:0]


@compiled
def nearest_of(outline: Array, among: Iterable[int], place: Array) -> tuple[int, float]:
    """Return which of some points of an outline is nearest to a place, and its distance; -1 and infinity for none."""
    least, nearest = np.inf, -1
    for p in among:
        square = 0.0
        for d in range(outline.shape[1]):
            square += (outline[p, d] - place[d]) ** 2
        if square < least:
            least, nearest = square, p
    return nearest, math.sqrt(least)
