"""The best rotation from a covariance, against SciPy and the singular value decomposition."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from shape_obs.geometry.rotation import best_rotation, covariance_of


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
