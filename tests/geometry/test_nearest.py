"""The nearest places of a polyline, by brute force."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from shape_obs.geometry.polyline import arc_length, interpolate, nearest_on, resample


@given(st.integers(0, 2**32 - 1))
def test_nearest_places_by_brute_force(seed):
    rng = np.random.default_rng(seed)
    curve, points = rng.uniform(0, 10, (6, 2)), rng.uniform(0, 10, (5, 2))
    arc, distance = nearest_on(curve, points)
    fine = resample(curve, 20001)
    away = np.linalg.norm(points[:, None] - fine, axis=2)
    np.testing.assert_allclose(distance, away.min(axis=1), atol=1e-2)
    on = interpolate(curve, arc_length(curve), arc)
    np.testing.assert_allclose(np.linalg.norm(on - points, axis=1), distance, atol=1e-9)
    assert np.isnan(nearest_on(curve, np.full((1, 2), np.nan))[1]).all()
