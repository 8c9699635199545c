"""How far samples lie from a curve: mean squares and mean distances by brute force."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs.initialization.folding import unexplained_share
from shape_obs.tracking.validation import outline_miss, sample_spread

ANGLE = np.linspace(0, 2 * np.pi, 200, endpoint=False)
CIRCLE = 50 * np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1)


@pytest.mark.parametrize("off", [0.0, 0.5, 3.0])
def test_points_at_a_distance_from_a_circle(off):
    points = CIRCLE[::2] * (1 + off / 50)
    assert outline_miss(points, CIRCLE) == pytest.approx(off, abs=1e-9)


@pytest.mark.parametrize("off", [0.0, 2.0])
def test_the_spread_about_a_line_is_the_weighted_mean_square(off):
    curve = np.stack([np.linspace(0, 90, 91), np.zeros(91)], axis=1)
    rng = np.random.default_rng(0)
    points = np.stack([rng.uniform(0, 90, 100), rng.normal(off, 1, 100)], axis=1)
    weight = rng.uniform(1, 3, 100)
    expected = np.average(points[:, 1] ** 2, weights=weight)
    assert sample_spread(points, weight, curve) == pytest.approx(expected)


def test_the_share_of_an_outline_far_from_a_curve():
    curve = CIRCLE[:100].copy()  # half of it
    share = unexplained_share(CIRCLE, curve, 1.0)
    away = np.linalg.norm(CIRCLE[::2, None] - curve, axis=2).min(axis=1)
    reach = 1.0 + np.linalg.norm(CIRCLE[1] - CIRCLE[0]) / 2
    assert share == pytest.approx(np.mean(away > reach))
