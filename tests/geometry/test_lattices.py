"""Rotations and lattices against NumPy and brute force."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from shape_obs.geometry.lattice import uneven_places
from shape_obs.geometry.rotation import best_rotation
from shape_obs.geometry.topology import Grid


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


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), rows=st.integers(3, 8), cols=st.integers(3, 10))
def test_lost_values_inside_a_plane_lie_in_it(seed, rows, cols):
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:rows, :cols]
    values = np.stack([rng.normal() * u + rng.normal() * v + rng.normal(), 0.5 * u], axis=-1).reshape(-1, 2)
    known = (rng.random((rows, cols)) < 0.5) | (u == 0) | (v == 0) | (u == cols - 1) | (v == rows - 1)
    lost = np.where(known.reshape(-1, 1), values, np.nan)
    np.testing.assert_allclose(Grid(rows, cols).interpolate(lost, known.ravel()), values, atol=1e-3)


def test_lost_values_outside_are_like_the_nearest():
    values, known = np.full((12, 1), np.nan, np.float32), np.zeros(12, bool)
    values[5], known[5] = 0.7, True
    filled = Grid(3, 4).interpolate(values, known)
    assert filled.dtype == np.float32
    np.testing.assert_allclose(filled, 0.7)


class TestUnevenGaps:
    def sheet(self, seed: int = 0, noise: float = 0.0) -> np.ndarray:
        down, across = np.meshgrid(np.arange(5.0), np.arange(7.0), indexing="ij")
        flat = np.stack([across * 30, down * 40, np.zeros_like(down)], axis=-1)
        return np.ascontiguousarray(flat + np.random.default_rng(seed).normal(scale=max(noise, 1e-9), size=flat.shape))

    def test_a_corner_that_is_folded_is_marked_with_its_neighbours(self):
        sheet = self.sheet()
        sheet[0, -1, 0] -= 6  # a fifth of a gap
        marked = uneven_places(sheet).reshape(5, 7)
        assert set(zip(*(place.tolist() for place in np.nonzero(marked)), strict=True)) == {
            (0, 4), (0, 5), (0, 6), (1, 5), (1, 6)
        }  # fmt: skip

    def test_equal_gaps_and_gaps_that_all_differ_by_noise_are_not(self):
        assert not uneven_places(self.sheet()).any()
        assert np.mean([uneven_places(self.sheet(seed, 3.0)).mean() for seed in range(20)]) < 0.4
