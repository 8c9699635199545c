"""Curves as polylines: arc length, smooth interpolation, equidistant sampling. Any dimension.

Smoothing by a straight line through each value's neighbours.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import NUMPY, Kernels
from shape_obs.compiled.numpy_curve import arc_length, catmull_rom, interpolate

__all__ = [
    "arc_length",
    "catmull_rom",
    "equidistant_around",
    "equidistant_positions",
    "interpolate",
    "nearest_on",
    "resample",
]

Array = npt.NDArray[np.float64]


# Where chords are equalised, no point leaves its arc position by more than this share of a gap: where a hairpin is
# narrower than a gap, equal chords would cost the points their places on the material.
_MAX_SHIFT = 0.35

# Around an outline with many corners, each of which shortens a chord, equal chords need more room.
_MAX_SHIFT_AROUND = 1.5

_BLOCK = 250_000  # pairs of a point and a piece of a polyline that are looked at in one go: 4 MB in the plane


def nearest_on(curve: Array, points: Array) -> tuple[Array, Array]:
    """Where on a polyline each point is nearest to it: (P,D), (N,D) -> (N,) arc positions, (N,) distances."""
    start, side = curve[:-1], np.diff(curve, axis=0)
    square = np.einsum("pd,pd->p", side, side)
    length = np.sqrt(square)
    begins = arc_length(curve)[:-1]
    arc, distance = np.empty(len(points)), np.empty(len(points))
    rows = max(_BLOCK // len(start), 1)
    for first in range(0, len(points), rows):
        block = slice(first, first + rows)
        away = points[block, None, :] - start
        share = np.clip(np.einsum("npd,pd->np", away, side) / np.maximum(square, 1e-300), 0.0, 1.0)
        away -= share[..., None] * side
        off = np.einsum("npd,npd->np", away, away)
        best = np.argmin(off, axis=1)
        row = np.arange(len(best))
        arc[block] = begins[best] + share[row, best] * length[best]
        distance[block] = np.sqrt(off[row, best])
    return arc, distance


def resample(curve: Array, count: int) -> Array:
    """``count`` points of equal arc length from end to end: (P,D) -> (count,D)."""
    arc = arc_length(curve)
    return interpolate(curve, arc, np.linspace(0.0, arc[-1], count))


def equidistant_positions(curve: Array, arc: Array, count: int, *, centers: bool, kernels: Kernels = NUMPY) -> Array:
    """Arc positions of ``count`` >= 2 points with equal chords.

    Args:
        curve: (P,D).
        arc: (P,) its arc length.
        count: How many.
        centers: Points at the middle of ``count`` equal pieces; else the first and last at the curve's ends.
        kernels: What runs the inner loops.

    Returns:
        (count,) arc positions, increasing.
    """
    return kernels.equidistant(curve, arc, count, arc[-1] / (2 * count) if centers else 0.0, _MAX_SHIFT)


def equidistant_around(curve: Array, arc: Array, count: int, kernels: Kernels = NUMPY) -> Array:
    """Arc positions of ``count`` >= 2 points with equal chords around a closed curve, the first at its first point.

    Args:
        curve: (P,D), the first point not repeated.
        arc: (P+1,) its arc length, the last entry the whole.
        count: How many.
        kernels: What runs the inner loops.

    Returns:
        (count,) arc positions, increasing from 0.
    """
    around = np.concatenate([curve, curve[:1]])
    return kernels.equidistant(around, arc, count + 1, 0.0, _MAX_SHIFT_AROUND)[:-1]


def straightened(values: Array, window: int, closed: bool = False) -> Array:
    """Values along the first axis, each replaced by the line through its neighbours.

    The filter of A. Savitzky and M. J. E. Golay, "Smoothing and Differentiation of Data by Simplified Least Squares
    Procedures", 1964, of first order, as `scipy.signal.savgol_filter` computes it with its modes "interp" and "wrap".
    That one fits the lines at both ends anew at each call, which takes half a millisecond.

    Args:
        values: (P, ...), P >= window.
        window: How many neighbours, odd: the value itself and as many on both sides. The outermost values of an open
            row take the line of the outermost window.
        closed: The last value is followed by the first.
    """
    half, count = window // 2, len(values)
    if closed:
        values, count = np.concatenate([values[-half:], values, values[:half]]), count + 2 * half
    total = np.cumsum(values, axis=0)
    middle = total[window - 1 :].copy()
    middle[1:] -= total[: count - window]
    middle /= window
    if closed:
        return middle
    first = _ends(window)
    head, tail = first @ values[:window], first[::-1, ::-1] @ values[-window:]
    return np.concatenate([head, middle, tail])


@cache
def _ends(window: int) -> Array:
    """(half, window) what the line through a window gives for its first half."""
    at = np.arange(window) - window // 2
    return (1 / window + np.outer(at, at) / float(at @ at))[: window // 2]
