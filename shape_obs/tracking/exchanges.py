"""Ropes that may have exchanged their ends where they met: would each go on straighter along the other one?"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import FittedCurve
from shape_obs.initialization.pairing import CHORD, bending, lead

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

TOUCH: Final = 1.2  # widths: ropes touch where their middles are nearer; side by side they are 1, and noise adds 0.2
_NOISE: Final = 0.08  # rad^2, see ``bending``: what noise makes ropes bend more one way than another


def exchange_gain(first: FittedCurve, second: FittedCurve, width: float) -> float:
    """Return by how much two ropes would bend less, in rad^2, if they exchanged their ends in a place where they meet.

    What noise explains is taken off.

    Args:
        first: A rope, in pixels.
        second: Another one.
        width: Of both, pixels.
    """
    gain = 0.0
    met = meetings(np.ascontiguousarray(first.points), np.ascontiguousarray(second.points), TOUCH * width)
    for start, last, low, high in met.tolist():
        arc, other = first.arc, second.arc
        if min(arc[start], arc[-1] - arc[last], other[low], other[-1] - other[high]) >= CHORD * width:
            # How each rope goes on to both sides of the place.
            ways = first.points[start::-1], first.points[last:], second.points[low::-1], second.points[high:]
            before, after, other_before, other_after = (lead(way, width) for way in ways)
            crosswise = bending(before, other_after) + bending(other_before, after)
            turned = bending(before, other_before) + bending(after, other_after)
            as_it_is = bending(before, after) + bending(other_before, other_after)
            gain = max(gain, as_it_is - min(crosswise, turned))
    return max(gain - _NOISE, 0.0)


@compiled("(f8[:,::1], f8[:,::1], f8)")
def meetings(points: Array, other: Array, near: float) -> Indices:
    """Return the stretches of a curve whose points lie nearer than ``near`` to points of another one.

    Args:
        points: ``(P, 2)``.
        other: ``(Q, 2)``.
        near: Pixels.

    Returns:
        ``(M, 4)`` the first and the last point of a stretch, and the first and the last that are nearest to it.
    """
    found, size, meets, step = np.empty((len(points) // 2 + 1, 4), np.int64), 0, False, 1e-9
    for q in range(1, len(other)):
        step = max(step, np.hypot(other[q, 0] - other[q - 1, 0], other[q, 1] - other[q - 1, 1]))
    for p in range(len(points)):
        least, nearest, q = near * near, -1, 0
        while q < len(other):
            square = (other[q, 0] - points[p, 0]) ** 2 + (other[q, 1] - points[p, 1]) ** 2
            if square < least:
                least, nearest = square, q
            q += max(int((np.sqrt(square) - near) / step), 1)  # those between are too far away
        if nearest >= 0 and not meets:
            found[size, 0], found[size, 2], found[size, 3] = p, nearest, nearest
            size += 1
        meets = nearest >= 0
        if meets:
            found[size - 1, 1] = p
            found[size - 1, 2] = min(found[size - 1, 2], nearest)
            found[size - 1, 3] = max(found[size - 1, 3], nearest)
    return found[:size]
