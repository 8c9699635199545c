"""Polylines against SciPy's splines, ``np.interp`` and brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline

from shape_obs.geometry.polyline import (
    MAX_SHIFT,
    MAX_SHIFT_AROUND,
    arc_length,
    catmull_rom,
    equal_chords,
    interpolate,
    resample,
)

SEEDS = st.integers(0, 2**32 - 1)


def summed(curve):
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])


@given(SEEDS, st.integers(1, 30), st.integers(2, 3))
def test_arc_length_is_the_sum_of_chords(seed, count, dimension):
    curve = np.random.default_rng(seed).uniform(0, 100, (count, dimension))
    np.testing.assert_allclose(arc_length(curve), summed(curve), atol=1e-9)


@given(SEEDS, st.integers(2, 40), st.integers(2, 3), st.booleans())
def test_interpolation_is_that_of_numpy(seed, count, dimension, in_order):
    rng = np.random.default_rng(seed)
    curve = rng.uniform(0, 100, (count, dimension))
    arc = summed(curve)
    at = rng.uniform(-5, arc[-1] + 5, 50)
    at = np.concatenate([np.sort(at) if in_order else at, arc])
    expected = np.stack([np.interp(at, arc, curve[:, d]) for d in range(dimension)], axis=1)
    np.testing.assert_allclose(interpolate(curve, arc, at), expected, atol=1e-9)


def test_interpolation_between_equal_points():
    curve = np.array([[0.0, 0], [1, 0], [1, 0], [2, 0]])
    np.testing.assert_allclose(interpolate(curve, arc_length(curve), np.array([0.5, 1, 1.5]))[:, 0], [0.5, 1, 1.5])


@given(SEEDS, st.booleans(), st.integers(2, 3), st.integers(3, 12))
def test_a_smooth_curve_is_scipy_s_hermite_spline(seed, closed, dimension, count):
    nodes = np.random.default_rng(seed).uniform(0, 100, (count, dimension))
    line = np.concatenate([nodes[-1:], nodes, nodes[:2]]) if closed else nodes
    at = summed(line)
    slope = np.diff(line, axis=0) / np.diff(at)[:, None]
    gap = np.diff(at)[:, None]
    tangent = np.zeros_like(line)
    tangent[1:-1] = (slope[:-1] * gap[1:] + slope[1:] * gap[:-1]) / (gap[1:] + gap[:-1])
    tangent[0], tangent[-1] = 2 * slope[0] - tangent[1], 2 * slope[-1] - tangent[-2]
    knots = at[1 : count + 2] if closed else at
    share = np.linspace(0, 1, 4, endpoint=False)
    places = (knots[:-1, None] + np.diff(knots)[:, None] * share).ravel()
    expected = CubicHermiteSpline(at, line, tangent)(places if closed else np.append(places, knots[-1]))
    np.testing.assert_allclose(catmull_rom(nodes, 4, closed), expected, atol=1e-8)


@given(SEEDS, st.integers(3, 40), st.booleans())
def test_equidistant_points_have_equal_chords(seed, count, centers):
    rng = np.random.default_rng(seed)
    curve = catmull_rom(np.cumsum(rng.uniform(10, 30, (9, 2)), axis=0), 8, False)
    arc = arc_length(curve)
    margin = arc[-1] / (2 * count) if centers else 0.0
    points, at = equal_chords(curve, arc, curve, arc, count, margin, MAX_SHIFT)
    np.testing.assert_allclose(points, interpolate(curve, arc, at))
    chord = np.linalg.norm(np.diff(interpolate(curve, arc, at), axis=0), axis=1)
    assert np.ptp(chord) < 0.01 * chord.mean()
    np.testing.assert_allclose([at[0], arc[-1] - at[-1]], margin, atol=0.35 * arc[-1] / count + 1e-9)
    ring = np.concatenate([curve, curve[:1]])
    arc = arc_length(ring)
    around = equal_chords(ring, arc, ring, arc, count + 1, 0.0, MAX_SHIFT_AROUND)[1]
    assert around[0] == 0
    assert (np.diff(around) > 0).all()


@pytest.mark.parametrize("view", [lambda c: c[::-1], np.asfortranarray, lambda c: c.astype(np.float32)])
def test_any_layout_is_resampled(view):
    curve = np.array([[0.0, 0], [3, 0], [3, 4]])
    found = resample(view(curve), 8)
    np.testing.assert_allclose(np.linalg.norm(np.diff(found, axis=0), axis=1), 1.0, atol=0.3)
