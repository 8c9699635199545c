"""The depth around a point against brute force: how much of it must be known, and planes seen from one side."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shape_obs.frame import FARTHEST
from shape_obs.point_cloud.local_depth import median_depth


@settings(max_examples=30)
@given(
    st.integers(0, 2**32 - 1), st.sampled_from([np.uint16, np.float32]), st.sampled_from([1, 2, 4, 6]), st.booleans()
)
def test_medians_of_at_least_a_quarter_of_the_pixels(seed, kind, reach, sloped):
    rng = np.random.default_rng(seed)
    depth = rng.integers(0, 3, (40, 50)).astype(kind) * rng.uniform(0.5, 700, (40, 50)).astype(kind)
    mask = (rng.random((30, 40)) < 0.5).astype(np.uint8)
    points = rng.uniform(-3, 45, (12, 2))
    found, _ = median_depth(depth, 1e-3, mask, 4, 6, points, reach, 0.25, sloped)
    thinned = sloped and reach >= 4  # every second pixel, as on a chessboard
    for point, z in zip(points, found, strict=True):
        column, row = np.rint(point).astype(int) - (4, 6)
        across, down = np.meshgrid(np.arange(40) - column, np.arange(30) - row)
        inside = (np.maximum(abs(across), abs(down)) <= reach) & (mask > 0)
        if thinned:
            inside &= (across + down + reach) % 2 == 0
        near = depth[6:36, 4:44][inside] * 1e-3
        near = near[(near > 0) & (near < FARTHEST)]
        assert np.isfinite(z) == (len(near) >= max(0.25 * inside.sum(), 1))
        if np.isfinite(z) and (not sloped or len(near) < 6):  # too few for a plane
            assert z == pytest.approx(np.median(near), rel=1e-6)


@pytest.mark.parametrize("reach", [2, 6])
def test_a_tilted_sheet_is_not_shallower_at_its_border(reach):
    """The mask ends at column 60, depth of what is behind mixes into its last column, and a tenth is lost."""
    rng = np.random.default_rng(0)
    row, column = np.mgrid[:100, :100]
    plane = 1 / (1.4 + 0.004 * (column - 50) - 0.002 * (row - 50))
    depth = (plane + rng.normal(0, 3e-4, plane.shape)).astype(np.float32)
    depth[::3, 60] = 1.2
    depth[rng.random(depth.shape) < 0.1] = 0
    mask = (column <= 60).astype(np.uint8)
    points = np.stack([rng.uniform(58, 60, 40), rng.uniform(10, 90, 40)], axis=1)
    true = 1 / (1.4 + 0.004 * (points[:, 0] - 50) - 0.002 * (points[:, 1] - 50))
    found, _ = median_depth(depth, 1.0, mask, 0, 0, points, reach, 0.25, True)
    assert np.abs(found - true).mean() < 6e-4
    assert np.abs(found - true).max() < 3e-3


def test_a_steep_sheet_of_few_pixels_has_a_slope():
    """At 60° the next column of pixels is 10 mm farther, and is no outlier when most pixels lie in one column."""
    rng = np.random.default_rng(0)
    column = np.mgrid[:100, :100][1]
    depth = (0.6 / (1 - 0.017 * (column - 60)) + rng.normal(0, 5e-4, column.shape)).astype(np.float32)
    depth[rng.random(depth.shape) < np.where(column == 60, 0.5, 0.1)] = 0
    mask = ((column >= 59) & (column <= 60)).astype(np.uint8)
    points = np.stack([rng.uniform(59.6, 60.4, 200), rng.uniform(10, 90, 200)], axis=1)
    found, _ = median_depth(depth, 1.0, mask, 0, 0, points, 2, 0.25, True)
    assert np.abs(found - 0.6 / (1 - 0.017 * (points[:, 0] - 60))).mean() < 2e-3
