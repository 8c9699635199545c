"""Outlines on Numba: the same as ``numpy_outline``, loop by loop."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from shape_obs.compiled.interface_outline import JUDGED_AROUND, STAIRCASE, STAIRCASE_REACH, Array

# Sums may be taken in any order: several numbers at once.
REORDERED = {"reassoc", "contract", "nsz"}

_PAD = STAIRCASE_REACH
_GAUSSIAN = np.exp(-0.5 * (np.arange(_PAD + 1) / STAIRCASE) ** 2)
_WEIGHTS = tuple((_GAUSSIAN / (2 * _GAUSSIAN.sum() - 1)).tolist())
_GROUP = 16  # points of a curve that are ruled out together when the nearest is looked for


@njit(cache=True, nogil=True)
def _wrap(padded: Array) -> None:
    """Fill in what lies before and behind a ring."""
    size = len(padded) - 2 * _PAD
    for i in range(_PAD):
        padded[i] = padded[_PAD + (i - _PAD) % size]
        padded[_PAD + size + i] = padded[_PAD + i % size]


@njit(cache=True, nogil=True)
def _smoothed(padded: Array, out: Array) -> None:
    """Fill a ring of numbers, with what lies before and behind it, with another one under a Gaussian: (P+2R,) both."""
    for p in range(len(padded) - 2 * _PAD):
        out[p + 4] = (
            _WEIGHTS[0] * padded[p + 4]
            + _WEIGHTS[1] * (padded[p + 3] + padded[p + 5])
            + _WEIGHTS[2] * (padded[p + 2] + padded[p + 6])
            + _WEIGHTS[3] * (padded[p + 1] + padded[p + 7])
            + _WEIGHTS[4] * (padded[p] + padded[p + 8])
        )
    _wrap(out)


@njit(cache=True, nogil=True)
def border(traced: Array, hole: bool) -> tuple[Array, Array]:
    """See ``OutlineKernels.border``."""
    size = len(traced)
    u, v = np.empty(size + 2 * _PAD), np.empty(size + 2 * _PAD)
    smooth_u, smooth_v = np.empty_like(u), np.empty_like(v)
    area = 0.0
    for p in range(size - 1):
        area += (traced[p, 0] - traced[0, 0]) * (traced[p + 1, 1] - traced[0, 1])
        area -= (traced[p, 1] - traced[0, 1]) * (traced[p + 1, 0] - traced[0, 0])
    first, step = (size - 1, -1) if area < 0 else (0, 1)
    for p in range(size):
        u[p + _PAD], v[p + _PAD] = traced[first + step * p, 0], traced[first + step * p, 1]
    _wrap(u)
    _wrap(v)
    _smoothed(u, smooth_u)
    _smoothed(v, smooth_v)
    points, side = np.empty((size, 2)), -1.0 if hole else 1.0
    for p in range(size):
        along_u = smooth_u[p + _PAD + 1] - smooth_u[p + _PAD - 1]
        along_v = smooth_v[p + _PAD + 1] - smooth_v[p + _PAD - 1]
        shift = 0.5 * side * max(abs(along_u), abs(along_v)) / max(along_u * along_u + along_v * along_v, 1e-18)
        u[p + _PAD] += shift * along_v
        v[p + _PAD] -= shift * along_u
        points[p, 0], points[p, 1] = u[p + _PAD], v[p + _PAD]
    _wrap(u)
    _wrap(v)
    _smoothed(u, smooth_u)
    _smoothed(v, smooth_v)
    curve = np.empty((size, 2))
    for p in range(size):
        curve[p, 0], curve[p, 1] = smooth_u[p + _PAD], smooth_v[p + _PAD]
    return points, curve


@njit(cache=True, nogil=True)
def pairs(points: Array) -> Array:
    """See ``OutlineKernels.pairs``."""
    size, dimension = points.shape
    out = np.empty(((size + 1) // 2, dimension))
    for p in range(size // 2):
        for d in range(dimension):
            out[p, d] = (points[2 * p, d] + points[2 * p + 1, d]) / 2
    if size % 2:
        for d in range(dimension):
            out[size // 2, d] = points[size - 1, d]
    return out


@njit(cache=True, nogil=True)
def closed_arc(curve: Array) -> Array:
    """(P,2) a closed curve, its first point not repeated -> (P+1,) arc length."""
    size = len(curve)
    arc = np.zeros(size + 1)
    for p in range(size - 1):
        x, y = curve[p + 1, 0] - curve[p, 0], curve[p + 1, 1] - curve[p, 1]
        arc[p + 1] = math.sqrt(x * x + y * y)
    arc[size] = math.sqrt((curve[0, 0] - curve[size - 1, 0]) ** 2 + (curve[0, 1] - curve[size - 1, 1]) ** 2)
    for p in range(size):
        arc[p + 1] += arc[p]
    return arc


@njit(cache=True, nogil=True)
def even(curve: Array, arc: Array, begin: float, count: int) -> Array:
    """(count,2) places of equal arc length around a closed curve (P,2), (P+1,), from an arc position on."""
    size = len(curve)
    out = np.empty((count, 2))
    step, whole = arc[size] / count, arc[size]
    at, before = begin % whole, 0
    at = at if at < whole else 0.0
    while before < size - 1 and arc[before + 1] <= at:
        before += 1
    first = at
    for k in range(count):
        at = first + k * step
        if at >= whole:
            at -= whole
        if at < arc[before]:
            before = 0
        while before < size - 1 and arc[before + 1] <= at:
            before += 1
        after = before + 1 if before < size - 1 else 0
        gap = arc[before + 1] - arc[before]
        share = (at - arc[before]) / gap if gap > 0 else 0.0
        for d in range(2):
            out[k, d] = curve[before, d] + share * (curve[after, d] - curve[before, d])
    return out


@njit(cache=True, nogil=True)
def miss(points: Array, curve: Array, size: float) -> float:
    """See ``OutlineKernels.miss``."""
    points = points[:: (len(points) + JUDGED_AROUND - 1) // JUDGED_AROUND]
    count, dimension = curve.shape
    groups = (count + _GROUP - 1) // _GROUP
    middle, radius = np.zeros((groups, dimension)), np.zeros(groups)
    for g in range(groups):
        first, last = g * _GROUP, min((g + 1) * _GROUP, count)
        for d in range(dimension):
            for p in range(first, last):
                middle[g, d] += curve[p, d] / (last - first)
        for p in range(first, last):
            square = 0.0
            for d in range(dimension):
                square += (curve[p, d] - middle[g, d]) ** 2
            radius[g] = max(radius[g], square)
        radius[g] = math.sqrt(radius[g])
    total, nearest, step = 0.0, 0, size / count
    for m in range(len(points)):
        # Points come in order around the curve, so the last one's nearest is near this one's: a bound for the rest.
        least = np.inf
        for i in range(-2, 7):
            p = (nearest + i) % count
            square = 0.0
            for d in range(dimension):
                square += (points[m, d] - curve[p, d]) ** 2
            least = min(least, square)
        bound = math.sqrt(least)
        least = np.inf
        for g in range(groups):
            square = 0.0
            for d in range(dimension):
                square += (points[m, d] - middle[g, d]) ** 2
            if square > (radius[g] + bound) ** 2 * (1 + 1e-12):
                continue
            for p in range(g * _GROUP, min((g + 1) * _GROUP, count)):
                square = 0.0
                for d in range(dimension):
                    square += (points[m, d] - curve[p, d]) ** 2
                if square < least:
                    nearest, least = p, square
        before, after = nearest - 1 if nearest else count - 1, nearest + 1 if nearest < count - 1 else 0
        along = reach = 0.0
        for d in range(dimension):
            tangent = curve[after, d] - curve[before, d]
            reach += tangent * tangent
            along += (points[m, d] - curve[nearest, d]) * tangent
        along /= max(math.sqrt(reach), 1e-9)
        beyond = max(abs(along) - step, 0.0)
        total += math.sqrt(max(least - along * along, 0.0) + beyond * beyond)
    return total / len(points)
