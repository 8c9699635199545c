"""Coons patches: the analytic formula inside, the sides of the outline around it."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from shape_obs.geometry.coons import FINE
from shape_obs.geometry.lattice import FittedLattice
from shape_obs.initialization.corners import Rim
from tests.benchmarks.scenes.sheets import rotation


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
def test_the_inside_is_blended_between_the_sides(seed):
    """Compare with P(u, v) = (1-v) T(u) + v B(u) + (1-u) L(v) + u R(v) - the bilinear patch of the corners."""
    lattice = patch(seed)[0].lattice
    at = np.linspace(0, 1, FINE)
    v, u = (side[..., None] for side in np.meshgrid(at, at, indexing="ij"))
    ruled = (1 - v) * lattice[:1] + v * lattice[-1:] + (1 - u) * lattice[:, :1] + u * lattice[:, -1:]
    upper, lower = (1 - u) * lattice[0, 0] + u * lattice[0, -1], (1 - u) * lattice[-1, 0] + u * lattice[-1, -1]
    np.testing.assert_allclose(lattice, ruled - ((1 - v) * upper + v * lower), atol=1e-9)


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
