"""ShapeObservation over the simulated cable: the camera's goals, rewards, anchors; no truth reaches a policy."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env

pytest.importorskip("mujoco")

import shape_obs_envs  # noqa: F401
from shape_obs import ShapeGoal, ShapeObservation
from shape_obs.features import Points3D

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


def test_it_works_without_an_argument():
    env = ShapeObservation(bare())
    assert isinstance(env.observation_space, spaces.Dict)
    assert set(env.observation_space) == {"observation", "achieved_goal", "desired_goal"}
    for space in env.observation_space.values():
        assert isinstance(space, spaces.Box)
        assert space.dtype == np.float32
        assert np.isfinite([space.low, space.high]).all()


@pytest.mark.parametrize("seed", range(4))
def test_the_achieved_goal_is_what_the_camera_saw_of_the_truth(seed):
    env = ShapeObservation(bare())
    for observation, _, _, _, info in walk(env, seed):
        error = np.linalg.norm(points(observation["achieved_goal"]) - info["truth/points"], axis=1)
        assert 0 < error.mean() < 0.004
        assert error.max() < 0.012
        assert env.observation_space.contains(observation)
        np.testing.assert_array_equal(observation["achieved_goal"], observation["observation"])


def test_the_desired_goal_is_the_target_and_stays(episode):
    inner = bare().reset(seed=0)[0]["desired_goal"]
    for observation, *_ in episode:
        np.testing.assert_allclose(points(observation["desired_goal"]), points(inner), atol=0.002)


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


def test_equal_gaps_in_the_image_are_asked_of_the_target_too():
    shape = {"kind": "centerline", "n": 12, "ends": "tips", "spacing": "px"}
    env = ShapeObservation(bare(), shapes=[shape], features=["points3d"])
    observation, _ = env.reset(seed=3)
    pixels = env.get_wrapper_attr("camera_model").intrinsics.project(points(observation["desired_goal"]))
    gap = np.linalg.norm(np.diff(pixels, axis=0), axis=1)
    assert gap.std() / gap.mean() < 0.01


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
    with pytest.raises(
        ValueError,
        match="keep: 'achieved_goal' comes from the simulator's state; this wrapper computes it from the camera",
    ):
        ShapeObservation(bare(), keep=["achieved_goal"])


def test_kept_vectors_join_the_observation_and_images_stay_apart():
    env = ShapeObservation(bare(), keep=["gripper", "depth"])
    observation, _ = env.reset(seed=0)
    assert set(observation) == {"observation", "achieved_goal", "desired_goal", "depth"}
    assert observation["observation"].shape == (70,)
    np.testing.assert_array_equal(observation["observation"][60:], bare().reset(seed=0)[0]["gripper"])
    assert env.observation_space.contains(observation)


def test_point_zero_is_at_the_gripper_that_is_asked_for():
    """The default anchor is gripper0, which holds the simulator's end 0."""
    by_default = ShapeObservation(bare())
    other = ShapeObservation(bare(), shapes=[{"kind": "centerline", "anchor": "gripper1", "ends": "tips"}])
    for seed in range(10):
        observation, info = by_default.reset(seed=seed)
        assert np.linalg.norm(points(observation["achieved_goal"])[0] - info["truth/points"][0]) < 0.01
        observation, info = other.reset(seed=seed)
        assert np.linalg.norm(points(observation["achieved_goal"])[0] - info["truth/points"][-1]) < 0.02  # the surface


def test_goals_need_points_in_space_and_the_cameras_place():
    with pytest.raises(
        ValueError, match=r"goals, whose distance is in metres: add 'points3d' to features, got \['points2d'\]"
    ):
        ShapeObservation(bare(), features=["points2d"])
    intrinsics = bare().get_wrapper_attr("camera_model").intrinsics
    with pytest.raises(
        ValueError, match=r"goals in the base frame: its camera_model .* needs transform_camera_to_base"
    ):
        ShapeObservation(bare(), features=[Points3D()], camera=intrinsics)


@pytest.mark.parametrize("keep", [[], ["gripper"]])
def test_gymnasiums_and_sb3s_checkers_are_content(keep):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*is different from the unwrapped version")
        check_env(ShapeObservation(bare(), keep=keep), skip_render_check=True)
        checker = pytest.importorskip("stable_baselines3.common.env_checker")
        checker.check_env(ShapeObservation(bare(), keep=keep), warn=True)


def test_both_are_content_with_goals_in_features_too():
    features = [{"kind": "points3d", "frame": "base"}, "points2d", "ok"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*is different from the unwrapped version")
        env = ShapeGoal(ShapeObservation(bare(), features=features), features=["points2d"], threshold=2.0)
        check_env(env, skip_render_check=True)
        checker = pytest.importorskip("stable_baselines3.common.env_checker")
        checker.check_env(ShapeGoal(ShapeObservation(bare())), warn=True)


def test_goals_in_features_are_those_of_the_observation():
    env, own = ShapeObservation(bare()), ShapeGoal(ShapeObservation(bare()))
    for a, b in zip(walk(env, 2), walk(own, 2), strict=True):
        for key in ("observation", "achieved_goal", "desired_goal"):
            np.testing.assert_array_equal(a[0][key], b[0][key])
        assert b[4]["truth/is_success"] == a[4]["is_success"]
        assert a[1] == pytest.approx(b[1])


def test_a_rope_is_no_goal_for_an_outline():
    with pytest.raises(
        ValueError, match=r"goals of the layout 'centerline': the first of shapes must be a 'centerline', got"
    ):
        ShapeObservation(bare(), shapes=["contour"])


def test_the_registered_wrapper_is_the_wrappers_own_spec():
    assert gym.spec("ShapeObs/CableShape-v0").additional_wrappers == (ShapeObservation.wrapper_spec(),)


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


@pytest.mark.parametrize("how", ["registered", "by hand"])
def test_a_fresh_process_rebuilds_the_env_from_json(how):
    env: gym.Env[Any, Any]
    if how == "registered":
        env = gym.make("ShapeObs/CableShape-v0", renderer="rays", camera=[84, 84])
    else:
        shapes = [{"kind": "centerline", "n": 9, "anchor": (0.1, 0.2, 0.0), "spacing": "m"}]
        env = ShapeObservation(
            bare(camera=[84, 84]), shapes, keep=("gripper",), features=[Points3D(frame="base"), "ok"]
        )
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
