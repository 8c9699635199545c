"""Polylines, outlines and rotations against SciPy, NumPy and brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from shape_obs.geometry.outline import clockwise, material_outline, pairs
from shape_obs.geometry.polyline import (
    MAX_SHIFT,
    MAX_SHIFT_AROUND,
    arc_length,
    catmull_rom,
    equal_chords,
    interpolate,
    nearest_on,
    resample,
)
from shape_obs.geometry.rotation import best_rotation, covariance_of

SEEDS = st.integers(0, 2**32 - 1)


def summed(curve):
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])


@given(SEEDS, st.integers(2, 40), st.integers(2, 3), st.booleans())
def test_interpolation_is_that_of_numpy(seed, count, dimension, in_order):
    rng = np.random.default_rng(seed)
    curve = rng.uniform(0, 100, (count, dimension))
    arc = summed(curve)
    at = rng.uniform(-5, arc[-1] + 5, 50)
    at = np.concatenate([np.sort(at) if in_order else at, arc])
    expected = np.stack([np.interp(at, arc, curve[:, d]) for d in range(dimension)], axis=1)
    np.testing.assert_allclose(interpolate(curve, arc, at), expected, atol=1e-9)


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


@given(st.integers(0, 2**32 - 1))
def test_nearest_places_by_brute_force(seed):
    rng = np.random.default_rng(seed)
    curve, points = rng.uniform(0, 10, (6, 2)), rng.uniform(0, 10, (5, 2))
    arc, distance = nearest_on(curve, points)
    fine = resample(curve, 20001)
    away = np.linalg.norm(points[:, None] - fine, axis=2)
    np.testing.assert_allclose(distance, away.min(axis=1), atol=1e-2)
    assert np.isnan(nearest_on(curve, np.full((1, 2), np.nan))[1]).all()
    on = interpolate(curve, arc_length(curve), arc)
    np.testing.assert_allclose(np.linalg.norm(on - points, axis=1), distance, atol=1e-9)


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


@pytest.mark.parametrize("count", [1, 2, 7, 8])
def test_pairs_are_means_of_two(count):
    points = np.random.default_rng(0).uniform(0, 9, (count, 2))
    expected = [points[k : k + 2].mean(axis=0) for k in range(0, count, 2)]
    np.testing.assert_allclose(pairs(points), expected)


def is_rotation(matrix: np.ndarray) -> bool:
    return bool(np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-9) and np.isclose(np.linalg.det(matrix), 1))


def best_trace(matrix: np.ndarray) -> float:
    left, values, right = np.linalg.svd(matrix)
    return float(values[0] + values[1] + np.sign(np.linalg.det(left) * np.linalg.det(right)) * values[2])


@given(st.integers(0, 10_000), st.floats(-3, 3), st.sampled_from(["any", "flat", "line", "nearly flat"]))
def test_no_rotation_has_a_larger_trace(seed, magnitude, kind):
    matrix = np.random.default_rng(seed).normal(size=(3, 3)) * 10**magnitude
    if kind == "flat":
        matrix[:, 2] = matrix[:, 0] - 2 * matrix[:, 1]
    elif kind == "line":
        matrix = np.outer(matrix[0], matrix[1])
    elif kind == "nearly flat":
        matrix = matrix @ np.diag([1, 1, 1e-9])
    rotation = best_rotation(np.ascontiguousarray(matrix))
    assert is_rotation(rotation)
    np.testing.assert_allclose(np.trace(rotation.T @ matrix), best_trace(matrix), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("matrix", [np.eye(3), np.zeros((3, 3)), np.diag([1.0, 1.0, -1.0]), -np.eye(3)])
def test_equal_singular_values_give_a_rotation_too(matrix):
    rotation = best_rotation(matrix)
    assert is_rotation(rotation)
    np.testing.assert_allclose(np.trace(rotation.T @ matrix), best_trace(matrix), atol=1e-12)


def test_points_are_laid_as_scipy_lays_them():
    rng = np.random.default_rng(1)
    before = rng.normal(size=(40, 3))
    turn = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    after = before @ turn + rng.normal(scale=0.05, size=(40, 3)) + [1, 2, 3]
    covariance, middle, centre = covariance_of(before, after)
    np.testing.assert_allclose(middle, before.mean(axis=0), atol=1e-12)
    expected = Rotation.align_vectors(after - centre, before - middle)[0]
    np.testing.assert_allclose(
        (before - middle) @ best_rotation(covariance), expected.apply(before - middle), atol=1e-9
    )
