"""ShapeObservation over the simulated cable: the camera's goals, rewards, anchors; no truth reaches a policy."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from env_checks import check_both
from gymnasium.envs.registration import EnvSpec
from installed import needs

import shape_obs_envs  # noqa: F401
from shape_obs import ShapeObservation
from shape_obs.features import Points3D

pytestmark = needs("mujoco")

ACTIONS = np.random.default_rng(5).uniform(-1, 1, (6, 6)).astype(np.float32)


def bare(**kwargs: Any) -> gym.Env[Any, Any]:
    return gym.make("ShapeObs/Cable-v0", **{"renderer": "rays", **kwargs})


def walk(env: gym.Env[Any, Any], seed: int = 0) -> list[Any]:
    observation, info = env.reset(seed=seed)
    return [(observation, 0.0, False, False, info), *(env.step(action) for action in ACTIONS)]


def points(goal: Any) -> np.ndarray:
    return np.asarray(goal).reshape(-1, 3)


@pytest.fixture(scope="module")
def episode() -> list[Any]:
    return walk(ShapeObservation(bare()))


@pytest.mark.parametrize("seed", range(2))
def test_the_achieved_goal_is_what_the_camera_saw_of_the_truth(seed):
    env = ShapeObservation(bare())
    for observation, _, _, _, info in walk(env, seed):
        error = np.linalg.norm(points(observation["achieved_goal"]) - info["truth/points"], axis=1)
        assert 0 < error.mean() < 0.004
        assert error.max() < 0.012
        assert env.observation_space.contains(observation)
        np.testing.assert_array_equal(observation["achieved_goal"], observation["observation"])


def test_goals_go_through_the_same_feature_code():
    """With other points in another frame, the target consists of those points in that frame."""
    shape = {"kind": "centerline", "n": 7, "ends": "tips", "anchor": "gripper1", "spacing": "m"}
    env = ShapeObservation(bare(), shapes=[shape], features=["ok", "points3d"])
    observation, _ = env.reset(seed=3)
    assert env.observation_space["observation"].shape == (22,)  # type: ignore[index]
    np.testing.assert_array_equal(observation["observation"][1:], observation["achieved_goal"])
    camera = env.get_wrapper_attr("camera_model")
    target = points(bare().reset(seed=3)[0]["desired_goal"])
    desired = points(observation["desired_goal"])
    assert desired.shape == (7, 3)
    np.testing.assert_allclose(desired[[0, -1]], camera.from_base(target[[0, -1]]), atol=1e-4)
    gap = np.linalg.norm(np.diff(desired, axis=0), axis=1)
    assert gap.std() / gap.mean() < 0.01
    assert isinstance(env.compute_reward(observation["achieved_goal"], observation["desired_goal"], {}), float)


@pytest.mark.parametrize("reward_type", ["dense", "sparse"])
def test_the_reward_is_that_of_the_goals_and_batches(reward_type):
    env = ShapeObservation(bare(reward_type=reward_type))
    steps = walk(env)[1:]
    achieved = np.stack([step[0]["achieved_goal"] for step in steps])
    desired = np.stack([step[0]["desired_goal"] for step in steps])
    rewards = np.array([step[1] for step in steps])
    np.testing.assert_allclose(env.compute_reward(achieved, desired, [{}] * len(steps)), rewards)
    for step in steps:
        assert step[1] == env.compute_reward(step[0]["achieved_goal"], step[0]["desired_goal"], step[4])
        assert isinstance(step[1], float)
        assert isinstance(step[4]["truth/reward"], float)
    np.testing.assert_allclose(env.compute_reward(desired, desired, None), 0)
    if reward_type == "dense":
        by_hand = -np.linalg.norm(achieved.reshape(-1, 20, 3) - desired.reshape(-1, 20, 3), axis=2).mean(axis=1)
        np.testing.assert_allclose(rewards, by_hand, atol=1e-6)
        assert np.abs(rewards - [step[4]["truth/reward"] for step in steps]).max() < 0.004


class Lying(gym.ObservationWrapper[Any, Any, Any]):
    """Replaces the simulator's achieved goal by noise."""

    def observation(self, observation: Any) -> Any:
        noise = np.random.default_rng(0).uniform(-0.4, 0.4, 60).astype(np.float32)
        return {**observation, "achieved_goal": np.clip(noise, -0.4, 0.4)}


def test_no_truth_reaches_a_policy(episode):
    for a, b in zip(walk(ShapeObservation(Lying(bare()))), episode, strict=True):
        for key in ("observation", "achieved_goal", "desired_goal"):
            np.testing.assert_array_equal(a[0][key], b[0][key])
        assert a[1] == b[1]
    with pytest.raises(ValueError, match="keep: 'achieved_goal' comes from the simulator's state; this wrapper"):
        ShapeObservation(bare(), keep=["achieved_goal"])


def test_goals_need_points_in_space_and_the_cameras_place():
    with pytest.raises(ValueError, match=r"goals, whose distance is in metres: add 'points3d' to features, got"):
        ShapeObservation(bare(), features=["points2d"])
    intrinsics = bare().get_wrapper_attr("camera_model").intrinsics
    with pytest.raises(ValueError, match=r"goals in the base frame: its camera_model .* needs"):
        ShapeObservation(bare(), features=[Points3D()], camera=intrinsics)


def test_both_checkers_pass():
    check_both(ShapeObservation(bare(), keep=["gripper"]))


REBUILD = """
import json, sys
import gymnasium as gym, numpy as np
from gymnasium.envs.registration import EnvSpec
import shape_obs_envs
spec, actions = json.loads(sys.stdin.read())
env = gym.make(EnvSpec.from_json(spec))
steps = [env.reset(seed=7)[0], *(env.step(np.array(a, np.float32))[0] for a in actions)]
print(json.dumps([{key: value.tolist() for key, value in step.items()} for step in steps]))
"""


def test_a_fresh_process_rebuilds_the_env_from_json():
    shapes = [{"kind": "centerline", "n": 9, "anchor": (0.1, 0.2, 0.0), "spacing": "m"}]
    env = ShapeObservation(bare(camera=[84, 84]), shapes, keep=("gripper",), features=[Points3D(frame="base"), "ok"])
    assert env.spec is not None
    text = env.spec.to_json()
    assert EnvSpec.from_json(text) == env.spec
    steps = [env.reset(seed=7)[0], *(env.step(action)[0] for action in ACTIONS[:2])]
    done = subprocess.run(
        [sys.executable, "-c", REBUILD], input=json.dumps([text, ACTIONS[:2].tolist()]), capture_output=True, text=True,
        timeout=120, env={**os.environ, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for mine, theirs in zip(steps, json.loads(done.stdout), strict=True):
        assert set(mine) == set(theirs)
        for key in mine:
            np.testing.assert_array_equal(mine[key], np.array(theirs[key], np.float32))
