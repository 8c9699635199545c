r"""Self-organising map: batch epochs over weighted samples, from a good start.

The paper's map moves the best-matching unit of a sample and its neighbours towards the sample,

    c_k <- c_k + a(t) h(k, b(x)) (x - c_k),      b(x) = argmin_k |x - c_k|,      h(k, j) = exp(-|k - j|^2 / 2 s(t)^2),

one sample at a time (``shape_obs.clustering.kohonen`` is that map). Summed over all samples at once, its fixed point is
the batch map: with the weight n_j and the mean m_j of the samples whose best-matching unit is j,

    c_k <- sum_j h(k, j) n_j m_j / sum_j h(k, j) n_j.

That mean is lopsided at the end of a chain, where it pulls the nodes inwards by 2 to 20 px. So each node here is the
intercept of a line (on a lattice, a plane) fitted to the m_j over the index with the same weights. What averaging still
pulls towards the inside of a bend is undone after the last epoch (``Topology.unshrink``).

References:
    T. Kohonen, "Self-Organizing Maps", Springer, 2001: the batch map.
    J. Fan, "Design-adaptive Nonparametric Regression", JASA 87, 1992: the local-linear fit.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.observed import Samples
from shape_obs.geometry.outline import SAMPLED
from shape_obs.geometry.polyline import arc_length, closed, even_around
from shape_obs.geometry.topology import Topology, neighbourhoods, undo_shrinkage

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

# An empty bin pulls its node nowhere: each node keeps a trace of weight where it stands.
_TRACE: Final = 1e-3
_RING_REACH: Final = 2  # nodes to either side among which a sample of an outline looks for its best-matching unit
_FAR: Final = 8.9  # widths of a Gaussian, beyond which it counts as zero


def run_som(samples: Samples, start: Array, topology: Topology, sigmas: tuple[float, ...]) -> Array:
    """Fit a map to samples: one batch epoch for each neighbourhood width.

    Args:
        samples: M weighted points of any dimension D.
        start: ``(K, D)`` nodes.
        topology: How the K nodes are connected.
        sigmas: Width of the neighbourhood in each epoch, node units; without one the nodes stay where they are.

    Returns:
        ``(K, D)`` nodes in the order of ``start``, the pull of the averaging undone.
    """
    if not sigmas:
        return start
    points, weight, start = (
        np.ascontiguousarray(values, dtype=np.float64) for values in (samples.points, samples.weight, start)
    )
    nodes = batch_epochs(points, weight, start, *neighbourhoods(topology, sigmas))
    return topology.unshrink(nodes, sigmas[-1])


@compiled("(f8[:,::1], f8[::1], f8[:,::1], f8[:,:,:,::1], f8[:,:,:,:,::1])", reassociate=True)
def batch_epochs(points: Array, weight: Array, nodes: Array, first: Array, second: Array) -> Array:
    """Run batch epochs of a map with a local-linear neighbourhood.

    Args:
        points: ``(M, D)``.
        weight: ``(M,)``.
        nodes: ``(K, D)``.
        first: ``(E, P+1, K, K)`` moments of the neighbourhood in each epoch, see ``topology.Neighbourhoods``.
        second: ``(E, P+1, P+1, K, K)``.

    Returns:
        ``(K, D)`` new nodes.
    """
    size, dimension = nodes.shape
    middle = np.zeros(dimension)
    for m in range(len(points)):
        for d in range(dimension):
            middle[d] += points[m, d]
    for d in range(dimension):
        middle[d] /= max(len(points), 1)
    moved, out, whole = np.empty_like(points), np.empty_like(nodes), 0.0
    for m in range(len(points)):
        whole += weight[m]
        for d in range(dimension):
            moved[m, d] = points[m, d] - middle[d]
    for k in range(size):
        for d in range(dimension):
            out[k, d] = nodes[k, d] - middle[d]
    planes, count, total = first.shape[1], np.empty(size), np.empty((dimension, size))
    moments, sums = np.empty((planes, planes)), np.empty((planes, dimension))
    for epoch in range(len(first)):
        unit = best_matching_units(moved, out)
        trace = _TRACE * whole / size
        for k in range(size):
            count[k] = trace
            for d in range(dimension):
                total[d, k] = trace * out[k, d]
        for m in range(len(points)):
            k = unit[m]
            count[k] += weight[m]
            for d in range(dimension):
                total[d, k] += weight[m] * moved[m, d]
        for k in range(size):
            for a in range(planes):
                for b in range(a, planes):
                    moment = 0.0
                    for j in range(size):
                        moment += second[epoch, a, b, k, j] * count[j]
                    moments[a, b] = moments[b, a] = moment
                for d in range(dimension):
                    pull = 0.0
                    for j in range(size):
                        pull += first[epoch, a, k, j] * total[d, j]
                    sums[a, d] = pull
            _solve_first(moments, sums)
            for d in range(dimension):
                out[k, d] = sums[0, d]
    for k in range(size):
        for d in range(dimension):
            out[k, d] += middle[d]
    return out


@compiled(reassociate=True)
def best_matching_units(points: Array, nodes: Array) -> Indices:
    """Return the best-matching unit of each point, argmax of x.c - |c|^2 / 2: ``(M, D)``, ``(K, D)`` -> ``(M,)``."""
    dimension = points.shape[1]
    unit, most = np.zeros(len(points), np.int64), np.empty(len(points))
    columns, score = np.empty((dimension, len(points))), np.empty(len(points) if dimension != 2 else 0)
    for m in range(len(points)):
        for d in range(dimension):
            columns[d, m] = points[m, d]
    for k in range(len(nodes)):
        half = 0.0
        for d in range(dimension):
            half += 0.5 * nodes[k, d] ** 2
        if dimension == 2:  # in one pass, which is compiled to vector instructions
            x, y, u, v = columns[0], columns[1], nodes[k, 0], nodes[k, 1]
            for m in range(len(points)):
                near = x[m] * u + y[m] * v - half
                nearer = near > most[m] or k == 0
                most[m] = near if nearer else most[m]
                unit[m] = k if nearer else unit[m]
        else:
            for m in range(len(points)):
                score[m] = -half
            for d in range(dimension):
                for m in range(len(points)):
                    score[m] += columns[d, m] * nodes[k, d]
            for m in range(len(points)):
                nearer = score[m] > most[m] or k == 0
                most[m] = score[m] if nearer else most[m]
                unit[m] = k if nearer else unit[m]
    return unit


@compiled
def _solve_first(moments: Array, sums: Array) -> None:
    """Eliminate all unknowns but the first from a small symmetric positive definite system, which is overwritten.

    Args:
        moments: ``(P, P)``.
        sums: ``(P, D)`` right-hand sides; ``sums[0]`` is the first unknown afterwards.
    """
    for pivot in range(len(moments) - 1, 0, -1):
        for row in range(pivot):
            share = moments[row, pivot] / moments[pivot, pivot]
            for column in range(pivot):
                moments[row, column] -= share * moments[pivot, column]
            for d in range(sums.shape[1]):
                sums[row, d] -= share * sums[pivot, d]
    for d in range(sums.shape[1]):
        sums[0, d] /= moments[0, 0]


@compiled("(f8[:,::1], f8[:,::1], f8[::1], i8, f8)")
def run_ring_som(samples: Array, smooth: Array, start: Array, count: int, sigma: float) -> tuple[Array, Indices]:
    """Fit a ring of nodes to an outline in one epoch.

    The nodes start at equal distances around the smoothed outline. Nodes and samples are both ordered, so a sample
    looks for its best-matching unit only near its own place along the outline, and never takes a node of the other
    side of a thin object.

    Args:
        samples: ``(M, 2)`` the points of the outline, two by two.
        smooth: ``(P, 2)`` the same outline, smoothed; M = ceil(P / 2).
        start: ``(2,)`` the first node starts at the outline's point nearest to it.
        count: How many nodes, K.
        sigma: Width of the neighbourhood, node units.

    Returns:
        ``(K, 2)`` nodes, the pull of the averaging undone; ``(M,)`` the best-matching unit of each sample.
    """
    size = len(smooth)
    around = closed(smooth)
    arc = arc_length(around)
    begin, least = 0.0, np.inf
    for p in range(size):
        square = (smooth[p, 0] - start[0]) ** 2 + (smooth[p, 1] - start[1]) ** 2
        if square < least:
            begin, least = arc[p], square
    nodes, gap = even_around(around, arc, begin, count), arc[size] / count
    middle_u = middle_v = 0.0
    for k in range(count):
        middle_u += nodes[k, 0]
        middle_v += nodes[k, 1]
    middle_u, middle_v = middle_u / count, middle_v / count
    unit = np.empty(len(samples), np.int64)
    trace = _TRACE * size / count
    held, total = np.empty(count), np.empty((count, 2))
    for k in range(count):
        held[k] = trace
        nodes[k, 0] -= middle_u
        nodes[k, 1] -= middle_v
        total[k, 0], total[k, 1] = trace * nodes[k, 0], trace * nodes[k, 1]
    for m in range(len(samples)):
        first = SAMPLED * m
        last = min(first + SAMPLED, size) - 1
        u, v = samples[m, 0] - middle_u, samples[m, 1] - middle_v
        about = int(np.rint(((arc[first] + arc[last]) / 2 - begin) / gap))
        k = nearest_around(u, v, nodes, about, _RING_REACH)
        weight = last - first + 1
        unit[m] = k
        held[k] += weight
        total[k, 0] += weight * u
        total[k, 1] += weight * v
    nodes = _ring_epoch(nodes, held, total, sigma)
    for k in range(count):
        nodes[k, 0] += middle_u
        nodes[k, 1] += middle_v
    return nodes, unit


@compiled
def _ring_epoch(nodes: Array, held: Array, total: Array, sigma: float) -> Array:
    """Update the nodes of a ring from the weight ``(K,)`` and the sums ``(K, 2)`` of their samples; undo the pull."""
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
    return undo_shrinkage(out, share, True)


@compiled
def nearest_around(u: float, v: float, places: Array, about: int, reach: int) -> int:
    """Return which of the points around a ring is nearest to (u, v), of those at most ``reach`` away from ``about``."""
    best, least, size = 0, np.inf, len(places)
    at = (about - reach) % size
    for _ in range(2 * reach + 1):
        x, y = u - places[at, 0], v - places[at, 1]
        square = x * x + y * y
        if square < least:
            best, least = at, square
        at = at + 1 if at < size - 1 else 0
    return best
