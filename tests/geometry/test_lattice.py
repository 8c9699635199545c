"""Lattices over sheets: positions between their points, turns, and validity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from shape_obs.geometry.curve import TrackHints
from shape_obs.geometry.lattice import FittedLattice, assess_lattice, lattice_gauges, sample_lattice, uneven_places
from shape_obs.geometry.topology import Grid


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), quarters=st.integers(0, 3), dimension=st.integers(2, 3))
def test_a_turn_moves_the_corners_and_nothing_else(seed, quarters, dimension):
    rng = np.random.default_rng(seed)
    patch = FittedLattice.over(rng.normal(size=(63, dimension)), rng.random(63) < 0.3, 7)
    patch = replace(patch, hints=TrackHints(reference=patch.points))
    turned = patch.turned(quarters)
    assert turned.hints.reference is not None
    assert turned.hints.reference.flags.c_contiguous
    np.testing.assert_allclose(turned.hints.reference, turned.points)
    np.testing.assert_allclose(turned.corners, np.roll(patch.corners, -quarters, axis=0))
    np.testing.assert_allclose(turned.lattice, np.rot90(patch.lattice, quarters))
    back = turned.turned((4 - quarters) % 4)
    np.testing.assert_allclose(back.points, patch.points)
    np.testing.assert_array_equal(back.interpolated, patch.interpolated)
    np.testing.assert_allclose(turned.size, patch.size)


def test_an_even_lattice_is_a_sheet():
    lattice = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), axis=-1)
    patch = FittedLattice.over(lattice.reshape(-1, 2), np.arange(12) == 5, 3)
    index = np.arange(3.0), np.arange(4.0)
    np.testing.assert_allclose(sample_lattice(patch.lattice, *index, 2, 2, True), [
        [0.75, 0.5], [2.25, 0.5], [0.75, 1.5], [2.25, 1.5]])  # fmt: skip
    assert patch.size == 5
    np.testing.assert_allclose(assess_lattice(patch.lattice), [90, 0, 0, 0])


def test_folds_are_seen():
    lattice = np.stack(np.meshgrid([0.0, 1, 2, 1.5, 1, 2, 3], np.arange(3.0)), axis=-1)
    assert assess_lattice(lattice)[1] == pytest.approx(0.4)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), rows=st.integers(2, 9), cols=st.integers(2, 9), centers=st.booleans())
def test_samples_are_bilinear_between_equal_mean_gaps(seed, rows, cols, centers):
    rng = np.random.default_rng(seed)
    lattice = np.stack(np.meshgrid(np.arange(6.0), np.arange(5.0)), axis=-1) + rng.uniform(-0.3, 0.3, (5, 6, 2))
    down, right = lattice_gauges(lattice)
    steps = (np.linalg.norm(np.diff(lattice, axis=axis), axis=2).mean(axis=1 - axis) for axis in (0, 1))
    for gauge, gaps in zip((down, right), steps, strict=True):
        np.testing.assert_allclose(gauge, np.concatenate([[0], np.cumsum(gaps)]))
    at = []
    for gauge, count in ((down, rows), (right, cols)):
        share = (np.arange(count) + 0.5) / count if centers else np.linspace(0, 1, count)
        at.append(np.interp(share * gauge[-1], gauge, np.arange(len(gauge))))
    expected = RegularGridInterpolator((np.arange(5), np.arange(6)), lattice)(
        np.stack(np.meshgrid(*at, indexing="ij"), -1)
    )
    np.testing.assert_allclose(sample_lattice(lattice, down, right, rows, cols, centers), expected.reshape(-1, 2))


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
