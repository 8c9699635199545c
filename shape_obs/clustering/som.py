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
from shape_obs.geometry.polyline import arc_length, closed, even_around, nearest_vertex
from shape_obs.geometry.topology import Grid, Ring, Topology, pull_of, undo_shrinkage

Array = npt.NDArray[np.float64]

_TRACE: Final = 1e-3  # of a mean bin's weight stays where a node is: an empty bin pulls it nowhere
_RING_REACH: Final = 2  # nodes to either side among which a sample of an outline looks for its best-matching unit
_FAR: Final = 6.0  # widths of a Gaussian, beyond which it counts as zero: there it is 1e-8


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
    closed = isinstance(topology, Ring)
    shape = (topology.rows, topology.cols) if isinstance(topology, Grid) else (1, topology.size)
    nodes = batch_epochs(points, weight, start, shape, closed, np.array(sigmas, dtype=np.float64))
    return topology.unshrink(nodes, sigmas[-1])


@compiled("(f8[:,::1], f8[::1], f8[:,::1], UniTuple(i8, 2), b1, f8[::1])")
def batch_epochs(
    points: Array, weight: Array, nodes: Array, shape: tuple[int, int], closed: bool, sigmas: Array
) -> Array:
    """Run batch epochs of a map with a local-linear neighbourhood.

    Args:
        points: ``(M, D)``.
        weight: ``(M,)``.
        nodes: ``(K, D)``.
        shape: Rows and columns of the lattice that the nodes form; a chain or a ring has one row.
        closed: Whether the nodes are a ring.
        sigmas: Width of the neighbourhood in each epoch, node units.

    Returns:
        ``(K, D)`` new nodes.
    """
    size, dimension = nodes.shape
    deep, last = dimension - 2, dimension - 1  # in the plane all lies at depth 0
    origin, out, moved, whole = nodes[0], np.empty_like(nodes), np.empty_like(points), 0.0
    for d in range(dimension):
        for k in range(size):
            out[k, d] = nodes[k, d] - origin[d]
        for m in range(len(points)):
            moved[m, d] = points[m, d] - origin[d]
    for m in range(len(points)):
        whole += weight[m]
    bins, trace = np.empty((size, 4)), _TRACE * whole / size
    for epoch in range(len(sigmas)):
        unit = best_matching_units(moved, out)
        for k in range(size):
            bins[k, 0], bins[k, 1] = trace * out[k, 0], trace * out[k, 1]
            bins[k, 2], bins[k, 3] = trace * deep * out[k, last], trace
        for m in range(len(points)):
            k, w = unit[m], weight[m]
            bins[k, 0] += w * moved[m, 0]
            bins[k, 1] += w * moved[m, 1]
            bins[k, 2] += w * deep * moved[m, last]
            bins[k, 3] += w
        if shape[0] == 1:
            _update_line(out, bins, closed, sigmas[epoch])
        else:
            _update_lattice(out, bins, shape, sigmas[epoch])
    for k in range(size):
        for d in range(dimension):
            out[k, d] += origin[d]
    return out


@compiled
def _update_line(nodes: Array, bins: Array, closed: bool, sigma: float) -> None:
    """Update the nodes ``(K, D)`` of a chain or a ring from the sums over their bins, x, y, z and weight: ``(K, 4)``.

    Each becomes the intercept of a line over the index that is fitted to its neighbours' means.
    """
    count, reach = len(nodes), math.ceil(_FAR * sigma)
    reach = min(reach, (count - 1) // 2 if closed else count - 1)
    near = np.empty(reach + 1)
    for o in range(reach + 1):
        near[o] = math.exp(-0.5 * (o / sigma) ** 2)
    for k in range(count):
        first, last = (-reach, reach) if closed else (-min(reach, k), min(reach, count - 1 - k))
        x = y = z = s0 = tilt_x = tilt_y = tilt_z = s1 = s2 = 0.0
        for o in range(first, last + 1):
            j = k + o
            j = j - count if j >= count else (j + count if j < 0 else j)
            h = near[abs(o)]
            g, u, v, w, n = h * o, bins[j, 0], bins[j, 1], bins[j, 2], bins[j, 3]
            x, y, z, s0 = x + h * u, y + h * v, z + h * w, s0 + h * n
            tilt_x, tilt_y, tilt_z, s1, s2 = tilt_x + g * u, tilt_y + g * v, tilt_z + g * w, s1 + g * n, s2 + g * o * n
        over = s0 * s2 - s1 * s1
        nodes[k, 0], nodes[k, 1] = (s2 * x - s1 * tilt_x) / over, (s2 * y - s1 * tilt_y) / over
        if nodes.shape[1] == 3:
            nodes[k, 2] = (s2 * z - s1 * tilt_z) / over


@compiled
def _update_lattice(nodes: Array, bins: Array, shape: tuple[int, int], sigma: float) -> None:
    """Update the nodes of a lattice as ``_update_line`` does those of a line, by planes over row and column."""
    (rows, cols), reach = shape, math.ceil(_FAR * sigma)
    moments, sums, phi = np.empty((3, 3)), np.empty((3, nodes.shape[1])), np.empty(3)
    phi[0] = 1.0
    for k in range(len(nodes)):
        row, col = k // cols, k % cols
        for a in range(3):
            for b in range(3):
                moments[a, b] = 0.0
            for d in range(nodes.shape[1]):
                sums[a, d] = 0.0
        for r in range(max(row - reach, 0), min(row + reach + 1, rows)):
            for c in range(max(col - reach, 0), min(col + reach + 1, cols)):
                j, phi[1], phi[2] = r * cols + c, r - row, c - col
                h = math.exp(-0.5 * (phi[1] ** 2 + phi[2] ** 2) / sigma**2)
                for a in range(3):
                    for b in range(3):
                        moments[a, b] += h * phi[a] * phi[b] * bins[j, 3]
                    for d in range(nodes.shape[1]):
                        sums[a, d] += h * phi[a] * bins[j, d]
        _solve_first(moments, sums)
        for d in range(nodes.shape[1]):
            nodes[k, d] = sums[0, d]


@compiled(reassociate=True)
def best_matching_units(points: Array, nodes: Array) -> npt.NDArray[np.int32]:
    """Return the best-matching unit of each point, argmax of x.c - |c|^2 / 2: ``(M, D)``, ``(K, D)`` -> ``(M,)``.

    In single precision relative to the first node, in one pass over all points for each node, so that a processor
    compares many at once. Of nodes that are equally near to seven digits, either may be returned.
    """
    count, dimension = len(points), points.shape[1]
    unit, most = np.zeros(count, np.int32), np.full(count, -np.inf, np.float32)
    x, y, z = np.empty(count, np.float32), np.empty(count, np.float32), np.zeros(count, np.float32)
    for m in range(count):
        x[m], y[m] = points[m, 0] - nodes[0, 0], points[m, 1] - nodes[0, 1]
        if dimension == 3:
            z[m] = points[m, 2] - nodes[0, 2]
    for k in range(len(nodes)):
        u, v = np.float32(nodes[k, 0] - nodes[0, 0]), np.float32(nodes[k, 1] - nodes[0, 1])
        w = np.float32(nodes[k, 2] - nodes[0, 2]) if dimension == 3 else np.float32(0)
        half, own = (u * u + v * v + w * w) * np.float32(0.5), np.int32(k)
        for m in range(count):
            score = x[m] * u + y[m] * v + z[m] * w - half
            nearer = score > most[m]
            most[m] = score if nearer else most[m]
            unit[m] = own if nearer else unit[m]
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


@compiled
def run_ring_som(samples: Array, smooth: Array, start: Array, count: int, sigma: float) -> Array:
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
        ``(K, 2)`` nodes, the pull of the averaging undone.
    """
    size = len(smooth)
    around = closed(smooth)
    arc = arc_length(around)
    begin = arc[nearest_vertex(smooth, start)]
    nodes, gap = even_around(around, arc, begin, count), arc[size] / count
    middle_u = middle_v = 0.0
    for k in range(count):
        middle_u += nodes[k, 0]
        middle_v += nodes[k, 1]
    middle_u, middle_v = middle_u / count, middle_v / count
    trace = _TRACE * size / count
    bins = np.zeros((count, 4))
    for k in range(count):
        nodes[k, 0] -= middle_u
        nodes[k, 1] -= middle_v
        bins[k, 0], bins[k, 1], bins[k, 3] = trace * nodes[k, 0], trace * nodes[k, 1], trace
    for m in range(len(samples)):
        first = SAMPLED * m
        last = min(first + SAMPLED, size) - 1
        u, v = samples[m, 0] - middle_u, samples[m, 1] - middle_v
        about = int(np.rint(((arc[first] + arc[last]) / 2 - begin) / gap))
        k = nearest_around(u, v, nodes, about, _RING_REACH)
        weight = last - first + 1
        bins[k, 0] += weight * u
        bins[k, 1] += weight * v
        bins[k, 3] += weight
    _update_line(nodes, bins, True, sigma)
    nodes = undo_shrinkage(nodes, pull_of(sigma), True)
    for k in range(count):
        nodes[k, 0] += middle_u
        nodes[k, 1] += middle_v
    return nodes


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
