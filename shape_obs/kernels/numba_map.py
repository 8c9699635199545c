"""Self-organising maps on Numba."""

from __future__ import annotations

import numpy as np
from numba import njit

from shape_obs.kernels.interface import TRACE, Array, Indices


@njit(cache=True, nogil=True)
def best_matching_units(points: Array, nodes: Array) -> Indices:
    """See ``Kernels.best_matching_units``."""
    size, dimension = nodes.shape
    half = np.empty(size)
    for k in range(size):
        half[k] = 0.0
        for d in range(dimension):
            half[k] -= 0.5 * nodes[k, d] ** 2
    unit = np.empty(len(points), np.intp)
    if dimension == 2:
        u, v = nodes[:, 0].copy(), nodes[:, 1].copy()
        score = np.empty(size)
        for m in range(len(points)):
            x, y = points[m, 0], points[m, 1]
            for k in range(size):
                score[k] = half[k] + x * u[k] + y * v[k]
            best = 0
            for k in range(1, size):
                if score[k] > score[best]:
                    best = k
            unit[m] = best
        return unit
    for m in range(len(points)):
        best, most = 0, -np.inf
        for k in range(size):
            value = half[k]
            for d in range(dimension):
                value += points[m, d] * nodes[k, d]
            if value > most:
                best, most = k, value
        unit[m] = best
    return unit


@njit(cache=True, nogil=True)
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
