"""Properties that all simulated environments share."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from typing import Any, cast

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env

pytest.importorskip("mujoco")

import shape_obs_envs  # noqa: F401
from shape_obs_envs.mujoco.cameras.gl_camera import GLUnavailableError
from shape_obs_envs.mujoco.goal_env import ShapeGoalEnv

ENVS = {
    "cable": ("ShapeObs/Cable-v0", {}),
    "cable in one gripper": ("ShapeObs/Cable-v0", {"grippers": 1}),
    "ring": ("ShapeObs/Ring-v0", {}),
    "cloth": ("ShapeObs/Cloth-v0", {}),
    "hanging": ("ShapeObs/Hanging-v0", {}),
    "hanging from one gripper": ("ShapeObs/Hanging-v0", {"grippers": 1}),
    "cables": ("ShapeObs/Cables-v0", {}),
    "two cables with a goal": ("ShapeObs/Cables-v0", {"ropes": 2, "rope": "all"}),
}


def make(name: str, **options: Any) -> ShapeGoalEnv:
    """Return the bare environment."""
    env_id, arguments = ENVS[name]
    env = gym.make(env_id, **{"camera": [84, 84], "renderer": "rays", **arguments, **options})
    return cast(ShapeGoalEnv, env.unwrapped)


def play(env: gym.Env[Any, Any], steps: int = 4, **reset: Any) -> list[Any]:
    """Return observations and infos of a few random steps."""
    rng = np.random.default_rng(1)
    assert env.action_space.shape is not None
    out = [env.reset(**reset)]
    for _ in range(steps):
        observation, _, _, _, info = env.step(rng.uniform(-1, 1, env.action_space.shape).astype(np.float32))
        out.append((observation, info))
    return out


def same(one: list[Any], other: list[Any], keys: tuple[str, ...] = ()) -> bool:
    return all(np.array_equal(a[k], b[k]) for (a, _), (b, _) in zip(one, other, strict=True) for k in keys or a)


@pytest.fixture(scope="module", params=ENVS)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def env(name: str):
    env = make(name)
    yield env
    env.close()


@pytest.mark.parametrize("renderer", ["rays", "auto"])
def test_both_checkers_pass(name, renderer):
    sb3 = pytest.importorskip("stable_baselines3.common.env_checker")
    check_env(make(name, renderer=renderer))
    sb3.check_env(make(name, renderer=renderer), warn=False)


@pytest.mark.parametrize("renderer", ["rays", "auto"])
def test_both_checkers_pass_on_what_is_ready_wrapped(name, renderer):
    sb3 = pytest.importorskip("stable_baselines3.common.env_checker")
    env_id, arguments = ENVS[name]
    wrapped = gym.make(env_id.replace("-v0", "Shape-v0"), renderer=renderer, **arguments)
    check_env(wrapped)
    sb3.check_env(wrapped, warn=False)
    if "Cables" in env_id:
        return  # the mask shows several ropes, and the wrapper looks for one
    for observation, info in play(wrapped, seed=1):
        error = np.linalg.norm(observation["achieved_goal"].reshape(-1, 3) - info["truth/points"], axis=1).mean()
        assert info["shape/ok"]
        assert error < 0.006


def test_one_step_of_everything(env):
    first, info = env.reset(seed=3)
    kept, truth = {key: value.copy() for key, value in first.items()}, info["truth/points"].copy()
    second, reward, terminated, truncated, info = env.step(np.full(env.action_space.shape, 0.7, np.float32))
    assert (terminated, truncated) == (False, False)
    assert reward == env.compute_reward(second["achieved_goal"], second["desired_goal"], info)
    assert reward == -info["truth/mean_error"]
    batch = np.stack([first["achieved_goal"], second["achieved_goal"]]), np.stack([first["desired_goal"]] * 2)
    assert env.compute_reward(*batch, [{}, {}])[1] == reward
    assert {key: value.dtype.name for key, value in second.items()} == {
        "rgb": "uint8", "depth": "uint16", "gripper": "float32",
        "achieved_goal": "float32", "desired_goal": "float32",
    }  # fmt: skip
    assert env.observation_space.contains(second)
    assert all(np.array_equal(first[key], kept[key]) for key in kept)
    assert not any(np.shares_memory(first[key], second[key]) for key in kept)
    assert not np.array_equal(truth, info["truth/points"])


@pytest.mark.parametrize("renderer", ["rays", "auto"])
def test_a_seed_gives_the_same_trajectory_and_images(name, renderer):
    one, two = (play(make(name, renderer=renderer), seed=5) for _ in range(2))
    assert same(one, two)
    assert not same(one, play(make(name, renderer=renderer), seed=6), ("achieved_goal",))


def test_without_images_the_same_happens_and_nothing_is_drawn(name, env):
    blind = make(name, render_observation=False)
    steps = play(blind, seed=2)
    assert set(steps[0][0]) == {"gripper", "achieved_goal", "desired_goal"}
    assert blind.observation_space.contains(steps[-1][0])
    assert same(steps, play(env, seed=2), ("gripper", "achieved_goal", "desired_goal"))
    assert blind._rendering.camera_name is None
    check_env(make(name, render_observation=False), skip_render_check=True)


@pytest.mark.parametrize(("difficulty", "most"), [("near", 0.05), ("middle", 0.1), ("far", 0.4)])
def test_goals_are_as_far_as_the_difficulty_says_and_are_reached(name, difficulty, most):
    env = make(name, difficulty=difficulty, render_observation=False)
    assert env.action_space.shape is not None
    idle = np.zeros(env.action_space.shape, np.float32)
    observation: Any = {}
    for seed in range(3):
        observation, info = env.reset(seed=seed)
        assert 0.01 < info["truth/mean_error"] <= most
        assert 0 < len(env.goal_actions) <= 40
        for action in [*env.goal_actions, *[idle] * 20]:
            observation, _, _, _, info = env.step(action)
        assert info["truth/mean_error"] < 0.005
        assert info["is_success"] is True
        for _ in range(40):
            observation, _, _, _, info = env.step(idle)
        assert info["truth/mean_error"] < 0.01, "the goal is no shape that the object keeps"
    assert env.observation_space.contains(observation)


def test_far_goals_are_farther_and_difficulty_can_grow(name):
    env = make(name, render_observation=False)
    away = {}
    for difficulty in ("near", "far"):
        env.difficulty = difficulty
        away[difficulty] = np.mean([env.reset(seed=seed)[1]["truth/mean_error"] for seed in range(4)])
    assert away["far"] > 1.5 * away["near"]
    with pytest.raises(ValueError, match=r"difficulty: expected one of 'near', 'middle', 'far', got 'nears'.*'near'"):
        env.difficulty = "nears"


def test_an_episode_goes_on_from_its_state(name):
    """A restored state has the same physics and images; goals can be transferred."""
    one, two = make(name), make(name)
    before = play(one, seed=4)[-1]
    options = {"start": one.get_state().tolist(), "goal": before[0]["desired_goal"].tolist()}
    after = two.reset(seed=9, options=options)
    assert all(np.array_equal(before[0][key], after[0][key]) for key in before[0])
    assert len(two.goal_actions) == 0
    action = np.full(one.action_space.shape or (), 0.5, np.float32)
    np.testing.assert_allclose(one.step(action)[0]["achieved_goal"], two.step(action)[0]["achieved_goal"], atol=1e-6)
    two.reset(options={"start": options["start"]})
    assert len(two.goal_actions) > 0


def test_bad_options_raise_an_error(env):
    count = len(env.observation_space["desired_goal"].low) // 3
    with pytest.raises(ValueError, match=r"options: expected one of 'start', 'goal', got 'gaol'. Did you mean 'goal'"):
        env.reset(options={"gaol": 1})
    with pytest.raises(
        ValueError, match=rf"options\['goal'\]: expected {count} points .* got an array of shape \(2,\)"
    ):
        env.reset(options={"goal": [1.0, 2.0]})
    with pytest.raises(ValueError, match=r"options\['goal'\]: .* nan"):
        env.reset(options={"goal": np.full((count, 3), np.nan)})
    with pytest.raises(ValueError, match=r"expected a physics state, .* got \(1,\). Take it from"):
        env.reset(options={"start": [1.0]})


def test_pictures_of_every_kind(name):
    env = make(name, render_mode="rgb_array")
    observation, _ = env.reset(seed=0)
    picture = env.render()
    assert np.array_equal(picture, observation["rgb"])
    assert not np.shares_memory(picture, env.render())

    both = make(name, render_mode="rgbd_tuple", render_size=[320, 240])
    both.reset(seed=0)
    rgb, depth = both.render()
    assert (rgb.shape, rgb.dtype, depth.shape, depth.dtype) == ((240, 320, 3), np.uint8, (240, 320), np.float32)
    assert 0.3 < depth.min() < depth.max() < 1.6

    blind = make(name, render_mode="rgb_array", render_observation=False)
    blind.reset(seed=0)
    assert np.array_equal(blind.render(), picture)
    for one in (env, both, blind):
        one.close()


def test_without_a_display_the_viewer_says_what_to_do(name, monkeypatch):
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    env = make(name, render_mode="human", render_observation=False)
    assert "human" not in env.metadata["render_modes"]
    with pytest.raises(GLUnavailableError, match=r'no display. Record a video instead: render_mode="rgb_array"'):
        env.reset(seed=0)


def test_a_video_is_recorded(tmp_path):
    pytest.importorskip("moviepy")
    env = gym.make("ShapeObs/RingShape-v0", renderer="rays", render_mode="rgb_array", render_size=[320, 240])
    env = gym.wrappers.RecordVideo(env, str(tmp_path), disable_logger=True)
    play(env, seed=0)
    env.close()
    assert [path.stat().st_size > 1000 for path in tmp_path.glob("*.mp4")] == [True]


def test_rebuild_from_json(name):
    env_id, arguments = ENVS[name]
    env = gym.make(env_id, camera=[84, 84], renderer="rays", reward_type="sparse", difficulty="far", **arguments)
    assert env.spec is not None
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.observation_space == env.observation_space
    assert again.get_wrapper_attr("reward_type") == "sparse"
    assert again.get_wrapper_attr("difficulty") == "far"
    json.dumps(again.get_wrapper_attr("shape_obs_defaults"))
    json.dumps(again.get_wrapper_attr("goal_layout"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"difficulty": "easy"}, r"difficulty: expected one of 'near', 'middle', 'far', got 'easy'"),
        ({"render_observation": "no"}, r"render_observation: expected one of True, False, got 'no'"),
        ({"render_size": [10, 10]}, r"render_size: expected .* from 16 to 4096, got \[10, 10\]"),
        ({"success_threshold": -1}, r"success_threshold: expected a distance in metres above 0, got -1"),
    ],
)
def test_bad_arguments(name, arguments, message):
    with pytest.raises(ValueError, match=message):
        make(name, **arguments)


def test_the_medium_is_stable_and_the_scene_stays_in_view(name):
    """Held actions at full strength are the hardest case."""
    env = make(name, render_observation=False)
    assert env.action_space.shape is not None
    rng, action = np.random.default_rng(0), np.zeros(env.action_space.shape, np.float32)
    for seed in range(6):
        env.reset(seed=seed)
        for step in range(50):
            if step % 8 == 0:
                action = np.sign(rng.uniform(-1, 1, env.action_space.shape)).astype(np.float32)
            observation, *_ = env.step(action)
            assert env.observation_space.contains(observation)
            pixels = env.camera_model.project_from_base(observation["achieved_goal"].reshape(-1, 3))
            assert pixels.min() > 1
            assert pixels.max() < 82
    assert not any(warning.number for warning in env._body.data.warning)


def test_importing_the_ids_is_light():
    code = "import sys, shape_obs_envs; assert 'mujoco' not in sys.modules and 'cv2' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
    assert importlib.import_module("gymnasium").spec("ShapeObs/Cloth-v0").max_episode_steps == 50
