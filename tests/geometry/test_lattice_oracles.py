"""Corners of outlines, Coons patches, and lattices that are sampled and validated."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from shape_obs.geometry.lattice import FittedLattice, assess_lattice, lattice_gauges, sample_lattice
from shape_obs.initialization.corners import Rim
from tests.benchmarks.scenes.sheets import rotation


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


class TestCorners:
    @settings(max_examples=20)
    @given(shift=st.integers(0, 1000), degrees=st.floats(0, 360))
    def test_corners_do_not_depend_on_where_the_outline_begins(self, shift, degrees):
        square, outline = square_outline(degrees)
        outline = np.roll(outline, shift, axis=0)
        rim = Rim.along(outline, outline)
        corners = rim.corners()
        assert corners is not None
        points, kink = rim.patch(corners)
        found = points.reshape(25, 25, 2)[[0, 0, -1, -1], [0, -1, -1, 0]]
        away = np.linalg.norm(found[:, None] - square, axis=2)
        assert away.min(axis=0).max() < 1.5
        assert kink < 0.05
        np.testing.assert_array_equal(rim.corners_near(np.roll(found, -1, axis=0)), np.roll(corners, -1))

    def test_corners_near_places_by_brute_force(self):
        _, outline = square_outline(20.0)
        rim = Rim.along(outline, outline)
        for at in ([0, 100, 200, 300], [0, 300, 200, 100], [5, 5, 200, 300]):
            expected = rim.points[at]
            near = np.argmin(np.linalg.norm(rim.points[rim.candidates][:, None] - expected, axis=2), axis=0)
            found = rim.corners_near(expected)
            places = rim.candidates[near]
            far = np.linalg.norm(rim.points[places] - expected, axis=1) >= 20 * rim.step
            places = np.where(far, at, places)
            gaps = (np.roll(places, -1) - places) % 400
            in_order = (gaps > 1).all() and gaps.sum() == 400
            assert (found is not None) == in_order
            if found is not None:
                np.testing.assert_array_equal(found, places)
