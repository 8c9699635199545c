"""Ropes that may have exchanged their ends where they met: would each go on straighter along the other one?"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import FittedCurve
from shape_obs.initialization.pairing import CHORD, Lead, bending, lead

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

TOUCH: Final = 1.2  # widths: ropes touch where their middles are nearer; side by side they are 1, and noise adds 0.2
_NOISE: Final = 0.08  # rad^2, see ``bending``: what noise makes ropes bend more one way than another
_BLOCK: Final = 16  # points of a curve with a common bounding box, which saves most distances


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
        leads = [
            _lead(curve, index, step, width)
            for curve, index, step in ((first, start, -1), (first, last, 1), (second, low, -1), (second, high, 1))
        ]
        if None not in leads:
            gain = max(gain, _gain([each for each in leads if each is not None]))
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
    blocks = (len(other) + _BLOCK - 1) // _BLOCK
    box = np.empty((blocks, 4))  # low u, low v, high u, high v
    for b in range(blocks):
        for d in range(2):
            part = other[b * _BLOCK : (b + 1) * _BLOCK, d]
            box[b, d], box[b, 2 + d] = part.min(), part.max()
    found, size, meets = np.empty((len(points) // 2 + 1, 4), np.int64), 0, False
    for p in range(len(points)):
        u, v, least, nearest = points[p, 0], points[p, 1], near * near, -1
        for b in range(blocks):
            du, dv = max(box[b, 0] - u, u - box[b, 2], 0.0), max(box[b, 1] - v, v - box[b, 3], 0.0)
            if du * du + dv * dv >= least:
                continue
            for q in range(b * _BLOCK, min((b + 1) * _BLOCK, len(other))):
                square = (other[q, 0] - u) ** 2 + (other[q, 1] - v) ** 2
                if square < least:
                    least, nearest = square, q
        if nearest >= 0 and not meets:
            found[size, 0], found[size, 2], found[size, 3] = p, nearest, nearest
            size += 1
        meets = nearest >= 0
        if meets:
            found[size - 1, 1] = p
            found[size - 1, 2] = min(found[size - 1, 2], nearest)
            found[size - 1, 3] = max(found[size - 1, 3], nearest)
    return found[:size]


def _lead(curve: FittedCurve, index: int, step: int, width: float) -> Lead | None:
    """Return how a rope leaves one of its points; None where it ends too soon to see."""
    piece = curve.points[index::step] if step > 0 else curve.points[index::-1]
    along = curve.arc[-1] - curve.arc[index] if step > 0 else curve.arc[index]
    return lead(piece, width) if along >= CHORD * width else None


def _gain(leads: list[Lead]) -> float:
    before, after, other_before, other_after = leads
    as_it_is = bending(before, after) + bending(other_before, other_after)
    crosswise = bending(before, other_after) + bending(other_before, after)
    turned = bending(before, other_before) + bending(after, other_after)
    return as_it_is - min(crosswise, turned)
