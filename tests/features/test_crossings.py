"""The feature ``crossings``: counts and passages of one shape among others."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs import Shape
from shape_obs.features import Crossings, FeatureContext
from shape_obs.geometry.crossings import Crossing
from shape_obs.geometry.topology import Chain, Ring

VIEW = FeatureContext(320, 240)
SCENE = (
    Crossing(("a", "a"), (0.125, 0.5), (10.0, 20.0), 1, 1),
    Crossing(("a", "b"), (0.25, 0.875), (30.0, 20.0), 0, -1),
    Crossing(("b", "a"), (0.25, 0.75), (30.0, 50.0), None, 1),
    Crossing(("c", "a"), (0.625, 0.875), (90.0, 50.0), 0, 1),
)


def rope(name, crossings):
    points, known = np.zeros((5, 2), np.float32), np.ones(5, bool)
    own = tuple(c for c in crossings if name in c.slots)
    return Shape(name, points, None, known, known, Chain(5), crossings=own)


def test_counts_and_passages():
    values = Crossings(passages=6).compute(rope("a", SCENE), VIEW)
    np.testing.assert_array_equal(values[:4], [1, 1, 1, 1])
    np.testing.assert_array_equal(
        values[4:].reshape(-1, 2), [[0.125, -1], [0.25, 1], [0.5, 1], [0.75, 0], [0.875, -1], [0, 0]]
    )
    values = Crossings(passages=1).compute(rope("b", SCENE), VIEW)
    np.testing.assert_array_equal(values, [0, 0, 1, 1, 0.25, 0])


def test_values_are_within_their_bounds():
    for feature in (Crossings(), Crossings(passages=0, max_count=1)):
        low, high = feature.bounds(Chain(5), VIEW)
        for scene in ((), SCENE, 50 * SCENE):
            values = feature.compute(rope("a", scene), VIEW)
            assert values.shape == low.shape == high.shape
            assert ((low <= values) & (values <= high)).all()
        assert (low < high).all()


def test_bad_arguments_are_refused():
    with pytest.raises(ValueError, match="is for a Chain"):
        Crossings().bounds(Ring(5), VIEW)
    with pytest.raises(ValueError, match="passages must be at least 0"):
        Crossings(passages=-1)
    with pytest.raises(ValueError, match="max_count must be at least 1"):
        Crossings(max_count=0)
