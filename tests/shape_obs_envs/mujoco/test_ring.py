"""The ring environment against its own ground truth."""

from __future__ import annotations

from typing import Any, cast

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("mujoco")

import shape_obs_envs  # noqa: F401
from shape_obs_envs.mujoco.ring import RingEnv


def make(**options: Any) -> RingEnv:
    return cast(RingEnv, gym.make("ShapeObs/Ring-v0", **{"camera": [84, 84], "renderer": "rays", **options}).unwrapped)


def bent(env: RingEnv, seeds: int = 4):
    """Bend the ring into a few shapes, and yield the seed of each."""
    rng = np.random.default_rng(0)
    for seed in range(seeds):
        env.reset(seed=seed)
        action = rng.uniform(-1, 1, 6)
        for _ in range(12):
            env._move(action)
        yield seed


def test_the_band_keeps_its_length_and_its_sides_never_touch():
    env = make(render_observation=False)
    rng, spec = np.random.default_rng(0), env._loop.spec
    action, outlines, axes = np.zeros(6, np.float32), [], []
    for seed in range(8):
        env.reset(seed=seed)
        for step in range(50):
            if step % 8 == 0 or seed % 2:  # held, or white noise
                action = rng.uniform(-1, 1, 6).astype(np.float32)
            env.step(action)
            axes.append(env._loop.axis())
            if step % 10 == 9:
                outlines.append(env.truth(200))
    links = np.linalg.norm(np.roll(axes, -1, axis=1) - axes, axis=2)
    assert links.sum(axis=1).max() < 1.001 * spec.length
    # Where it is closed: 0.8 % of a link with MuJoCo 4.0, 2.7 % with 3.3, less than a thousandth of the band.
    assert links.max() < 1.04 * spec.link_length
    around = np.linalg.norm(np.roll(outlines, -1, axis=1) - outlines, axis=2).sum(axis=1)
    # once around a closed band: its middle, and pi times its width more
    assert np.allclose(around, spec.length + np.pi * spec.width, rtol=0.01)
    count = len(axes[0])
    apart = np.abs(np.arange(count)[:, None] - np.arange(count))
    far = np.minimum(apart, count - apart) > 4
    closest = min(np.linalg.norm(axis[:, None] - axis, axis=2)[far].min() for axis in axes)
    assert closest > 2 * spec.width


def test_truth_is_equidistant_and_clockwise_from_gripper0():
    env = make(render_observation=False)
    for _ in bent(env):
        points = env.truth(64)
        gaps = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
        assert gaps.std() / gaps.mean() < 0.01
        assert np.allclose(points[0], env.anchors["gripper0"], atol=1e-9)
        assert np.linalg.norm(points[32] - env.anchors["gripper1"]) < 0.06
        assert np.allclose(env.truth(32), points[::2], atol=1e-9)
        assert np.allclose(points[:, 2], 0.004)
        pixels = env.truth(64, frame="pixels")
        after = np.roll(pixels, -1, axis=0)
        # v is down: a positive area is clockwise as seen
        assert (pixels[:, 0] * after[:, 1] - after[:, 0] * pixels[:, 1]).sum() > 0
