"""Self-organising maps on NumPy: the readable reference."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shape_obs.compiled.interface import TRACE, Array


def best_matching_units(points: Array, nodes: Array) -> npt.NDArray[np.intp]:
    """See ``Kernels.best_matching_units``."""
    dual = np.empty((nodes.shape[1] + 1, len(nodes)))
    dual[:-1] = nodes.T
    return _nearest(_raised(points.T), dual)


def _raised(rows: Array) -> Array:
    """(D+1,M) rows of coordinates with one of 1s, so that |c|^2 is a product like the others."""
    raised = np.ones((len(rows) + 1, rows.shape[1]))
    raised[:-1] = rows
    return raised


def _nearest(raised: Array, dual: Array) -> npt.NDArray[np.intp]:
    """(M,) the nearest node; its row in ``dual`` that belongs to the 1s is written here."""
    (dual[:-1] * dual[:-1]).sum(axis=0, out=dual[-1])
    dual[-1] *= -0.5
    return (raised.T @ dual).argmax(axis=1)


def settle(points: Array, weight: Array, nodes: Array, first: Array, second: Array) -> Array:
    """See ``Kernels.settle``.

    Nodes and bins are rows of coordinates, the last one of 1s and of weights. As phi_0 = 1, ``first`` is a part of
    ``second``, and one product gives the moments of all rows.
    """
    size, planes = len(nodes), first.shape[1]
    origin = nodes[size // 2][:, None]  # sums lose nothing near 0
    raised, rows = _raised(points.T - origin), _raised(nodes.T - origin)
    weighted, lines = (raised * weight).ravel(), np.arange(0, rows.size, size)[:, None]
    trace = TRACE * float(weight.sum()) / size
    for h in second.reshape(len(second), -1, size):
        unit = _nearest(raised, rows.copy())
        bins = trace * rows
        bins += np.bincount((unit + lines).ravel(), weighted, bins.size).reshape(bins.shape)
        moments = (bins @ h.T).reshape(-1, planes, planes, size)
        if planes == 2:
            solved = moments[-1, 1, 1] * moments[:, 0, 0] - moments[-1, 0, 1] * moments[:, 0, 1]
            rows = solved / solved[-1]  # Cramer's rule; its last row is the determinant
        else:
            rows[:-1] = np.linalg.solve(moments[-1].transpose(2, 0, 1), moments[:-1, 0].transpose(2, 1, 0))[:, 0].T
    return (rows[:-1] + origin).T.copy()
