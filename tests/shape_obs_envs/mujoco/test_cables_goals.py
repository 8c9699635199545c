"""Goals of the cables environment in the wrappers: of all ropes, of one, and what the servo does with them."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("mujoco")

import shape_obs_envs  # noqa: F401
from shape_obs import ShapeGoal

GOALS = ("achieved_goal", "desired_goal")
# Two ropes at a size at which every rope is found in each of these frames.
SEEN = {"camera": [320, 240], "renderer": "rays", "ropes": 2, "difficulty": "near"}


def shapes_env(**options: Any) -> Any:
    return gym.make("ShapeObs/CablesShape-v0", **{**SEEN, **options})


@pytest.mark.parametrize("options", [{}, {"grippers": 1}, {"ropes": 3, "camera": "d455"}], ids=str)
def test_slot_k_has_the_goal_of_rope_k(options):
    env = ShapeGoal(shapes_env(rope="all", **options))
    ropes = options.get("ropes", 2)
    assert env.names == tuple(f"centerline{k}" for k in range(ropes))
    for seed in range(2):
        observation, info = env.reset(seed=seed)
        assert all(info[f"shape/{name}/ok"] for name in env.names)
        inner: Any = env.unwrapped
        goal = inner._goal.reshape(ropes, 20, 3)
        for _ in range(2):
            achieved, desired = (observation[key].reshape(ropes, 20, 3) for key in GOALS)
            for rope in range(ropes):
                off = np.linalg.norm(achieved[rope] - inner.truth(rope=rope), axis=1)
                assert off.mean() < 0.01
                assert np.linalg.norm(desired[rope] - goal[rope], axis=1).max() < 0.003
            observation, reward, _, _, info = env.step(np.full(env.action_space.shape or (), 0.2, np.float32))
            apart = np.linalg.norm(achieved - desired, axis=2).mean()
            assert reward == -info["goal/distance"] == pytest.approx(-apart, abs=0.01)
            assert info["goal/distance"] == pytest.approx(info["truth/mean_error"], abs=0.01)


def test_the_rope_with_the_goal_is_in_slot_0():
    env = ShapeGoal(shapes_env(rope=1))
    assert env.names == ("centerline0",)
    observation, _ = env.reset(seed=0)
    inner: Any = env.unwrapped
    off = np.linalg.norm(observation["achieved_goal"].reshape(-1, 3) - inner.truth(rope=1), axis=1)
    assert off.mean() < 0.01
    assert observation["desired_goal"].shape == (60,)


@pytest.mark.nightly
@pytest.mark.parametrize("rope", [0, 1])
def test_the_servo_moves_only_the_gripper_of_the_named_rope(rope):
    from tests.benchmarks.servo import Setting, World, play

    setting = Setting("Cables", "middle", "truth", "160x120", "points3d", "rls", rope=rope)
    world = World(setting)
    assert list(world.coordinates or ()) == [3 * rope, 3 * rope + 1, 3 * rope + 2]
    taken = []
    space: Any = world.env.action_space
    world.env = gym.wrappers.TransformAction(world.env, lambda action: taken.append(action) or action, space)
    episode = play(world, "rls", 1, 60)
    assert episode.success
    own, other = np.abs(taken).max(axis=0).reshape(2, 3)[[rope, 1 - rope]]
    assert own.min() >= 0.6
    assert other.max() == 0
