"""The phase of an outline on Numba: where its numbering begins."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from shape_obs.compiled.interface_outline import FLAT, HARMONICS, PEAKS, SHIFTS, TURNING, Array
from shape_obs.compiled.numba_outline import REORDERED, closed_arc, even

_ROUND = 2 * np.pi / SHIFTS * np.outer(np.arange(1, HARMONICS + 1), np.arange(SHIFTS))
_COS, _SIN = np.cos(_ROUND), np.sin(_ROUND)


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
        at = (after + p - 1) % size
        turned[p, 0], turned[p, 1] = points[at, 0], points[at, 1]
    arc = closed_arc(turned)
    nodes = even(turned, arc, 0.0, count)
    return turned, arc, nodes, blend(reference, nodes, share)
