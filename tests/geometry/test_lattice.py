"""What surfaces are made of: corners of outlines, Coons patches, and lattices that can be sampled and judged."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shape_obs.bench.synthetic.sheets import rotation
from shape_obs.compiled import NUMPY
from shape_obs.compiled.numpy_plane import plane, points_of
from shape_obs.compiled.numpy_sheet import coons
from shape_obs.geometry.form import Patch
from shape_obs.initialization.corners import Rim


class TestPatches:
    @settings(max_examples=20)
    @given(seed=st.integers(0, 2**32 - 1), quarters=st.integers(0, 3))
    def test_a_coons_patch_runs_through_its_sides(self, seed, quarters):
        rng = np.random.default_rng(seed)
        corners = rng.normal(size=(4, 2))
        t = np.linspace(0, 1, 9)[:, None]
        bulge = np.sin(np.pi * t)
        sides = np.stack(
            [(1 - t) * corners[k] + t * corners[(k + 1) % 4] + bulge * rng.normal(size=2) * 0.3 for k in range(4)]
        )
        lattice = points_of(coons(plane(np.stack([sides[0], sides[2, ::-1], sides[3, ::-1], sides[1]])), 9).ravel())
        patch = Patch(lattice, np.zeros(81, bool), 9)
        for found, side in zip(patch.sides, sides, strict=True):
            np.testing.assert_allclose(found, side, atol=1e-12)
        turned = patch.turned(quarters)
        np.testing.assert_allclose(turned.corners, np.roll(patch.corners, -quarters, axis=0))
        np.testing.assert_allclose(turned.turned(4 - quarters).points, patch.points)
        np.testing.assert_allclose(turned.size, patch.size)

    def test_places_between_the_points(self):
        lattice = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), axis=-1)
        patch = Patch(lattice.reshape(-1, 2), np.arange(12) == 5, 3)
        np.testing.assert_allclose(patch.at(np.array([0.5, 2]), np.array([0, 1.25, 3])), [
            [0, 0.5], [1.25, 0.5], [3, 0.5], [0, 2], [1.25, 2], [3, 2]])  # fmt: skip
        assert patch.bridged_at(np.array([1.0, 2.0]), np.array([1.0, 2.0])).tolist() == [True, False, False, False]
        assert patch.size == 5
        np.testing.assert_allclose(NUMPY.assessed(patch.lattice), [90, 0, 0, 0])

    def test_folds_are_seen(self):
        lattice = np.stack(np.meshgrid([0.0, 1, 2, 1.5, 1, 2, 3], np.arange(3.0)), axis=-1)
        assert NUMPY.assessed(lattice)[1] == pytest.approx(0.4)

    @settings(max_examples=20)
    @given(shift=st.integers(0, 1000), degrees=st.floats(0, 360))
    def test_corners_do_not_depend_on_where_the_outline_begins(self, shift, degrees):
        square = np.array([[0.0, 0], [90, 0], [90, 60], [0, 60]]) @ rotation(degrees).T
        t = np.linspace(0, 1, 60, endpoint=False)[:, None]
        outline = np.concatenate([(1 - t) * square[k] + t * square[(k + 1) % 4] for k in range(4)])
        outline = np.roll(outline, shift, axis=0)
        rim = Rim.along(outline, outline)
        corners = rim.corners()
        assert corners is not None
        points, kink = rim.laid(corners)
        found = points.reshape(25, 25, 2)[[0, 0, -1, -1], [0, -1, -1, 0]]
        away = np.linalg.norm(found[:, None] - square, axis=2)
        assert away.min(axis=0).max() < 1.5
        assert kink < 0.05
        np.testing.assert_array_equal(rim.corners_near(np.roll(found, -1, axis=0)), np.roll(corners, -1))
