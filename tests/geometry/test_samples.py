"""Samples of pairs of outline points."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs.geometry.outline import pairs


@pytest.mark.parametrize("count", [1, 2, 7, 8])
def test_pairs_are_means_of_two(count):
    points = np.random.default_rng(0).uniform(0, 9, (count, 2))
    expected = [points[k : k + 2].mean(axis=0) for k in range(0, count, 2)]
    np.testing.assert_allclose(pairs(points), expected)
