"""The four corners of a sheet, and the four sides between them.

The outline of a quadrilateral turns by about a right angle four times and hardly in between. Its strongest turns are
the candidates; among all choices of four the one is taken whose sides are straightest, whose corners turn most and
whose quadrilateral fills the outline.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import NUMPY, Kernels
from shape_obs.compiled.interface_outline import RIM
from shape_obs.geometry.outline import Border
from shape_obs.geometry.polyline import arc_length, interpolate

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

_RIGHT_ANGLE: Final = np.pi / 2


@dataclass(frozen=True, eq=False)
class Rim:
    """The closed outline of a sheet, 400 points evenly spaced, clockwise as seen.

    Args:
        points: (P,D) pixels or metres.
        flat: (P,2) the same unrolled into a plane; in an image the points themselves.
        turn: (P,) radians by which the outline turns about each point, positive where it is convex.
        candidates: (Q,) the points where it turns most, in order, at most ten.
        step: Distance between two points along the flat outline.
        grain: What the outline was smoothed over, in its unit: the steps it was traced in.
        kernels: What runs the inner loops.
    """

    points: Array
    flat: Array
    turn: Array
    candidates: Indices
    step: float
    grain: float
    kernels: Kernels = NUMPY

    @classmethod
    def around(cls, border: Border) -> Rim:
        """Of a piece of a mask."""
        points, turn, candidates, step, grain = border.rim
        return cls(points, points, turn, candidates, step, grain, border.kernels)

    @classmethod
    def along(cls, outline: Array, flat: Array) -> Rim:
        """From a closed outline of (P,D) points and the same (P,2) unrolled, the first point not repeated."""
        even, turn, candidates, step, grain = NUMPY.rim(flat)
        arc = arc_length(np.concatenate([flat, flat[:1]]))
        at = np.arange(RIM) * (arc[-1] / RIM)
        return cls(interpolate(np.concatenate([outline, outline[:1]]), arc, at), even, turn, candidates, step, grain)

    def corners(self) -> Indices | None:
        """(4,) the points that are most like the corners of a sheet, clockwise; None where there are not four."""
        if len(self.candidates) < 4:
            return None
        chosen = self.candidates[_fours(len(self.candidates))]
        following = np.roll(chosen, -1, axis=1)
        places = self.flat[chosen]
        sides = places[:, [1, 2, 3, 0]] - places
        chord = np.maximum(np.linalg.norm(sides, axis=-1), 1e-9)
        winding = ((following - chosen) % RIM * self.step / chord - 1).sum(axis=1)
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
        found = self.kernels.corners_near(self.points, self.candidates, self.step, expected)
        return found if len(found) else None

    def laid(self, corners: Indices) -> tuple[Array, float]:
        """(P,2) the Coons patch between four corners of the flat outline, and by how much it turns between them.

        See ``Kernels.laid``.
        """
        return self.kernels.laid(self.flat, self.turn, corners, self.step, self.grain)


def _area(polygons: Array) -> Array:
    """(T,) areas of (T,P,2) polygons."""
    x, y = polygons[..., 0], polygons[..., 1]
    return 0.5 * np.abs(np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1))


@lru_cache(maxsize=16)
def _fours(count: int) -> Indices:
    return np.array(list(combinations(range(count), 4)), dtype=np.int64)
