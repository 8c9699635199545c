"""The four corners of a sheet's outline."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from shape_obs.initialization.corners import Rim
from tests.benchmarks.scenes.sheets import rotation


@settings(max_examples=20)
@given(shift=st.integers(0, 1000), degrees=st.floats(0, 360))
def test_corners_do_not_depend_on_where_the_outline_begins(shift, degrees):
    square = np.array([[0.0, 0], [90, 0], [90, 60], [0, 60]]) @ rotation(degrees).T
    t = np.linspace(0, 1, 60, endpoint=False)[:, None]
    outline = np.concatenate([(1 - t) * square[k] + t * square[(k + 1) % 4] for k in range(4)])
    outline = np.roll(outline, shift, axis=0)
    rim = Rim.along(outline, outline)
    corners = rim.corners()
    assert corners is not None
    points, kink = rim.patch(corners)
    found = points.reshape(25, 25, 2)[[0, 0, -1, -1], [0, -1, -1, 0]]
    away = np.linalg.norm(found[:, None] - square, axis=2)
    assert away.min(axis=0).max() < 1.5
    assert kink < 0.05
    np.testing.assert_array_equal(rim.corners_near(np.roll(found, -1, axis=0)), np.roll(corners, -1))
