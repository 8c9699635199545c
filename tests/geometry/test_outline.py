"""Outlines of masks against circles and SciPy's smoothing."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from shape_obs.geometry.outline import clockwise, material_outline


def traced(radius: float = 40.0) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, 500, endpoint=False)
    points = np.rint(100 + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    return points[np.any(points != np.roll(points, 1, axis=0), axis=1)]


@pytest.mark.parametrize("hole", [False, True])
@pytest.mark.parametrize("step", [1, -1])
def test_the_material_ends_half_a_pixel_outside_of_the_border_pixels(hole, step):
    border = traced()[::step].copy()
    points, smooth = material_outline(border, hole)
    assert clockwise(points)
    wide = np.linalg.norm(smooth - 100, axis=1).mean() - np.linalg.norm(border - 100, axis=1).mean()
    assert wide == pytest.approx(-0.45 if hole else 0.45, abs=0.1)
    expected = gaussian_filter1d(points, 2.0, axis=0, mode="wrap", truncate=2.0)
    np.testing.assert_allclose(smooth, expected, atol=1e-9)
