"""How much a rope bends that goes on from one strand to another, and the smooth curve it takes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.curve import interpolate

Array = npt.NDArray[np.float64]


class Lead(NamedTuple):
    """How a strand leaves a zone or a gap.

    Args:
        point: (2,) pixels, where it is clear of the zone.
        heading: (2,) unit vector, away from the zone.
    """

    point: Array
    heading: Array


def lead(curve: Array, reach: float) -> Lead:
    """How a curve of (P,2) pixels leaves its first point: taken in the middle of its first piece of ``reach`` pixels.

    On a bend a chord is parallel to the tangent in its middle, so the two belong together.
    """
    step = np.diff(curve, axis=0)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]))])
    reach = min(reach, arc[-1])
    start, middle, end = interpolate(curve, arc, np.array([0.0, reach / 2, reach]))
    return Lead(middle, unit(end - start))


def unit(vector: Array) -> Array:
    """A (2,) vector of length one in the same direction; zero for zero."""
    return vector / max(float(np.hypot(vector[0], vector[1])), 1e-9)


def bending(before: Lead, after: Lead) -> float:
    """How much a smooth curve from one strand to another bends: its bending energy times its length over 4, rad^2.

    Both headings point away from the gap. Of a cubic that turns by a and b from its chord at its ends the energy is
    4 (a^2 - a b + b^2) over its length: an arc is cheaper than an S.
    """
    gap = after.point - before.point
    first, second = turn(-before.heading, gap), turn(gap, after.heading)
    return first * first - first * second + second * second


def hermite(start: Array, out: Array, end: Array, into: Array, step: float) -> Array:
    """A smooth curve between two points with the given unit tangents, both along the way: (P,2), ends left out."""
    length = float(np.linalg.norm(end - start))
    t = np.linspace(0, 1, max(round(length / step), 1) + 1)[1:-1, None]
    return (
        (1 + 2 * t) * (1 - t) ** 2 * start
        + t**2 * (3 - 2 * t) * end
        + t * (1 - t) * length * ((1 - t) * out - t * into)
    )


def turn(before: Array, after: Array) -> float:
    """Signed angle from one direction to another, radians."""
    return float(np.arctan2(before[0] * after[1] - before[1] * after[0], before @ after))
