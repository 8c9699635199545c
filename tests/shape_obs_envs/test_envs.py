"""The contract of all simulated environments, on top of Gymnasium's and Stable-Baselines3's checkers."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any, cast

import cv2
import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

pytest.importorskip("mujoco")

from env_checks import check_both
from simulator_gl import needs_gl

import shape_obs_envs  # noqa: F401
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
AT_NIGHT = ("cable in one gripper", "hanging from one gripper")
NAMES = [pytest.param(name, marks=pytest.mark.nightly) if name in AT_NIGHT else name for name in ENVS]
RENDERERS = ["rays", pytest.param("auto", marks=pytest.mark.nightly)]
# Differences of OpenGL and rays: the greatest of a colour away from edges, and of the depth in millimetres.
MOST_COLOUR, MOST_DEPTH = 24, 1.0


def make(name: str, **options: Any) -> ShapeGoalEnv:
    """Return the bare environment."""
    env_id, arguments = ENVS[name]
    env = gym.make(env_id, **{"camera": [84, 84], "renderer": "rays", **arguments, **options})
    return cast(ShapeGoalEnv, env.unwrapped)


def play(env: gym.Env[Any, Any], steps: int = 4, **reset: Any) -> list[Any]:
    """Return observations and infos of a few random steps."""
    rng = np.random.default_rng(1)
    out = [env.reset(**reset)]
    for _ in range(steps):
        observation, _, _, _, info = env.step(rng.uniform(-1, 1, env.action_space.shape or ()).astype(np.float32))
        out.append((observation, info))
    return out


def same(one: list[Any], other: list[Any], keys: tuple[str, ...] = ()) -> bool:
    return all(np.array_equal(a[k], b[k]) for (a, _), (b, _) in zip(one, other, strict=True) for k in keys or a)


@pytest.mark.parametrize("name", NAMES)
class TestEveryEnv:
    """What an environment promises, whatever its object is."""

    @pytest.mark.parametrize("renderer", RENDERERS)
    def test_both_checkers_pass(self, name, renderer):
        check_both(make(name, renderer=renderer, randomize=renderer == "auto"))

    @pytest.mark.nightly
    def test_both_checkers_pass_without_images_and_with_other_appearances(self, name):
        check_both(make(name, render_observation=False))
        check_both(make(name, randomize=True, difficulty="near"))

    @pytest.mark.parametrize("renderer", RENDERERS)
    def test_both_checkers_pass_on_the_wrapped_env_which_finds_the_object(self, name, renderer):
        env_id, arguments = ENVS[name]
        wrapped = gym.make(env_id.replace("-v0", "Shape-v0"), renderer=renderer, **arguments)
        check_both(wrapped)
        if "Cables" in env_id:
            return  # the mask shows several ropes, and the wrapper looks for one
        for observation, info in play(wrapped, 12, seed=1):
            error = np.linalg.norm(observation["achieved_goal"].reshape(-1, 3) - info["truth/points"], axis=1).mean()
            assert info["shape/ok"]
            assert error < 0.006, "a flipped or slipped shape is off by centimetres"

    def test_one_step_of_everything(self, name):
        env = make(name)
        first, info = env.reset(seed=3)
        kept, truth = {key: value.copy() for key, value in first.items()}, info["truth/points"].copy()
        second, reward, terminated, truncated, info = env.step(np.full(env.action_space.shape or (), 0.7, np.float32))
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

    @pytest.mark.parametrize("renderer", RENDERERS)
    def test_a_seed_gives_the_same_trajectory_and_images_and_forgets_the_past(self, name, renderer):
        env = make(name, renderer=renderer)
        first, other = play(env, seed=5), play(env, seed=6)
        assert same(first, play(env, seed=5))
        assert same(first, play(make(name, renderer=renderer), seed=5))
        assert not same(first, other, ("achieved_goal",))

    def test_without_images_the_same_happens_and_nothing_is_drawn(self, name):
        blind = make(name, render_observation=False)
        steps = play(blind, seed=2)
        assert set(steps[0][0]) == {"gripper", "achieved_goal", "desired_goal"}
        assert blind.observation_space.contains(steps[-1][0])
        assert same(steps, play(make(name), seed=2), ("gripper", "achieved_goal", "desired_goal"))
        assert blind._rendering.camera_name is None

    def test_frames_of_the_truth_agree(self, name):
        env = make(name)
        play(env, seed=2)
        camera, local = env.camera_model, env.truth(15, frame="camera")  # type: ignore[attr-defined]
        assert np.allclose(camera.to_base(local), env.truth(15), atol=1e-6)  # type: ignore[attr-defined]
        assert np.allclose(camera.intrinsics.project(local), env.truth(15, frame="pixels"))  # type: ignore[attr-defined]
        with pytest.raises(ValueError, match=r"frame: expected one of .* Did you mean 'pixels'"):
            env.truth(frame="pixel")  # type: ignore[attr-defined]
        with pytest.raises(ValueError, match=r"(n|rows): expected a whole number, [23] or more, got 1"):
            env.truth(1)  # type: ignore[attr-defined]

    @pytest.mark.parametrize(("difficulty", "most"), [("near", 0.05), ("middle", 0.1), ("far", 0.4)])
    def test_goals_are_as_far_as_the_difficulty_says_and_are_reached(self, name, difficulty, most):
        env = make(name, difficulty=difficulty, render_observation=False)
        idle = np.zeros(env.action_space.shape or (), np.float32)
        observation, info = env.reset(seed=0)
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

    def test_far_goals_are_farther_and_difficulty_can_grow(self, name):
        env = make(name, render_observation=False)
        away = {}
        for difficulty in ("near", "far"):
            env.difficulty = difficulty
            away[difficulty] = np.mean([env.reset(seed=seed)[1]["truth/mean_error"] for seed in range(3)])
        assert away["far"] > 1.5 * away["near"]
        with pytest.raises(ValueError, match=r"difficulty: expected one of 'near', 'middle', 'far', got 'nears'.*near"):
            env.difficulty = "nears"

    def test_an_episode_goes_on_from_its_state(self, name):
        """A restored state has the same physics and images; goals can be transferred."""
        one, two = make(name), make(name)
        before = play(one, seed=4)[-1]
        options = {"start": one.get_state().tolist(), "goal": before[0]["desired_goal"].tolist()}
        after = two.reset(seed=9, options=options)
        assert all(np.array_equal(before[0][key], after[0][key]) for key in before[0])
        assert len(two.goal_actions) == 0
        action = np.full(one.action_space.shape or (), 0.5, np.float32)
        ends = one.step(action)[0]["achieved_goal"], two.step(action)[0]["achieved_goal"]
        np.testing.assert_allclose(*ends, atol=1e-6)

    def test_bad_input_raises_an_error(self, name):
        env = make(name)
        count = len(env.reset(seed=0)[0]["desired_goal"]) // 3
        for options, message in (
            ({"gaol": 1}, r"options: expected one of 'start', 'goal', got 'gaol'. Did you mean 'goal'"),
            ({"goal": [1.0, 2.0]}, rf"options\['goal'\]: expected {count} points .* got an array of shape \(2,\)"),
            ({"goal": np.full((count, 3), np.nan)}, r"options\['goal'\]: .* nan"),
            ({"start": [1.0]}, r"expected a physics state, .* got \(1,\). Take it from"),
        ):
            with pytest.raises(ValueError, match=message):
                env.reset(options=options)
        with pytest.raises(ValueError, match=r"action: expected \(\d,\) finite numbers"):
            env.step(np.full(env.action_space.shape or (), np.nan, np.float32))

    def test_pictures_of_every_kind(self, name):
        env = make(name, render_mode="rgb_array")
        observation, _ = env.reset(seed=0)
        picture = cast(np.ndarray, env.render())
        assert np.array_equal(picture, observation["rgb"])
        picture[:] = 0
        picture = cast(np.ndarray, env.render())
        assert np.array_equal(picture, observation["rgb"]), "pictures share no memory"
        both = make(name, render_mode="rgbd_tuple", render_size=[320, 240])
        both.reset(seed=0)
        rgb, depth = cast(Any, both.render())
        assert (rgb.shape, rgb.dtype, depth.shape, depth.dtype) == ((240, 320, 3), np.uint8, (240, 320), np.float32)
        assert 0.3 < depth.min() < depth.max() < 1.6
        blind = make(name, render_mode="rgb_array", render_observation=False)
        blind.reset(seed=0)
        assert np.array_equal(cast(np.ndarray, blind.render()), picture)
        for one in (env, both, blind):
            one.close()

    @needs_gl
    def test_opengl_and_rays_draw_the_same(self, name):
        envs = [make(name, camera="rl", renderer=renderer) for renderer in ("gl", "rays")]
        for (one, _), (two, _) in zip(*(play(env, 8, seed=3)[::8] for env in envs), strict=True):
            edges = np.zeros(one["depth"].shape, np.uint8)
            for image in (one["rgb"], two["rgb"], one["depth"], two["depth"]):
                change = cv2.morphologyEx(image, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
                edges |= (change.reshape(*edges.shape, -1).max(axis=2) > 30).astype(np.uint8)
            away = cv2.dilate(edges, np.ones((3, 3), np.uint8)) == 0
            apart = np.abs(one["rgb"].astype(int) - two["rgb"]).max(axis=2)
            assert away.mean() > 0.5
            assert apart[away].max() <= MOST_COLOUR
            assert (apart > 20).mean() < 0.01, "outlines within a pixel"
            assert np.percentile(np.abs(one["depth"].astype(int) - two["depth"])[away], 99) <= MOST_DEPTH
        for env in envs:
            env.close()

    def test_rebuild_from_json(self, name):
        env_id, arguments = ENVS[name]
        options = {"camera": [84, 84], "renderer": "rays", "reward_type": "sparse", "difficulty": "far"}
        env = gym.make(env_id, **options, **arguments)
        assert env.spec is not None
        again = gym.make(EnvSpec.from_json(env.spec.to_json()))
        assert again.observation_space == env.observation_space
        assert again.get_wrapper_attr("reward_type") == "sparse"
        assert again.get_wrapper_attr("difficulty") == "far"
        json.dumps(again.get_wrapper_attr("shape_obs_defaults"))
        json.dumps(again.get_wrapper_attr("goal_layout"))

    def test_the_medium_is_stable_and_the_scene_stays_in_view(self, name):
        """Held actions at full strength are the hardest case."""
        env = make(name, render_observation=False)
        shape = env.action_space.shape or ()
        rng, action = np.random.default_rng(0), np.zeros(shape, np.float32)
        for seed in range(3):
            env.reset(seed=seed)
            for step in range(50):
                if step % 8 == 0:
                    action = np.sign(rng.uniform(-1, 1, shape)).astype(np.float32)
                observation, *_ = env.step(action)
                assert env.observation_space.contains(observation)
                pixels = env.camera_model.project_from_base(observation["achieved_goal"].reshape(-1, 3))
                assert pixels.min() > 1
                assert pixels.max() < 82
        assert not any(warning.number for warning in env._body.data.warning)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("cable", {"difficulty": "easy"}, r"difficulty: expected one of 'near', 'middle', 'far', got 'easy'"),
        ("cable", {"render_size": [10, 10]}, r"render_size: expected .* from 16 to 4096, got \[10, 10\]"),
        ("cable", {"success_threshold": 0}, r"success_threshold: expected a distance in metres above 0, got 0"),
        ("cable", {"camera": "d445"}, r"camera: .* or \[width, height\], got 'd445'. Did you mean 'd455'"),
        ("cable", {"camera": [84, 96]}, r"camera: expected a width of at least the height"),
        ("cable", {"renderer": "ray"}, r"renderer: expected one of 'auto', .* got 'ray'. Did you mean 'rays'"),
        ("cable", {"reward_type": "spars"}, r"reward_type: .* Did you mean 'sparse'"),
        ("hanging", {"step": 0.06}, r"step: expected at most 0.05 m, with which the physics is stable, got 0.06"),
        ("hanging", {"grippers": 3}, r"grippers: expected a whole number, from 1 to 2, got 3"),
        ("cables", {"ropes": 4}, r"ropes: expected a whole number, from 2 to 3, got 4"),
        ("cables", {"rope": 1, "grippers": 1}, r"rope: expected a whole number, from 0 to 0, got 1"),
    ],
)
def test_bad_arguments_are_refused(name, options, message):
    with pytest.raises(ValueError, match=message):
        make(name, **options)


def test_without_a_display_the_viewer_says_what_to_do(monkeypatch):
    from shape_obs_envs.mujoco.cameras.gl_camera import GLUnavailableError

    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    env = make("cable", render_mode="human", render_observation=False)
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


def test_time_limit_and_no_termination():
    env = gym.make("ShapeObs/Cable-v0", camera=[16, 16], renderer="rays")
    env.reset(seed=0)
    ends = [env.step(np.zeros(6, np.float32))[2:4] for _ in range(50)]
    assert ends == [(False, False)] * 49 + [(False, True)]


def test_mujoco_is_imported_only_when_needed(tmp_path):
    code = """
import sys
import gymnasium as gym, shape_obs_envs
assert not {"mujoco", "cv2"} & set(sys.modules)
sys.modules["mujoco"] = None
try:
    gym.make("ShapeObs/Cable-v0")
except ImportError as error:
    assert 'pip install ".[sim]"' in str(error), error
else:
    raise SystemExit("made without MuJoCo")
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path, timeout=60)
    assert not list(tmp_path.iterdir())


def test_a_saved_spec_with_the_old_entry_point_makes_the_environment():
    from dataclasses import replace

    spec = gym.spec("ShapeObs/D455-v0")
    saved = replace(spec, entry_point="shape_obs_envs.cell:D455Env", kwargs={"source": "d455:1"}).to_json()
    env = gym.make(EnvSpec.from_json(saved))
    assert type(env.unwrapped).__module__.startswith("shape_obs_envs.real")
    env.close()
