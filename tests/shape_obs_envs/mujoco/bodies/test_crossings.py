"""Crossings of polylines, heights of ropes over each other, and the joints that lay a rope along a line in space."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("mujoco")

from shape_obs_envs.mujoco.bodies.crossings import intersections, self_intersections, stacked
from shape_obs_envs.mujoco.bodies.ropes import hinge_angles

RADIUS = 0.007


def line(angle: float, at: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Return a straight axis of 0.48 m through a point."""
    return np.linspace(-0.24, 0.24, 25)[:, None] * (np.cos(angle), np.sin(angle)) + at


def test_two_lines_intersect_where_they_should():
    assert intersections(line(0.0, (0.005, 0)), line(np.pi / 2, (0, 0.03))) == pytest.approx(np.array([[11.75, 10.5]]))
    assert len(intersections(line(0.3), line(0.3, (0, 0.01)))) == 0
    loop = np.array([[0, 0], [2, 0], [2, 2], [1, 2], [1, -1]], float)
    assert self_intersections(loop) == pytest.approx(np.array([[0.5, 3 + 2 / 3]]))
    assert len(self_intersections(line(1.0))) == 0


@pytest.mark.parametrize("seed", range(6))
def test_a_rope_is_laid_over_another_one_and_down_again(seed):
    lines = np.stack([line(0.5), line(-0.5, (0.007, 0))])
    heights = stacked(lines, RADIUS, np.random.default_rng(seed))
    assert heights is not None
    upper = int(heights[1].max() > heights[0].max())
    assert heights[1 - upper] == pytest.approx(np.full(25, RADIUS))
    assert heights[upper, 12] == pytest.approx(3 * RADIUS, abs=1e-3)
    assert np.abs(np.diff(heights[upper])).max() < 0.36 * 0.02
    assert heights[upper, [0, 1, -2, -1]] == pytest.approx(RADIUS)


def test_three_ropes_pass_over_each_other_in_a_circle_too():
    lines = np.stack([line(0.0, (0, -0.04)), line(2.1, (0.05, 0.02)), line(-2.1, (-0.05, 0.02))])
    seen = set()
    for seed in range(40):
        heights = stacked(lines, RADIUS, np.random.default_rng(seed))
        if heights is not None:
            seen.add(tuple(int(height.max() > 2 * RADIUS) for height in heights))
    assert (1, 1, 1) in seen


@pytest.mark.parametrize(
    "other",
    [line(0.2), line(0.0, (0, 0.015)), line(np.pi / 2, (0.22, 0))],
    ids=["at a small angle", "side by side", "next to an end"],
)
def test_ropes_that_cannot_be_laid_are_refused(other):
    assert stacked(np.stack([line(0.0), other]), RADIUS, np.random.default_rng(0)) is None


def test_joints_follow_a_line_in_space():
    rng = np.random.default_rng(0)
    ways = np.cumsum(rng.normal(0, 0.2, (24, 3)), axis=0) + (3, 0, 0)
    ways[0, 2] = 0
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    yaw = np.arctan2(ways[0, 1], ways[0, 0])
    frame = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    for way, (pitch, turn) in zip(ways[1:], hinge_angles(ways), strict=True):
        about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
        about_z = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
        frame = frame @ about_y @ about_z
        assert frame[:, 0] == pytest.approx(way, abs=1e-9)
