"""A ring of nodes that settles on an outline, on Numba."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from shape_obs.compiled.interface import TRACE
from shape_obs.compiled.interface_outline import CELL, JUDGED_AROUND, Array, Indices
from shape_obs.compiled.numba_curve import catmull_rom
from shape_obs.compiled.numba_outline import closed_arc, even, pairs

_BESIDE = 2  # nodes, and by
_NEAR = 6  # points of the curve, how far off the nearest can be from where a sample lies along
_FAR = 8.9  # widths of a Gaussian: nothing counts that lies farther off


@njit(cache=True, nogil=True)
def _nearest(u: float, v: float, places: Array, about: int, reach: int) -> int:
    """The one nearest to (u, v) of the places at most ``reach`` away from one, around a ring."""
    best, least, size = 0, np.inf, len(places)
    at = (about - reach) % size
    for _ in range(2 * reach + 1):
        x, y = u - places[at, 0], v - places[at, 1]
        square = x * x + y * y
        if square < least:
            best, least = at, square
        at = at + 1 if at < size - 1 else 0
    return best


@njit(cache=True, nogil=True)
def _settled(nodes: Array, held: Array, total: Array, sigma: float) -> Array:
    """One local-linear update of a ring from the weight (K,) and the sums (K,2) of its bins, the pull undone."""
    count = len(nodes)
    reach = min(math.ceil(_FAR * sigma), (count - 1) // 2)
    near = np.empty(reach + 1)
    for o in range(reach + 1):
        near[o] = math.exp(-0.5 * (o / sigma) ** 2)
    out = np.empty_like(nodes)
    for k in range(count):
        s0 = s1 = s2 = t0u = t0v = t1u = t1v = 0.0
        for o in range(-reach, reach + 1):
            j = k + o
            j = j - count if j >= count else (j + count if j < 0 else j)
            h = near[abs(o)]
            s0 += h * held[j]
            s1 += h * o * held[j]
            s2 += h * o * o * held[j]
            t0u += h * total[j, 0]
            t0v += h * total[j, 1]
            t1u += h * o * total[j, 0]
            t1v += h * o * total[j, 1]
        over = s0 * s2 - s1 * s1
        out[k, 0], out[k, 1] = (s2 * t0u - s1 * t1u) / over, (s2 * t0v - s1 * t1v) / over
    share = 1 / 24 + near[1] / (1 + 2 * near[1])
    back = np.empty_like(nodes)
    for k in range(count):
        before, after = k - 1 if k else count - 1, k + 1 if k < count - 1 else 0
        for d in range(2):
            back[k, d] = out[k, d] - share * (out[after, d] - 2 * out[k, d] + out[before, d])
    return back


@njit(cache=True, nogil=True)
def _missed(samples: Array, unit: Indices, curve: Array, pieces: int) -> float:
    """Mean distance of (M,2) samples from the tangents of a curve (P,2), each near its node ``unit`` (M,)."""
    size = len(curve)
    step = 0.0
    for p in range(size):
        after = p + 1 if p < size - 1 else 0
        step += math.sqrt((curve[after, 0] - curve[p, 0]) ** 2 + (curve[after, 1] - curve[p, 1]) ** 2) / size
    skip = (len(samples) + JUDGED_AROUND - 1) // JUDGED_AROUND
    total, judged = 0.0, 0
    for m in range(0, len(samples), skip):
        u, v = samples[m, 0], samples[m, 1]
        p = _nearest(u, v, curve, unit[m] * pieces, _NEAR)
        before, after = p - 1 if p else size - 1, p + 1 if p < size - 1 else 0
        x, y = curve[after, 0] - curve[before, 0], curve[after, 1] - curve[before, 1]
        reach = max(math.sqrt(x * x + y * y), 1e-9)
        u, v = u - curve[p, 0], v - curve[p, 1]
        across, beyond = (v * x - u * y) / reach, max(abs(u * x + v * y) / reach - step, 0.0)
        total += math.sqrt(across * across + beyond * beyond)
        judged += 1
    return total / judged


@njit(cache=True, nogil=True)
def ring(points: Array, smooth: Array, place: Array, count: int, sigma: float, pieces: int) -> tuple[Array, float]:
    """See ``OutlineKernels.ring``."""
    size = len(smooth)
    arc = closed_arc(smooth)
    begin, least = 0.0, np.inf
    for p in range(size):
        square = (smooth[p, 0] - place[0]) ** 2 + (smooth[p, 1] - place[1]) ** 2
        if square < least:
            begin, least = arc[p], square
    nodes, gap = even(smooth, arc, begin, count), arc[size] / count
    middle_u, middle_v = nodes[:, 0].sum() / count, nodes[:, 1].sum() / count
    samples = pairs(points)
    unit = np.empty(len(samples), np.int64)
    trace = TRACE * size / count
    held, total = np.full(count, trace), np.empty((count, 2))
    for k in range(count):
        nodes[k, 0] -= middle_u
        nodes[k, 1] -= middle_v
        total[k, 0], total[k, 1] = trace * nodes[k, 0], trace * nodes[k, 1]
    for m in range(len(samples)):
        first = CELL * m
        last = min(first + CELL, size) - 1
        samples[m, 0] -= middle_u
        samples[m, 1] -= middle_v
        about = int(np.rint(((arc[first] + arc[last]) / 2 - begin) / gap))
        k = _nearest(samples[m, 0], samples[m, 1], nodes, about, _BESIDE)
        weight = last - first + 1
        unit[m] = k
        held[k] += weight
        total[k, 0] += weight * samples[m, 0]
        total[k, 1] += weight * samples[m, 1]
    curve = catmull_rom(_settled(nodes, held, total, sigma), pieces, True)
    miss = _missed(samples, unit, curve, pieces)
    for p in range(len(curve)):
        curve[p, 0] += middle_u
        curve[p, 1] += middle_v
    return curve, miss
