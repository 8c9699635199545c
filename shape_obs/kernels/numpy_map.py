"""Self-organising maps on NumPy: the readable reference."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shape_obs.kernels.interface import TRACE, Array


def best_matching_units(points: Array, nodes: Array) -> npt.NDArray[np.intp]:
    """See ``Kernels.best_matching_units``."""
    return np.argmax(points @ nodes.T - 0.5 * np.einsum("kd,kd->k", nodes, nodes), axis=1)


def settle(points: Array, weight: Array, nodes: Array, first: Array, second: Array) -> Array:
    """See ``Kernels.settle``."""
    middle = points.sum(axis=0) / max(len(points), 1)
    points, nodes = points - middle, nodes - middle
    weighted = (weight[:, None] * points).T.copy()
    size = len(nodes)
    trace = TRACE * weight.sum() / size
    for h1, h2 in zip(first, second, strict=True):
        unit = best_matching_units(points, nodes)
        count = np.bincount(unit, weights=weight, minlength=size) + trace
        total = trace * nodes
        for d, values in enumerate(weighted):
            total[:, d] += np.bincount(unit, weights=values, minlength=size)
        moments, sums = h2 @ count, h1 @ total
        if len(sums) == 2:
            (s0, s1), (_, s2) = moments
            nodes = (s2[:, None] * sums[0] - s1[:, None] * sums[1]) / (s0 * s2 - s1 * s1)[:, None]
        else:
            nodes = np.linalg.solve(np.moveaxis(moments, -1, 0), np.moveaxis(sums, 1, 0))[:, 0]
    return nodes + middle
