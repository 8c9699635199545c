"""Workspaces: what is allowed, and what poses are brought back to."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("mujoco")

from shape_obs_envs.mujoco.workspace import HangingWorkspace


def test_clipped_poses_are_allowed_and_allowed_ones_are_left():
    workspace = HangingWorkspace(lambda: 0.4, (-0.2, -0.12, 0.29), (-0.05, 0.12, 0.48))
    rng = np.random.default_rng(0)
    previous = np.array([[-0.1, 0.0, 0.4], [0.1, 0.0, 0.4]])
    moved = 0
    for _ in range(500):
        poses = previous + rng.normal(0, 0.1, (2, 3))
        clipped = workspace.clip(poses, previous)
        assert workspace.allows(clipped)
        assert np.linalg.norm(clipped[1] - clipped[0]) <= 0.4 + 1e-6
        if workspace.allows(poses):
            assert np.array_equal(clipped, poses)
        else:
            moved += not np.array_equal(clipped, previous)
        previous = clipped
    assert moved > 100
