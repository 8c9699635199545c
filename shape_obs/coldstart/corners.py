"""The four corners of a sheet, and the four sides between them.

The outline of a quadrilateral turns by about a right angle four times and hardly in between. Its strongest turns are
the candidates; among all choices of four the one is taken whose sides are straightest, whose corners turn most and
whose quadrilateral fills the outline.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import combinations
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.curve import arc_length, interpolate, resample

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

_COUNT: Final = 400  # points of a rim
_REACH: Final = 16  # points on either side: the scale at which a turn is a corner, 4 % of the perimeter
_CANDIDATES: Final = 10
_LEAST_TURN: Final = 0.35  # radians; the corners of a sheet turn more, wherever it bends
_RIGHT_ANGLE: Final = np.pi / 2
# The smoothing of the outline has rounded its corners: so many of the outline's own steps to either side are left
# out, and a corner is looked for no farther off.
_ROUNDED: Final = 4.0
_OUTSIDE: Final = 2.5
# Lines that are intersected at a corner, in points: longer ones would cut across bent sides, shorter ones follow the
# noise. 0.4 px off at the median of drawn sheets; the strongest turn itself is 1.4 px off.
_LINE: Final = 6
# How far from where a corner is expected it is looked for, in points: half of the least side of a sheet of 1:4.
_NEAR: Final = 20
_PARALLEL: Final = 0.1  # squared sine of the angle between two sides that meet in no corner


@dataclass(frozen=True, eq=False)
class Rim:
    """The closed outline of a sheet, 400 points evenly spaced, clockwise as seen.

    Args:
        points: (P,D) pixels or metres.
        flat: (P,2) the same unrolled into a plane; in an image the points themselves.
        grain: What the outline was smoothed over, in its unit: the steps it was traced in.
    """

    points: Array
    flat: Array
    grain: float

    @classmethod
    def along(cls, outline: Array, flat: Array) -> Rim:
        """From a closed outline of (P,D) points and the same (P,2) unrolled, the first point not repeated."""
        closed = np.concatenate([flat, flat[:1]])
        arc = arc_length(closed)
        at = np.arange(_COUNT) * (arc[-1] / _COUNT)
        points = interpolate(np.concatenate([outline, outline[:1]]), arc, at)
        return cls(points, points if flat is outline else interpolate(closed, arc, at), float(arc[-1] / len(flat)))

    @cached_property
    def step(self) -> float:
        """Distance between two points along the flat outline."""
        return float(arc_length(np.concatenate([self.flat, self.flat[:1]]))[-1] / len(self.flat))

    @cached_property
    def turn(self) -> Array:
        """(P,) radians by which the outline turns about each point, positive where it is convex."""
        z = self.flat[:, 0] + 1j * self.flat[:, 1]
        ahead, behind = np.roll(z, -_REACH) - z, z - np.roll(z, _REACH)
        return np.angle(ahead * behind.conj())

    @cached_property
    def candidates(self) -> Indices:
        """(Q,) the points where the outline turns most, in order, at most ten."""
        around = np.concatenate([self.turn[-_REACH:], self.turn, self.turn[:_REACH]])
        highest = np.lib.stride_tricks.sliding_window_view(around, 2 * _REACH + 1).max(axis=1)
        peaks = np.flatnonzero((self.turn >= highest) & (self.turn > _LEAST_TURN))
        return np.sort(peaks[np.argsort(-self.turn[peaks], kind="stable")][:_CANDIDATES])

    def corners(self) -> Indices | None:
        """(4,) the points that are most like the corners of a sheet, clockwise; None where there are not four."""
        if len(self.candidates) < 4:
            return None
        chosen = self.candidates[_fours(len(self.candidates))]
        following = np.roll(chosen, -1, axis=1)
        places = self.flat[chosen]
        sides = places[:, [1, 2, 3, 0]] - places
        chord = np.maximum(np.linalg.norm(sides, axis=-1), 1e-9)
        winding = ((following - chosen) % _COUNT * self.step / chord - 1).sum(axis=1)
        blunt = (1 - np.minimum(self.turn[chosen] / _RIGHT_ANGLE, 1)).sum(axis=1)
        left_out = np.abs(1 - _area(places) / max(float(_area(self.flat[None])[0]), 1e-9))
        return chosen[np.argmin(winding + blunt + left_out)]

    def corners_near(self, expected: Array) -> Indices | None:
        """The corner nearest to each place, or the outline's nearest point where there is no corner.

        Args:
            expected: (4,D) clockwise as seen.

        Returns:
            (4,) points; None when they are not in order around the outline.
        """
        away = np.linalg.norm(self.points - expected[:, None], axis=2)
        found = np.argmin(away, axis=1)
        if len(self.candidates):
            at = self.candidates[np.argmin(away[:, self.candidates], axis=1)]
            near = away[np.arange(4), at] < np.maximum(_NEAR * self.step, 2 * away.min(axis=1))
            found = np.where(near, at, found)
        gaps = (np.roll(found, -1) - found) % _COUNT
        return found if gaps.sum() == _COUNT and gaps.min() > 1 else None

    def kink(self, corners: Indices) -> float:
        """Radians by which the outline turns at most, either way, where it is away from the corners."""
        away = np.abs((np.arange(_COUNT) - corners[:, None] + _COUNT // 2) % _COUNT - _COUNT // 2).min(axis=0)
        return float(np.abs(self.turn[away > _REACH]).max(initial=0.0))

    def sides(self, corners: Indices, count: int) -> Array:
        """(4,count,D) the sides, each from its corner on clockwise, evenly spaced, the corners' own places included."""
        places = self._places(corners)
        skip = max(round(_ROUNDED / 2 * self.grain / self.step), 1)
        sides = []
        for k, after in enumerate((1, 2, 3, 0)):
            length = (corners[after] - corners[k]) % _COUNT
            inner = self.points[(corners[k] + np.arange(skip, max(length - skip + 1, skip))) % _COUNT]
            sides.append(resample(np.concatenate([places[[k]], inner, places[[after]]]), count))
        return np.stack(sides)

    def _places(self, corners: Indices) -> Array:
        """(4,D) where the lines through both sides meet, as near as the corners of the smoothed outline allow."""
        first = max(int(np.ceil(_ROUNDED * self.grain / self.step)), 1)
        away = first + np.arange(max(_LINE, first))
        before, back = _lines(self.points[(corners[:, None] - away) % _COUNT])
        after, ahead = _lines(self.points[(corners[:, None] + away) % _COUNT])
        apart, cosine = after - before, _dot(back, ahead)
        sine = 1 - cosine**2
        s = (_dot(apart, back) - cosine * _dot(apart, ahead)) / np.maximum(sine, _PARALLEL)
        t = (cosine * _dot(apart, back) - _dot(apart, ahead)) / np.maximum(sine, _PARALLEL)
        shift = (before + s[:, None] * back + after + t[:, None] * ahead) / 2 - self.points[corners]
        shift[sine < _PARALLEL] = 0
        far = np.sqrt(_dot(shift, shift)) / (_OUTSIDE * self.grain)
        return self.points[corners] + shift / np.maximum(far, 1)[:, None]


def _lines(points: Array) -> tuple[Array, Array]:
    """The middles (4,D) and the directions (4,D) of (4,L,D) points."""
    at = np.arange(points.shape[1]) - (points.shape[1] - 1) / 2
    slope = np.einsum("l,kld->kd", at, points)
    return points.mean(axis=1), slope / np.maximum(np.sqrt(_dot(slope, slope)), 1e-9)[:, None]


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("kd,kd->k", a, b)


def _area(polygons: Array) -> Array:
    """(T,) areas of (T,P,2) polygons."""
    x, y = polygons[..., 0], polygons[..., 1]
    return 0.5 * np.abs(np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1))


@lru_cache(maxsize=16)
def _fours(count: int) -> Indices:
    return np.array(list(combinations(range(count), 4)), dtype=np.intp)
