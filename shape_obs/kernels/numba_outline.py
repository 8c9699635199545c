"""Outlines on Numba: the same as ``numpy_outline``, loop by loop."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from shape_obs.kernels.interface_outline import (
    FLAT,
    HARMONICS,
    JUDGED_AROUND,
    PEAKS,
    SHIFTS,
    STAIRCASE,
    STAIRCASE_REACH,
    TURNING,
    Array,
)

# Sums may be taken in any order: several numbers at once.
REORDERED = {"reassoc", "contract", "nsz"}

_PAD = STAIRCASE_REACH
_GAUSSIAN = np.exp(-0.5 * (np.arange(_PAD + 1) / STAIRCASE) ** 2)
_WEIGHTS = tuple((_GAUSSIAN / (2 * _GAUSSIAN.sum() - 1)).tolist())
_ROUND = 2 * np.pi / SHIFTS * np.outer(np.arange(1, HARMONICS + 1), np.arange(SHIFTS))
_COS, _SIN = np.cos(_ROUND), np.sin(_ROUND)
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
        out[-1] = points[-1]
    return out


@njit(cache=True, nogil=True)
def closed_arc(curve: Array) -> Array:
    """(P,D) a closed curve, its first point not repeated -> (P+1,) arc length."""
    size, dimension = curve.shape
    arc = np.zeros(size + 1)
    for p in range(size):
        after = p + 1 if p < size - 1 else 0
        square = 0.0
        for d in range(dimension):
            square += (curve[after, d] - curve[p, d]) ** 2
        arc[p + 1] = math.sqrt(square)
    for p in range(size):
        arc[p + 1] += arc[p]
    return arc


@njit(cache=True, nogil=True)
def even(curve: Array, arc: Array, begin: float, count: int) -> Array:
    """(count,D) places of equal arc length around a closed curve (P,D), (P+1,), from an arc position on."""
    size, dimension = curve.shape
    out = np.empty((count, dimension))
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
        for d in range(dimension):
            out[k, d] = curve[before, d] + share * (curve[after, d] - curve[before, d])
    return out


@njit(cache=True, nogil=True)
def followed(points: Array, reference: Array, predicted: Array, share: float) -> tuple[Array, Array, Array, Array]:
    """See ``OutlineKernels.followed``."""
    size, count = len(points), len(predicted)
    arc = closed_arc(points)
    whole = arc[size]
    start = lag(reference, predicted, even(points, arc, 0.0, count)) * (whole / count) % whole
    same = 1e-9 * whole
    if start + same >= whole:
        start = 0.0
    after = np.searchsorted(arc, start + same)
    here = start - arc[after - 1] <= same  # the point is there already
    turned = np.empty((size if here else size + 1, 2))
    gap = max(arc[after] - arc[after - 1], same)
    for d in range(2):
        there = points[after % size, d]
        turned[0, d] = points[after - 1, d] + (start - arc[after - 1]) / gap * (there - points[after - 1, d])
    for p in range(1, len(turned)):
        turned[p] = points[(after + p - 1) % size]
    arc = closed_arc(turned)
    nodes = even(turned, arc, 0.0, count)
    return turned, arc, nodes, blend(reference, nodes, share)


@njit(cache=True, nogil=True, fastmath=REORDERED)
def _waves(points: Array, base_cos: Array, base_sin: Array) -> Array:
    """(K,2) equidistant around an outline, (K,) of its first wave -> (4,H): u cos, u sin, v cos, v sin, summed."""
    count = len(points)
    u, v = points[:, 0].copy(), points[:, 1].copy()
    cos, sin = base_cos.copy(), base_sin.copy()
    out = np.empty((4, HARMONICS))
    for h in range(HARMONICS):
        u_cos = u_sin = v_cos = v_sin = 0.0
        for k in range(count):
            u_cos += u[k] * cos[k]
            u_sin += u[k] * sin[k]
            v_cos += v[k] * cos[k]
            v_sin += v[k] * sin[k]
        out[0, h], out[1, h], out[2, h], out[3, h] = u_cos, u_sin, v_cos, v_sin
        for k in range(count):
            turned = cos[k] * base_cos[k] - sin[k] * base_sin[k]
            sin[k] = sin[k] * base_cos[k] + cos[k] * base_sin[k]
            cos[k] = turned
    return out


@njit(cache=True, nogil=True)
def _spectrum(before: Array, after: Array) -> Array:
    """(4,H) of the correlation over cyclic shifts: real cos, real sin, imaginary cos, imaginary sin; 1 is perfect.

    A wave of u + iv that runs forwards is (u_cos + v_sin) + i (v_cos - u_sin), and one that runs backwards has the
    other signs; the correlation is made of the conjugate of the one outline's times the other's.
    """
    out = np.empty((4, HARMONICS))
    first = second = 0.0
    for h in range(HARMONICS):
        a, b, c, d = before[0, h], before[1, h], before[2, h], before[3, h]
        e, f, g, i = after[0, h], after[1, h], after[2, h], after[3, h]
        ahead = complex(a + d, -(c - b)) * complex(e + i, g - f)
        back = complex(a - d, -(c + b)) * complex(e - i, g + f)
        first += 2 * (a * a + b * b + c * c + d * d)
        second += 2 * (e * e + f * f + g * g + i * i)
        out[0, h], out[1, h] = ahead.real + back.real, back.imag - ahead.imag
        out[2, h], out[3, h] = ahead.imag + back.imag, ahead.real - back.real
    return out / max(math.sqrt(first * second), 1e-12)


@njit(cache=True, nogil=True)
def _score(shape: Array, place: Array, flat: float, turns: float) -> float:
    """How well outlines match at one shift, in turns."""
    base_cos, base_sin = math.cos(2 * math.pi * turns), math.sin(2 * math.pi * turns)
    cos, sin = base_cos, base_sin
    real = imaginary = still = 0.0
    for h in range(HARMONICS):
        real += shape[0, h] * cos + shape[1, h] * sin
        imaginary += shape[2, h] * cos + shape[3, h] * sin
        still += place[0, h] * cos + place[1, h] * sin
        cos, sin = cos * base_cos - sin * base_sin, sin * base_cos + cos * base_sin
    return math.sqrt(real * real + imaginary * imaginary) + flat * still


@njit(cache=True, nogil=True)
def lag(reference: Array, predicted: Array, found: Array) -> float:
    """See ``OutlineKernels.lag``."""
    count = len(found)
    cos, sin = np.empty(count), np.empty(count)
    for k in range(count):
        cos[k], sin[k] = math.cos(2 * math.pi * k / count), math.sin(2 * math.pi * k / count)
    seen = _waves(found, cos, sin)
    shape, place = _spectrum(_waves(reference, cos, sin), seen), _spectrum(_waves(predicted, cos, sin), seen)
    real, imaginary, still = np.zeros(SHIFTS), np.zeros(SHIFTS), np.zeros(SHIFTS)
    for h in range(HARMONICS):
        for s in range(SHIFTS):
            real[s] += shape[0, h] * _COS[h, s] + shape[1, h] * _SIN[h, s]
            imaginary[s] += shape[2, h] * _COS[h, s] + shape[3, h] * _SIN[h, s]
            still[s] += place[0, h] * _COS[h, s] + place[1, h] * _SIN[h, s]
    turned = np.sqrt(real * real + imaginary * imaginary)
    flat = FLAT / (1 + (turned.max() - turned.min()) / FLAT)
    score = turned + flat * still
    at = np.argmax(turned + TURNING * still)
    while True:
        before, after = at - 1 if at else SHIFTS - 1, at + 1 if at < SHIFTS - 1 else 0
        if max(score[before], score[after]) <= score[at]:
            break
        at = before if score[before] >= score[after] else after
    turns = at / SHIFTS
    for width in PEAKS:
        low, middle, high = (
            _score(shape, place, flat, turns - width),
            _score(shape, place, flat, turns),
            _score(shape, place, flat, turns + width),
        )
        bend = low - 2 * middle + high
        if bend < 0:
            turns += width * min(max((low - high) / (2 * bend), -1.0), 1.0)
    return turns * len(found)


@njit(cache=True, nogil=True)
def blend(reference: Array, found: Array, share: float) -> Array:
    """See ``OutlineKernels.blend``."""
    count = len(found)
    before_u = before_v = after_u = after_v = 0.0
    for k in range(count):
        before_u += reference[k, 0] / count
        before_v += reference[k, 1] / count
        after_u += found[k, 0] / count
        after_v += found[k, 1] / count
    cosine = sine = 0.0
    for k in range(count):
        x, y = reference[k, 0] - before_u, reference[k, 1] - before_v
        u, v = found[k, 0] - after_u, found[k, 1] - after_v
        cosine += x * u + y * v
        sine += x * v - y * u
    reach = math.sqrt(cosine * cosine + sine * sine)
    cosine, sine = (cosine / reach, sine / reach) if reach > 0 else (1.0, 0.0)
    out = np.empty_like(found)
    for k in range(count):
        x, y = reference[k, 0] - before_u, reference[k, 1] - before_v
        out[k, 0] = found[k, 0] + (1 - share) * (x * cosine - y * sine - (found[k, 0] - after_u))
        out[k, 1] = found[k, 1] + (1 - share) * (x * sine + y * cosine - (found[k, 1] - after_v))
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
