"""The hanging environment against its own ground truth and the mechanics of a rope under gravity."""

from __future__ import annotations

from typing import Any, cast

import cv2
import gymnasium as gym
import numpy as np
import pytest
from scipy.optimize import least_squares

pytest.importorskip("mujoco")


import shape_obs_envs  # noqa: F401
from shape_obs_envs.mujoco.bodies import MaterialFactors
from shape_obs_envs.mujoco.hanging import HangingEnv
from shape_obs_envs.mujoco.workspace import HangingWorkspace


def make(**options: Any) -> HangingEnv:
    env = gym.make("ShapeObs/Hanging-v0", **{"camera": [84, 84], "renderer": "rays", **options})
    return cast(HangingEnv, env.unwrapped)


def start(env: HangingEnv, seed: int) -> dict[str, Any]:
    """Reset without the search for a goal."""
    return env.reset(seed=seed, options={"goal": env._goal})[0]


def swing(env: HangingEnv, seed: int, steps: int = 50, strong: bool = True) -> list[np.ndarray]:
    """Play held actions, at full strength if asked, and return the points after each step."""
    rng, action, out = np.random.default_rng(seed), np.zeros(env.action_space.shape or ()), []
    for step in range(steps):
        if step % 6 == 0:
            action = rng.uniform(-1, 1, action.shape)
            action = np.sign(action) if strong else action
        env._move(action)
        out.append(env.truth(100))
    return out


def length(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


@pytest.fixture(scope="module")
def env():
    env = make()
    yield env
    env.close()


# ---- the truth


def test_truth_runs_from_gripper_to_gripper_and_is_equidistant(env):
    start(env, 2)
    swing(env, 2, 7)
    fine = env.truth(4001)
    assert length(fine) == pytest.approx(0.5, abs=1e-5)
    assert np.allclose(env.truth(11), fine[::400])
    assert np.allclose(env.truth(10, ends="centers"), fine[200::400])
    assert np.allclose([env.anchors["gripper0"], env.anchors["gripper1"]], fine[[0, -1]])
    observation = env._observe()
    assert np.allclose(observation["achieved_goal"].reshape(20, 3), env.truth(20), atol=1e-6)
    assert np.allclose(observation["gripper"].reshape(2, 3), fine[[0, -1]], atol=1e-6)


# ---- the physics


def test_at_rest_it_hangs_as_a_catenary_between_its_grippers(env):
    """The oracle shoots for the parameter and the lowest point of z = a cosh((x - x0) / a) by itself."""
    for seed in range(4):
        start(env, seed)
        for _ in range(30):
            env._move(np.zeros(6))
        points = env.truth(100) - env.truth(100)[0]
        along = points[-1, :2] / np.linalg.norm(points[-1, :2])
        assert np.abs(points[:, :2] @ [-along[1], along[0]]).max() < 1e-3, "in a plane"
        x, height = points[:, :2] @ along, points[:, 2]

        def line(unknown, x=x):
            a, x0 = np.exp(unknown[0]), unknown[1]
            return a * (np.cosh((x - x0) / a) - np.cosh(x0 / a))

        found = least_squares(lambda unknown, x=x, h=height: line(unknown, x) - h, (np.log(0.1), x[-1] / 2))
        assert np.abs(found.fun).max() < 0.01  # it resists bending a little
        fine = np.linspace(0, x[-1], 2000)
        assert length(np.column_stack([fine, line(found.x, fine)])) == pytest.approx(0.5, abs=0.01)


def test_from_one_gripper_it_hangs_straight_down():
    env = make(grippers=1)
    start(env, 1)
    points = env.truth(10)
    assert np.abs(points[:, :2] - points[0, :2]).max() < 1e-3
    assert points[0, 2] - points[-1, 2] == pytest.approx(0.36, abs=1e-3)
    assert list(env.anchors) == ["gripper0"]


@pytest.mark.parametrize("grippers", [1, 2])
@pytest.mark.parametrize(
    "factors",
    [MaterialFactors(), MaterialFactors(0.75, 0.5, 0.5, 0.6, 0.9), MaterialFactors(1.25, 2.0, 0.5, 1.6, 1.1)],
    ids=["nominal", "limp and thin", "stiff and thick"],
)
def test_it_is_stable_and_keeps_its_length_at_full_strength(grippers, factors):
    env = make(grippers=grippers, render_observation=False)
    env._body.set_material(factors)
    whole = env._strand.nominal.length * factors.length
    for seed in range(2):
        start(env, seed)
        for points in swing(env, seed):
            assert length(points) == pytest.approx(whole, abs=4e-3)  # chords are shorter than the arc
            assert length(points) <= whole + 1e-9
            assert points[:, 2].min() > 0.015, "it does not meet the table"
        assert env.observation_space.contains(env._observe())
        assert np.isfinite(env.get_state()).all()
        assert not any(warning.number for warning in env._body.data.warning)


def test_actions_move_each_gripper_by_five_centimetres_at_most_or_less_if_asked(env):
    start(env, 0)
    middle = np.array([[-0.12, 0.0, 0.4], [0.12, 0.0, 0.4]])
    env._strand.place(middle)
    env._target = middle.copy()
    env.step(np.array([0.1, -0.2, 0.3, 0, 0, 0], np.float32))
    assert np.allclose(env._target - middle, [[0.005, -0.01, 0.015], [0, 0, 0]], atol=1e-8)
    env.step(np.array([0, 0, 0, 0, 1, -1], np.float32))
    assert np.allclose(env._target[1] - middle[1], [0, 0.05, -0.05], atol=1e-8)
    for _ in range(10):
        env.step(np.zeros(6, np.float32))
    assert np.abs(env._strand.gripper_poses() - env._target).max() < 2e-3
    assert env.action_spec.names[:3] == ("gripper0/x", "gripper0/y", "gripper0/z")
    assert set(env.action_spec.units) == {"m"}
    small = make(step=0.01, render_observation=False)
    start(small, 0)
    before = small._target.copy()
    small.step(np.array([0, 0, -0.5 if before[0, 2] > 0.4 else 0.5, 0, 0, 0], np.float32))
    assert abs(small._target[0, 2] - before[0, 2]) == pytest.approx(0.005, abs=1e-4)
    assert small.action_spec.scale == pytest.approx((0.01,) * 6)


# ---- the workspace


def test_the_length_of_the_rope_limits_the_distance_of_the_grippers():
    env = make(randomize={"others": False, "material": True}, render_observation=False)
    lengths = []
    for seed in range(6):
        start(env, seed)
        lengths.append(env._strand.spec.length)
        assert length(env._strand.vertices()) == pytest.approx(lengths[-1], abs=1e-9)
        assert env.randomization["material"]["length"] == pytest.approx(lengths[-1] / 0.5)
        for _ in range(8):
            env._move(np.array([-1.0, -1, -1, 1, 1, 1]))
        assert np.linalg.norm(env._target[1] - env._target[0]) == pytest.approx(0.88 * lengths[-1], abs=1e-5)
    assert max(lengths) > 1.05 * min(lengths)


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


# ---- the images


@pytest.mark.parametrize("view", ["side", "above"])
def test_the_rope_is_seen_whole_and_wide_enough(view):
    env = make(view=view, camera="d455")
    rule = env.shape_obs_defaults["segmentation"]
    for seed in range(2):
        rgb = start(env, seed)["rgb"]
        mask = cv2.inRange(cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV), np.array(rule["low"]), np.array(rule["high"])) > 0
        pixels = np.rint(env.truth(200, frame="pixels")).astype(int)
        assert mask[pixels[:, 1], pixels[:, 0]].mean() > 0.97
        along = np.linalg.norm(np.diff(env.truth(200, frame="pixels"), axis=0), axis=1).sum()
        assert mask.sum() / along > 6  # pixels, its mean width
        assert (rgb.max(axis=2) < 80).sum() > 200, "the dark grippers are in view"
