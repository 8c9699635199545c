"""The cloth environment against its own ground truth."""

from __future__ import annotations

from typing import Any, cast

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("mujoco")

import shape_obs_envs  # noqa: F401
from shape_obs_envs.mujoco.bodies import MaterialFactors
from shape_obs_envs.mujoco.cloth import COLS, ROWS, ClothEnv

IDLE = np.zeros(6, np.float32)


def make(**options: Any) -> ClothEnv:
    return cast(
        ClothEnv, gym.make("ShapeObs/Cloth-v0", **{"camera": [84, 84], "renderer": "rays", **options}).unwrapped
    )


def play(env: ClothEnv, moves: list[tuple[list[float], int]]) -> None:
    """Move both grippers by the same part of a step (x, y, z), or each by its own (6,), for some steps."""
    for move, steps in moves:
        for _ in range(steps):
            env._move(np.resize(np.asarray(move, np.float64), 6))


@pytest.fixture(scope="module")
def env():
    env = make()
    yield env
    env.close()


@pytest.fixture(scope="module")
def episodes() -> dict[str, np.ndarray]:
    """Return the effect of 9 episodes on the sheet: held actions, white noise, full strength."""
    env = make(render_observation=False)
    rng, action = np.random.default_rng(0), IDLE
    seen: dict[str, list[Any]] = {name: [] for name in ("stretch", "lowest")}
    for seed in range(9):
        env.reset(seed=seed)
        for step in range(50):
            if step % 8 == 0 or seed % 3 == 0:
                action = rng.uniform(-1, 1, 6)
                action = np.sign(action) if seed % 3 == 1 else action
            env.step(action.astype(np.float32))
            seen["stretch"].append(env._sheet.stretch())
            if step % 5 == 4:
                seen["lowest"].append(env._sheet.vertices()[..., 2].min())
    return {name: np.array(values) for name, values in seen.items()}


def test_the_sheet_hardly_stretches_and_stays_above_the_table(episodes):
    assert episodes["stretch"].max() < 0.1
    assert np.percentile(episodes["stretch"], 99) < 0.05
    assert episodes["lowest"].min() >= 0.001


def test_actions_move_each_gripper_and_its_corner_at_once(env):
    env.reset(seed=0)
    start = env._sheet.gripper_poses()
    env.step(np.array([-0.5, 0.4, 0.3, 0, 0, 0], np.float32))
    moved = env._sheet.gripper_poses()
    assert np.allclose(moved - start, [[-0.003, 0.0024, 0.0018], [0, 0, 0]], atol=2e-5)
    assert np.allclose(list(env.anchors.values()), moved, atol=1e-6)


def test_starts_are_unfolded_and_far_goals_are_not():
    env = make(render_observation=False, difficulty="far")
    for seed in range(4):
        env.reset(seed=seed)
        assert env.unfolded
        for action in [*env.goal_actions, *[IDLE] * 20]:
            env.step(action)
        assert not env.unfolded


def test_truth_runs_over_the_material_from_the_held_corner(env):
    env.reset(seed=2)
    play(env, [([1, 0.5, 0.5, -1, 0.5, 0.5], 6)])
    fine = env.truth(7, 13).reshape(7, 13, 3)
    assert np.allclose(fine, np.maximum(env._sheet.mesh.masses(env._body.data), [-9, -9, 0.001]), atol=1e-9)
    assert np.allclose(env.truth(4, 7).reshape(4, 7, 3), fine[::2, ::2])
    assert np.allclose(env.truth(3, 6, ends="centers").reshape(3, 6, 3), fine[1::2, 1::2])
    assert np.allclose([env.anchors["gripper0"], env.anchors["gripper1"]], fine[0, [0, -1]])
    assert env.goal_layout == {"kind": "surface", "rows": ROWS, "cols": COLS}
    observation, *_ = env.step(IDLE)
    assert np.allclose(observation["achieved_goal"].reshape(-1, 3), env.truth(), atol=1e-6)
    pixels = env.truth(frame="pixels").reshape(ROWS, COLS, 2)
    assert np.unravel_index(pixels.sum(axis=-1).argmin(), (ROWS, COLS)) == (0, 0)
    assert (np.diff(pixels[..., 0], axis=1) > 0).all()
    assert (np.diff(pixels[..., 1], axis=0) > 0).all()


def test_another_material_bends_otherwise_and_is_as_stable():
    env = make(render_observation=False)
    heights = []
    for stiffness in (0.25, 4.0):
        env._sheet.set_material(MaterialFactors(stiffness=stiffness, damping=1 / stiffness, friction=3.0))
        env.np_random = np.random.default_rng(0)
        env._target = env._draw_start()
        play(env, [([1, 0, 0.2, -1, 0, 0.2], 12), ([0, 0, 0], 20)])  # a stiff sheet makes higher humps
        heights.append(env.truth(7, 13)[:, 2].mean())
        assert env._sheet.stretch() < 0.05
    assert heights[1] > 1.1 * heights[0]
    env._sheet.set_material(MaterialFactors())
    assert env._sheet.spec == env._sheet.nominal
