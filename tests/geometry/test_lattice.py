"""Lattices over sheets: Coons patches, samples, turns, corners, lost values and uneven gaps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial import KDTree

from shape_obs.geometry.coons import FINE
from shape_obs.geometry.lattice import (
    FittedLattice,
    assess_lattice,
    lattice_gauges,
    sample_lattice,
    uneven_places,
)
from shape_obs.geometry.topology import Grid
from shape_obs.initialization.corners import Rim
from tests.benchmarks.scenes.sheets import rotation


def test_an_even_lattice_is_a_sheet():
    lattice = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), axis=-1)
    patch = FittedLattice.over(lattice.reshape(-1, 2), np.arange(12) == 5, 3)
    index = np.arange(3.0), np.arange(4.0)
    np.testing.assert_allclose(sample_lattice(patch.lattice, *index, 2, 2, True), [
        [0.75, 0.5], [2.25, 0.5], [0.75, 1.5], [2.25, 1.5]])  # fmt: skip
    assert patch.size == 5
    np.testing.assert_allclose(assess_lattice(patch.lattice), [90, 0, 0, 0])


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


def square_outline(degrees: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of a rectangle of 90 x 60, clockwise, and ``(240, 2)`` points around it."""
    square = np.array([[0.0, 0], [90, 0], [90, 60], [0, 60]]) @ rotation(degrees).T
    t = np.linspace(0, 1, 60, endpoint=False)[:, None]
    return square, np.concatenate([(1 - t) * square[k] + t * square[(k + 1) % 4] for k in range(4)])


def sides_of(patch: FittedLattice) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the four border lines of a lattice, clockwise: each ends where the next begins."""
    lattice = patch.lattice
    return lattice[0], lattice[:, -1], lattice[-1, ::-1], lattice[::-1, 0]


class TestPatches:
    @settings(max_examples=20)
    @given(seed=st.integers(0, 2**32 - 1), quarters=st.integers(0, 3))
    def test_a_patch_blends_its_four_sides(self, seed, quarters):
        """Compare with the formula of Coons in NumPy, from the sides of the patch itself."""
        _, outline = square_outline(np.random.default_rng(seed).uniform(0, 360))
        middle = outline.mean(axis=0)
        outline = outline + 0.05 * (outline - middle) * np.sin(np.arange(240) * 2 * np.pi / 60)[:, None]
        rim = Rim.along(outline, outline)
        corners = rim.corners()
        assert corners is not None
        patch = FittedLattice.over(rim.patch(corners)[0], np.zeros(625, bool), 25)
        top, right, bottom, left = sides_of(patch)
        bottom, left = bottom[::-1], left[::-1]
        v, u = (at[..., None] for at in np.meshgrid(*[np.linspace(0, 1, 25)] * 2, indexing="ij"))
        ruled = (1 - u) * left[:, None] + u * right[:, None] + (1 - v) * top + v * bottom
        bilinear = (1 - v) * ((1 - u) * top[0] + u * top[-1]) + v * ((1 - u) * bottom[0] + u * bottom[-1])
        np.testing.assert_allclose(patch.lattice, ruled - bilinear, atol=1e-9)
        turned = patch.turned(quarters)
        np.testing.assert_allclose(turned.corners, np.roll(patch.corners, -quarters, axis=0))
        np.testing.assert_allclose(turned.turned(4 - quarters).points, patch.points)
        np.testing.assert_allclose(turned.size, patch.size)

    def test_folds_are_seen(self):
        lattice = np.stack(np.meshgrid([0.0, 1, 2, 1.5, 1, 2, 3], np.arange(3.0)), axis=-1)
        assert assess_lattice(lattice)[1] == pytest.approx(0.4)

    @settings(max_examples=20)
    @given(seed=st.integers(0, 2**32 - 1), centers=st.booleans(), dimension=st.integers(2, 3))
    def test_lattices_are_sampled_as_scipy_interpolates(self, seed, centers, dimension):
        lattice = np.random.default_rng(seed).uniform(0, 9, (5, 7, dimension))
        down, right = lattice_gauges(lattice)
        gaps = (np.linalg.norm(np.diff(lattice, axis=axis), axis=2).mean(axis=1 - axis) for axis in (0, 1))
        for gauge, gap in zip((down, right), gaps, strict=True):
            np.testing.assert_allclose(gauge, np.concatenate([[0.0], np.cumsum(gap)]))
        share = [(np.arange(n) + 0.5) / n if centers else np.linspace(0, 1, n) for n in (3, 4)]
        at = np.stack(np.meshgrid(share[0] * down[-1], share[1] * right[-1], indexing="ij"), axis=-1)
        expected = RegularGridInterpolator((down, right), lattice)(np.minimum(at, (down[-1], right[-1])))
        found = sample_lattice(lattice, down, right, 3, 4, centers)
        np.testing.assert_allclose(found, expected.reshape(12, -1), atol=1e-9)


def bulged(seed: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return the corners of a quadrilateral of some 100 pixels, ``(4, 2)``, and its four bent sides, clockwise."""
    rng = np.random.default_rng(seed)
    corners = np.array([[0.0, 0], [120, 0], [120, 90], [0, 90]]) + rng.uniform(-12, 12, (4, 2))
    corners = corners @ rotation(rng.uniform(0, 360)).T
    t = np.linspace(0, 1, 400, endpoint=False)[:, None]
    sides = []
    for k in range(4):
        bulge = np.sin(np.pi * t) * rng.uniform(-6, 6, 2)
        sides.append((1 - t) * corners[k] + t * corners[(k + 1) % 4] + bulge)
    return corners, sides


def patch(seed: int) -> tuple[FittedLattice, np.ndarray, list[np.ndarray], float]:
    corners, sides = bulged(seed)
    outline = np.concatenate(sides)
    rim = Rim.along(outline, outline)
    points, kink = rim.patch(np.asarray(KDTree(rim.flat).query(corners)[1], dtype=np.int64))
    return FittedLattice.over(points, np.zeros(len(points), bool), FINE), corners, sides, kink


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1))
def test_it_runs_through_its_corners_and_its_sides_at_even_steps(seed):
    found, corners, sides, kink = patch(seed)
    np.testing.assert_allclose(found.corners, corners, atol=0.5)
    lattice = found.lattice
    lines = lattice[0], lattice[:, -1], lattice[-1, ::-1], lattice[::-1, 0]
    for line, side, end in zip(lines, sides, np.roll(corners, -1, axis=0), strict=True):
        away = KDTree(np.concatenate([side, end[None]])).query(line)[0]
        assert away.max() < 0.5
        steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
        assert np.ptp(steps) < 0.05 * steps.mean()
    assert kink < 0.35, "bent sides turn by little over 16 points of the rim"
