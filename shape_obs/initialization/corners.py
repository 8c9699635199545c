"""The four corners of a sheet, and the four sides between them.

The outline of a quadrilateral turns by about a right angle four times and hardly in between. Its strongest turns are
the candidates. Among all choices of four, the best has the straightest sides, corners that turn most, and a
quadrilateral that fills the outline.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.coons import RIM, TURN_REACH, coons_patch
from shape_obs.geometry.polyline import arc_length, closed, even_around, interpolate

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

_CANDIDATES: Final = 10  # strongest turns of an outline, among which four corners are chosen in 210 ways
_LEAST_TURN: Final = 0.35  # rad, 20 degrees: the corners of a sheet turn more, wherever it bends
_NEAR: Final = RIM // 20  # points, half a short side of a sheet of 1:4: how far from its expected place a corner may be


@dataclass(frozen=True, eq=False)
class Rim:
    """The closed outline of a sheet, 400 points evenly spaced, clockwise as seen.

    Args:
        points: ``(P, D)`` pixels or metres.
        flat: ``(P, 2)`` the same unrolled into a plane; in an image the points themselves.
        turn: ``(P,)`` radians by which the outline turns about each point, positive where it is convex.
        candidates: ``(Q,)`` the points where it turns most, in order, at most ten.
        step: Distance between two points along the flat outline.
        grain: What the outline was smoothed over, in its unit: the steps it was traced in.
    """

    points: Array
    flat: Array
    turn: Array
    candidates: Indices
    step: float
    grain: float

    @classmethod
    def along(cls, outline: Array, flat: Array) -> Rim:
        """Build the rim of a closed outline ``(P, D)`` and of the same unrolled ``(P, 2)``, no point repeated."""
        even, turn, candidates, step, grain = rim_of(np.ascontiguousarray(flat, dtype=np.float64))
        if outline is flat:
            return cls(even, even, turn, candidates, step, grain)
        arc = arc_length(np.ascontiguousarray(np.concatenate([flat, flat[:1]])))
        at = np.arange(RIM) * (arc[-1] / RIM)
        points = interpolate(np.ascontiguousarray(np.concatenate([outline, outline[:1]])), arc, at)
        return cls(points, even, turn, candidates, step, grain)

    def corners(self) -> Indices | None:
        """Return ``(4,)`` the points most like the corners of a sheet, clockwise; None if there are not four."""
        if len(self.candidates) < 4:
            return None
        chosen = self.candidates[_fours(len(self.candidates))]
        following = np.roll(chosen, -1, axis=1)
        places = self.flat[chosen]
        sides = places[:, [1, 2, 3, 0]] - places
        chord = np.maximum(np.linalg.norm(sides, axis=-1), 1e-9)
        winding = ((following - chosen) % RIM * self.step / chord - 1).sum(axis=1)
        blunt = (1 - np.minimum(self.turn[chosen] / (np.pi / 2), 1)).sum(axis=1)
        left_out = np.abs(1 - _area(places) / max(float(_area(self.flat[None])[0]), 1e-9))
        return chosen[np.argmin(winding + blunt + left_out)]

    def corners_near(self, expected: Array) -> Indices | None:
        """Return the corner nearest to each place, or the outline's nearest point if there is no corner.

        Args:
            expected: ``(4, D)`` clockwise as seen.

        Returns:
            ``(4,)`` points; None when they are not in order around the outline.
        """
        found = nearest_corners(self.points, self.candidates, self.step, expected)
        return found if len(found) else None

    def patch(self, corners: Indices) -> tuple[Array, float]:
        """Return ``(P, 2)`` the Coons patch between four corners of the flat outline, and its kink.

        See ``coons_patch``.
        """
        return coons_patch(self.flat, self.turn, corners, self.step, self.grain)


def _area(polygons: Array) -> Array:
    """Return the areas of ``(T, P, 2)`` polygons: ``(T,)``."""
    x, y = polygons[..., 0], polygons[..., 1]
    return 0.5 * np.abs(np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1))


@lru_cache(maxsize=16)
def _fours(count: int) -> Indices:
    return np.array(list(combinations(range(count), 4)), dtype=np.int64)


@compiled("(f8[:,::1],)")
def rim_of(outline: Array) -> tuple[Array, Array, Indices, float, float]:
    """Return a clockwise outline ``(P, 2)`` as the rim of a sheet.

    Returns:
        ``(400, 2)`` points evenly spaced; ``(400,)`` radians by which it turns about each, positive where it is convex;
        ``(Q,)`` the points where it turns most, in order, at most ten; the distance between two points; that between
        two points of the outline.
    """
    around = closed(outline)
    arc = arc_length(around)
    points = even_around(around, arc, 0.0, RIM)
    turn = _turns(points)
    step = arc_length(closed(points))[RIM] / RIM
    return points, turn, _candidates(turn), step, arc[-1] / len(outline)


@compiled
def _turns(points: Array) -> Array:
    """Return ``(400,)`` radians by which a rim turns about each of its points."""
    turn = np.empty(RIM)
    for p in range(RIM):
        before, after = (p - TURN_REACH) % RIM, (p + TURN_REACH) % RIM
        back_x, back_y = points[p, 0] - points[before, 0], points[p, 1] - points[before, 1]
        x, y = points[after, 0] - points[p, 0], points[after, 1] - points[p, 1]
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


@compiled("(f8[:,::1], i8[::1], f8, f8[:,::1])")
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
        found[k], least = _nearest(rim, range(RIM), expected[k])
        corner, near = _nearest(rim, candidates, expected[k])
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
def _nearest(rim: Array, among: Iterable[int], place: Array) -> tuple[int, float]:
    """Return which of some points of a rim is nearest to a place, and its distance; -1 and infinity for none."""
    least, nearest = np.inf, -1
    for p in among:
        square = 0.0
        for d in range(rim.shape[1]):
            square += (rim[p, d] - place[d]) ** 2
        if square < least:
            least, nearest = square, p
    return nearest, math.sqrt(least)
