"""The median depth around a point against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shape_obs.frame import FARTHEST
from shape_obs.point_cloud.lifting import median_depth


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.sampled_from([np.uint16, np.float32]), st.sampled_from([1, 4]))
def test_medians(seed, kind, reach):
    rng = np.random.default_rng(seed)
    depth = rng.integers(0, 3, (40, 50)).astype(kind) * rng.uniform(0.5, 700, (40, 50)).astype(kind)
    mask = (rng.random((30, 40)) < 0.7).astype(np.uint8)
    points = rng.uniform(-3, 45, (12, 2))
    found = median_depth(depth, 1e-3, mask, 4, 6, points, reach, 0.25)
    for point, z in zip(points, found, strict=True):
        column, row = np.rint(point).astype(int) - (4, 6)
        rows, columns = (slice(max(at - reach, 0), max(at + reach + 1, 0)) for at in (row, column))
        inside = mask[rows, columns] > 0
        near = depth[6:36, 4:44][rows, columns][inside] * 1e-3
        near = near[(near > 0) & (near < FARTHEST)]
        enough = len(near) >= max(0.25 * inside.sum(), 1)
        assert z == pytest.approx(np.median(near) if enough else np.nan, rel=1e-6, nan_ok=True)
