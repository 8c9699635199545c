"""Corners of a sheet in the plane: the similarity transform that NumPy's singular values give in any dimension."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs.geometry.lattice import outer_corners
from shape_obs.tracking.corner_matching import _match_corners_space, match_corners_plane


def test_the_plane_s_match_is_that_of_any_dimension():
    rng = np.random.default_rng(0)
    for _ in range(50):
        nodes, lattice = rng.uniform(0, 200, (4, 5, 2)), rng.uniform(0, 200, (2, 2, 2))
        corners = lattice[[0, 0, 1, 1], [0, 1, 1, 0]]
        quarters, worst, share = match_corners_plane(nodes, lattice)
        expected = _match_corners_space(outer_corners(nodes), corners)
        assert (quarters, worst) == expected[:2]
        assert share == pytest.approx(expected[2])
