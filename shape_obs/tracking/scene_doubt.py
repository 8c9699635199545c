"""What speaks against the curves of several ropes in one mask: sharp turns, gaps, and pixels of no rope."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import FittedCurve

Array = npt.NDArray[np.float64]

# A rope bends less than this between two chords of so many widths: in a circle of two widths they turn by 43 degrees.
_CHORD: Final = 1.5
_SHARP: Final = math.radians(75)
_TURN: Final = 3.0  # squares of a width that a sharp turn counts as


def doubtful_area(curve: FittedCurve, width: float) -> float:
    """Return how many pixels of a rope are in doubt: those that were not seen, and those of sharp turns.

    Args:
        curve: In pixels.
        width: Of the rope, pixels.
    """
    turns = sharp_turns(np.ascontiguousarray(curve.points), curve.arc, _CHORD * width, _SHARP)
    return curve.unsupported_fraction * curve.size * width + turns * _TURN * width * width


@compiled("(f8[:,::1], f8[::1], f8, f8)")
def sharp_turns(points: Array, arc: Array, reach: float, angle: float) -> int:
    """Return how often a curve turns by more than an angle between two chords that meet.

    Args:
        points: ``(P, 2)`` pixels.
        arc: ``(P,)`` their arc length.
        reach: Along the curve, of each chord, pixels.
        angle: Radians.
    """
    found, free, before, after, limit = 0, 0.0, 0, 0, np.cos(angle)
    for p in range(len(points)):
        if arc[p] < reach or arc[-1] - arc[p] < reach:
            continue
        while arc[before + 1] <= arc[p] - reach:
            before += 1
        while arc[after] < arc[p] + reach and after < len(points) - 1:
            after += 1
        if arc[p] < free:
            continue
        du, dv = points[p, 0] - points[before, 0], points[p, 1] - points[before, 1]
        far_u, far_v = points[after, 0] - points[p, 0], points[after, 1] - points[p, 1]
        if du * far_u + dv * far_v < limit * np.hypot(du, dv) * np.hypot(far_u, far_v):
            found += 1
            free = arc[p] + 2 * reach  # one turn is counted once
    return found
