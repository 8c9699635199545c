"""Self-organising maps on NumPy: the readable reference."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shape_obs.kernels.interface import TRACE, Array


def best_matching_units(points: Array, nodes: Array) -> npt.NDArray[np.intp]:
    """See ``Kernels.best_matching_units``."""
    return _nearest(_raised(points), nodes)


def _raised(points: Array) -> Array:
    """(M,D+1) the points with a coordinate of 1, so that |c|^2 is a product like the others."""
    raised = np.ones((len(points), points.shape[1] + 1))
    raised[:, :-1] = points
    return raised


def _nearest(raised: Array, nodes: Array) -> npt.NDArray[np.intp]:
    dual = _raised(nodes)
    dual[:, -1] = -0.5 * np.einsum("kd,kd->k", nodes, nodes)
    return np.argmax(raised @ dual.T, axis=1)


def settle(points: Array, weight: Array, nodes: Array, first: Array, second: Array) -> Array:
    """See ``Kernels.settle``."""
    middle = points.sum(axis=0) / max(len(points), 1)
    points, nodes = points - middle, nodes - middle
    raised, weighted = _raised(points), (weight[:, None] * points).T.copy()
    size, planes = len(nodes), first.shape[1]
    trace = TRACE * float(weight.sum()) / size
    for h1, h2 in zip(first, second, strict=True):
        unit = _nearest(raised, nodes)
        count = np.bincount(unit, weights=weight, minlength=size) + trace
        total = trace * nodes
        for d, values in enumerate(weighted):
            total[:, d] += np.bincount(unit, weights=values, minlength=size)
        moments = (h2.reshape(-1, size) @ count).reshape(planes, planes, size)
        sums = (h1.reshape(-1, size) @ total).reshape(planes, size, -1)
        if planes == 2:
            s0, s1, s2 = moments[0, 0], moments[0, 1], moments[1, 1]
            whole = s0 * s2 - s1 * s1
            nodes = (s2 / whole)[:, None] * sums[0] - (s1 / whole)[:, None] * sums[1]
        else:
            nodes = np.linalg.solve(np.moveaxis(moments, -1, 0), np.moveaxis(sums, 1, 0))[:, 0]
    return nodes + middle
