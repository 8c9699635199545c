"""The batch map against a straight NumPy form of its equations."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from shape_obs.clustering.som import batch_epochs, best_matching_units
from shape_obs.geometry.topology import Chain, Grid, Ring


def epoch(points, weight, nodes, offsets, sigma):
    """Return the intercepts of the lines or planes fitted to the bins of each node's neighbours."""
    size, unit = len(nodes), np.argmin(cdist(points, nodes), axis=1)
    trace = 1e-3 * weight.sum() / size
    count = np.bincount(unit, weight, size) + trace
    mean = np.stack([np.bincount(unit, weight * x, size) for x in points.T], axis=1)
    mean = (mean + trace * nodes) / count[:, None]
    out = np.empty_like(nodes)
    for k in range(size):
        near = np.exp(-0.5 * np.sum(offsets[:, k] ** 2, axis=0) / sigma**2) * count
        basis = np.column_stack([np.ones(size), *offsets[:, k]])
        root = np.sqrt(near)[:, None]
        out[k] = np.linalg.lstsq(root * basis, root * mean, rcond=None)[0][0]
    return out


@given(st.integers(0, 2**32 - 1), st.sampled_from([Chain(7), Ring(9), Grid(3, 4)]), st.integers(2, 3))
def test_epochs_are_weighted_local_fits_over_the_nearest_nodes(seed, topology, dimension):
    rng = np.random.default_rng(seed)
    points, weight = rng.uniform(0, 100, (60, dimension)), rng.uniform(1, 5, 60)
    nodes = rng.uniform(0, 100, (topology.size, dimension))
    shape, expected = (3, 4) if isinstance(topology, Grid) else (1, topology.size), nodes
    for sigma in (0.8, 0.6):
        expected = epoch(points, weight, expected, topology.offsets(), sigma)
    found = batch_epochs(points, weight, nodes, shape, isinstance(topology, Ring), np.array([0.8, 0.6]))
    np.testing.assert_allclose(found, expected, atol=1e-5)
    units = best_matching_units.py_func(points, nodes)  # pyright: ignore[reportFunctionMemberAccess]
    away = cdist(points, nodes)
    np.testing.assert_allclose(away[np.arange(60), units], away.min(axis=1), atol=1e-3)  # in single precision
