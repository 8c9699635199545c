"""Curves as polylines, on Numba."""

from __future__ import annotations

import numpy as np
from numba import njit

from shape_obs.compiled.interface import EQUAL, EQUALISING_PASSES, JUDGED, Array
from shape_obs.compiled.numba_map import best_matching_units


@njit(cache=True, nogil=True)
def arc_length(curve: Array) -> Array:
    """See ``Kernels.arc_length``."""
    arc = np.zeros(len(curve))
    for p in range(1, len(curve)):
        square = 0.0
        for d in range(curve.shape[1]):
            square += (curve[p, d] - curve[p - 1, d]) ** 2
        arc[p] = arc[p - 1] + np.sqrt(square)
    return arc


@njit(cache=True, nogil=True)
def interpolate(curve: Array, arc: Array, at: Array) -> Array:
    """See ``Kernels.interpolate``."""
    last, dimension = len(curve) - 1, curve.shape[1]
    out = np.empty((len(at), dimension))
    before = 0
    for n in range(len(at)):
        if at[n] <= arc[0]:
            out[n] = curve[0]
        elif at[n] >= arc[last]:
            out[n] = curve[last]
        else:
            if arc[before] > at[n] or arc[min(before + 8, last)] < at[n]:
                before = np.searchsorted(arc, at[n]) - 1
            while arc[before + 1] < at[n]:
                before += 1
            gap = arc[before + 1] - arc[before]
            share = (at[n] - arc[before]) / gap if gap > 0 else 0.0
            for d in range(dimension):
                out[n, d] = curve[before, d] + share * (curve[before + 1, d] - curve[before, d])
    return out


@njit(cache=True, nogil=True)
def unshrink(nodes: Array, share: float, closed: bool) -> Array:
    """See ``Kernels.unshrink``."""
    size, dimension = nodes.shape
    out = np.empty_like(nodes)
    for k in range(size):
        end = not closed and (k == 0 or k == size - 1)
        at = min(max(k, 1), size - 2) if end else k
        by = 1 / 24 if end else share
        for d in range(dimension):
            bend = nodes[(at + 1) % size, d] - 2 * nodes[at, d] + nodes[at - 1, d]
            out[k, d] = nodes[k, d] - by * bend
    return out


@njit(cache=True, nogil=True)
def catmull_rom(nodes: Array, subdivisions: int = 4, closed: bool = False) -> Array:
    """See ``Kernels.catmull_rom``."""
    size, dimension = nodes.shape
    pieces = size if closed else size - 1
    gap = np.empty(pieces)
    for k in range(pieces):
        square = 0.0
        for d in range(dimension):
            square += (nodes[(k + 1) % size, d] - nodes[k, d]) ** 2
        gap[k] = max(np.sqrt(square), 1e-9)
    tangent = np.empty((size, dimension))
    for k in range(size):
        if closed or 0 < k < size - 1:
            before, after = gap[k - 1], gap[k % pieces]
            for d in range(dimension):
                back = (nodes[k, d] - nodes[k - 1, d]) / before
                ahead = (nodes[(k + 1) % size, d] - nodes[k, d]) / after
                tangent[k, d] = (back * after + ahead * before) / (before + after)
    if not closed:
        for d in range(dimension):
            tangent[0, d] = 2 * (nodes[1, d] - nodes[0, d]) / gap[0] - tangent[1, d]
            tangent[-1, d] = 2 * (nodes[-1, d] - nodes[-2, d]) / gap[-1] - tangent[-2, d]
    out = np.empty((pieces * subdivisions + (0 if closed else 1), dimension))
    for i in range(subdivisions):
        t = i / subdivisions
        here, there = (1 + 2 * t) * (1 - t) ** 2, t * t * (3 - 2 * t)
        leaving, arriving = t * (1 - t) * (1 - t), t * (1 - t) * t
        for k in range(pieces):
            after = (k + 1) % size
            for d in range(dimension):
                out[k * subdivisions + i, d] = (
                    here * nodes[k, d]
                    + there * nodes[after, d]
                    + gap[k] * (leaving * tangent[k, d] - arriving * tangent[after, d])
                )
    if not closed:
        out[-1] = nodes[-1]
    return out


@njit(cache=True, nogil=True)
def equidistant(curve: Array, arc: Array, count: int, margin: float, max_shift: float) -> Array:
    """See ``Kernels.equidistant``."""
    even = np.empty(count)
    for n in range(count):
        even[n] = margin + (arc[-1] - 2 * margin) * (n / (count - 1))
    at = even.copy()
    shift = max_shift * (even[1] - even[0])
    share = np.empty(count)
    for _ in range(EQUALISING_PASSES):
        chord = arc_length(interpolate(curve, arc, at))
        least, most = np.inf, 0.0
        for n in range(count - 1):
            gap = chord[n + 1] - chord[n]
            least, most = min(least, gap), max(most, gap)
        if most - least < EQUAL * chord[-1] / count:
            break
        before = 0
        for n in range(count):
            wanted = chord[-1] * n / (count - 1)
            while before < count - 2 and chord[before + 1] < wanted:
                before += 1
            gap = chord[before + 1] - chord[before]
            part = min(max((wanted - chord[before]) / gap, 0.0), 1.0) if gap > 0 else 0.0
            share[n] = at[before] + part * (at[before + 1] - at[before])
        for n in range(count):
            at[n] = min(max(share[n], even[n] - shift), even[n] + shift)
    return at


@njit(cache=True, nogil=True)
def spread(points: Array, weight: Array, curve: Array) -> float:
    """See ``Kernels.spread``."""
    size, dimension = curve.shape
    step = -(-len(points) // JUDGED)
    points, weight = points[::step].copy(), weight[::step]
    nearest = best_matching_units(points, curve)
    tangent, reach = np.empty((size, dimension)), np.empty(size)
    for p in range(size):
        before, after = max(p - 1, 0), min(p + 1, size - 1)
        square = 0.0
        for d in range(dimension):
            tangent[p, d] = (curve[after, d] - curve[before, d]) / (after - before)
            square += tangent[p, d] ** 2
        reach[p] = np.sqrt(square)
        tangent[p] /= max(reach[p], 1e-9)
    total = whole = 0.0
    for m in range(len(points)):
        p = nearest[m]
        along = square = 0.0
        for d in range(dimension):
            offset = points[m, d] - curve[p, d]
            along += offset * tangent[p, d]
            square += offset * offset
        beyond = min(max(along, -reach[p]), reach[p])
        total += weight[m] * max(square - 2 * along * beyond + beyond * beyond, 0.0)
        whole += weight[m]
    return total / whole
