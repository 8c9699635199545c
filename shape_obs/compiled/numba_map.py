"""Self-organising maps on Numba."""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit

from shape_obs.compiled.interface import TRACE, Array, Indices

# Sums may be taken in any order, so that they run four abreast: the last digits of 16 differ.
_SUMS: Final = {"reassoc", "contract", "nsz"}


@njit(cache=True, nogil=True, fastmath=_SUMS)
def best_matching_units(points: Array, nodes: Array) -> Indices:
    """See ``Kernels.best_matching_units``."""
    unit, most = np.zeros(len(points), np.int64), np.empty(len(points))
    columns = points.T.copy()
    for k in range(len(nodes)):
        half = 0.0
        for d in range(nodes.shape[1]):
            half += 0.5 * nodes[k, d] ** 2
        if len(columns) == 2:
            _take(unit, most, columns[0], columns[1], nodes[k, 0], nodes[k, 1], half, k)
        else:
            score = np.full(len(points), -half)
            for d in range(len(columns)):
                score += columns[d] * nodes[k, d]
            for m in range(len(points)):
                if k == 0 or score[m] > most[m]:
                    most[m], unit[m] = score[m], k
    return unit


@njit(cache=True, nogil=True, inline="always")
def _take(unit: Indices, most: Array, x: Array, y: Array, u: float, v: float, half: float, k: int) -> None:
    """Give points in the plane to node k where it is nearer than those before it."""
    for m in range(len(x)):
        score = x[m] * u + y[m] * v - half
        nearer = score > most[m] or k == 0
        most[m] = score if nearer else most[m]
        unit[m] = k if nearer else unit[m]


@njit(cache=True, nogil=True, fastmath=_SUMS)
def settle(points: Array, weight: Array, nodes: Array, first: Array, second: Array) -> Array:
    """See ``Kernels.settle``."""
    size, dimension = nodes.shape
    middle = np.zeros(dimension)
    for m in range(len(points)):
        for d in range(dimension):
            middle[d] += points[m, d]
    middle /= max(len(points), 1)
    points, nodes = points - middle, nodes - middle
    whole = weight.sum()
    count, total = np.empty(size), np.empty((size, dimension))
    planes = first.shape[1]
    for epoch in range(len(first)):
        unit = best_matching_units(points, nodes)
        trace = TRACE * whole / size
        for k in range(size):
            count[k] = trace
            for d in range(dimension):
                total[k, d] = trace * nodes[k, d]
        for m in range(len(points)):
            k = unit[m]
            count[k] += weight[m]
            for d in range(dimension):
                total[k, d] += weight[m] * points[m, d]
        if planes == 2:
            for k in range(size):
                s0 = s1 = s2 = 0.0
                for j in range(size):
                    s0 += second[epoch, 0, 0, k, j] * count[j]
                    s1 += second[epoch, 0, 1, k, j] * count[j]
                    s2 += second[epoch, 1, 1, k, j] * count[j]
                for d in range(dimension):
                    t0 = t1 = 0.0
                    for j in range(size):
                        t0 += first[epoch, 0, k, j] * total[j, d]
                        t1 += first[epoch, 1, k, j] * total[j, d]
                    nodes[k, d] = (s2 * t0 - s1 * t1) / (s0 * s2 - s1 * s1)
        else:
            moments, sums = np.empty((planes, planes)), np.empty((planes, dimension))
            for k in range(size):
                for a in range(planes):
                    for b in range(planes):
                        moments[a, b] = np.sum(second[epoch, a, b, k] * count)
                    for d in range(dimension):
                        sums[a, d] = np.sum(first[epoch, a, k] * total[:, d])
                nodes[k] = np.linalg.solve(moments, sums)[0]
    return nodes + middle
