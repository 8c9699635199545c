"""The depth around a point against brute force: how much of it must be known, and planes seen from one side."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs.frame import depth_images
from shape_obs.point_cloud.local_depth import median_depth


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
    found, _ = median_depth(depth_images(depth), mask, 0, 0, points, reach, 0.25, True)
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
    found, _ = median_depth(depth_images(depth), mask, 0, 0, points, 2, 0.25, True)
    assert np.abs(found - 0.6 / (1 - 0.017 * (points[:, 0] - 60))).mean() < 2e-3
