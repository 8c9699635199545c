"""D455Noise on environments: spaces, seeds, rebuilding, and detection through the noise."""

from __future__ import annotations

import copy
import json
import math
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from hypothesis import given
from hypothesis import strategies as st
from rope_env import PixelEnv, RopeEnv

from shape_obs import ShapeObservation
from shape_obs_envs.d455 import D455Model, D455Noise

SMALL = (120, 160)
FORMS = pytest.mark.parametrize("fast", [False, True], ids=["exact", "fast"])


class Images(gym.Env[Any, Any]):
    """An environment that repeats the same images."""

    metadata = {"render_modes": [], "render_fps": 10}  # noqa: RUF012

    def __init__(self, depth: np.ndarray | None, high: float = 10.0) -> None:
        size = (120, 160) if depth is None else depth.shape[:2]
        self.rgb = np.random.default_rng(0).integers(0, 256, (*size, 3)).astype(np.uint8)
        self.depth = depth
        parts: dict[str, gym.Space[Any]] = {
            "rgb": gym.spaces.Box(0, 255, (*size, 3), np.uint8),
            "state": gym.spaces.Box(-1.0, 1.0, (2,), np.float32),
        }
        if depth is not None:
            dtype: Any = depth.dtype.type
            parts["depth"] = gym.spaces.Box(0, 65535 if dtype == np.uint16 else high, depth.shape, dtype)
        self.observation_space = gym.spaces.Dict(parts)
        self.action_space = gym.spaces.Discrete(2)

    def observe(self) -> dict[str, Any]:
        images = {"rgb": self.rgb, "state": np.zeros(2, np.float32)}
        return images if self.depth is None else {**images, "depth": self.depth}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        return self.observe(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return self.observe(), 0.0, False, False, {}


@given(
    st.tuples(st.integers(1, 40), st.integers(1, 60)),
    st.sampled_from([np.uint16, np.float16, np.float32, np.float64]),
    st.booleans(),
    st.booleans(),
    st.sampled_from([0.5, 10.0]),
    st.integers(0, 2**31),
)
def test_observations_are_finite_and_in_their_space(size, dtype, fast, channel, high, seed):
    rng = np.random.default_rng(seed)
    if dtype == np.uint16:
        depth = rng.choice(np.array([0, 1, 300, 320, 700, 6000, 65535], np.uint16), size)
    else:
        depth = rng.choice(np.array([0, -1, 1e-30, 0.32, 0.7, 6.1, 1e30, np.inf, np.nan]), size)
        with np.errstate(over="ignore"):
            depth = depth.astype(dtype)
    depth = depth[..., None] if channel else depth
    env = D455Noise(Images(depth, high), fast=fast)
    kept = env.unwrapped.rgb.copy(), depth.copy()  # type: ignore[attr-defined]
    first, _ = env.reset(seed=seed)
    second, *_ = env.step(0)
    for observation in (first, second):
        assert env.observation_space.contains(observation)
        assert observation["depth"].dtype == dtype
        assert observation["depth"].shape == depth.shape
        assert np.isfinite(observation["depth"].astype(float)).all()
        assert not np.shares_memory(observation["depth"], depth)
        assert not np.shares_memory(observation["rgb"], env.unwrapped.rgb)  # type: ignore[attr-defined]
    for key in ("rgb", "depth"):
        assert not np.shares_memory(first[key], second[key])
    assert np.array_equal(env.unwrapped.rgb, kept[0])  # type: ignore[attr-defined]
    assert np.array_equal(depth, kept[1], equal_nan=dtype != np.uint16)


@FORMS
def test_a_seed_gives_the_same_images_again(fast):
    def frames(env: D455Noise, seed: int | None, steps: int = 3) -> list[Any]:
        return [env.reset(seed=seed)[0], *(env.step(0)[0] for _ in range(steps))]

    def same(one: list[Any], two: list[Any]) -> bool:
        pairs = zip(one, two, strict=True)
        return all(np.array_equal(a[key], b[key]) for a, b in pairs for key in ("rgb", "depth"))

    depth = np.full(SMALL, 700, np.uint16)
    env, other = (D455Noise(Images(depth), fast=fast) for _ in range(2))
    first = frames(env, 7)
    assert same(first, frames(other, 7))
    second = frames(env, None)
    assert not same(first, second)
    assert same(second, frames(other, None)), "without a seed the stream goes on"
    assert same(first, frames(env, 7))
    assert not same(first, frames(env, 8))
    assert not same(first[:-1], first[1:])
    for copied in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert same(*([e.step(0)[0] for _ in range(3)] for e in (copy.deepcopy(env), copied)))


def test_only_images_are_touched():
    env = D455Noise(Images(np.full(SMALL, 700, np.uint16)))
    observation, _ = env.reset(seed=0)
    assert list(observation) == ["rgb", "state", "depth"]
    assert not observation["state"].any()
    assert env.observation_space == env.unwrapped.observation_space
    assert np.array_equal(observation["depth"], np.rint(1000 * env.measurement.metres))  # type: ignore[union-attr]
    bare = D455Noise(PixelEnv(RopeEnv()))
    picture, _ = bare.reset(seed=0)
    assert bare.observation_space.contains(picture)
    assert not np.array_equal(picture, bare.env.reset(seed=0)[0])
    assert bare.measurement is None
    colour_only = D455Noise(Images(None))
    assert set(colour_only.reset(seed=0)[0]) == {"rgb", "state"}


def test_it_is_rebuilt_from_json():
    gym.register("D455/Rope-v0", entry_point="rope_env:RopeEnv")
    model = D455Model(speckle_share=0.03, max_z=None)
    env = D455Noise(gym.make("D455/Rope-v0"), model, fast=False, rgb_key="rgb")
    assert env.spec is not None
    text = env.spec.to_json()
    assert json.loads(text)["additional_wrappers"][-1]["kwargs"]["model"]["speckle_share"] == 0.03
    again = gym.make(EnvSpec.from_json(text))
    assert isinstance(again, D455Noise)
    assert again.model == model
    assert not again.fast
    assert np.array_equal(again.reset(seed=3)[0]["depth"], env.reset(seed=3)[0]["depth"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"model": {"speckle": 0.1}}, r"D455Model: unknown field 'speckle'; did you mean 'speckle_s"),
        ({"model": {"speckle_share": 1.5}}, r"D455Model.speckle_share: expected a share from 0 .* got 1.5"),
        ({"model": {"subpixel": math.nan}}, r"D455Model.subpixel: expected native pixels of disparity .* got nan"),
        ({"model": {"width": 640.5}}, r"D455Model.width: expected int, got 640.5"),
        ({"model": {"min_z": 1, "max_z": 0.5}}, r"max_z: expected metres above min_z, .* got 0.5 with min_z 1.0"),
        ({"model": "d455"}, r"D455Model: expected a mapping or a D455Model, got 'd455'"),
        ({"fast": "yes"}, r"fast: expected True or False, got 'yes'"),
        ({"rgb_key": "image"}, r"rgb_key 'image' is not in the observation"),
        ({"depth_key": "dept"}, r"depth_key 'dept' is not in the observation; did you mean 'depth'"),
        ({"depth_key": "state"}, r"observation\['state'\] must be a depth image .* Pass depth_key="),
    ],
)
def test_bad_arguments(arguments, message):
    env = Images(np.full(SMALL, 1.0, np.float32))
    with pytest.raises(ValueError, match=message):
        D455Noise(env, **arguments)
    space: Any = env.observation_space
    space.spaces["depth"] = gym.spaces.Box(0.1, 5.0, SMALL, np.float32)
    with pytest.raises(ValueError, match=r"a hole is 0, which the space must contain, got low 0.1"):
        D455Noise(env)


# ---- over the cable environment


def cable(**kwargs: Any) -> gym.Env[Any, Any]:
    pytest.importorskip("mujoco")
    return gym.make("shape_obs_envs:ShapeObs/Cable-v0", **{"camera": [84, 84], "renderer": "rays", **kwargs})


def test_rewards_are_those_of_the_env_inside():
    env = D455Noise(cable())
    _, reward, *_, info = (env.reset(seed=0), env.step(np.ones(6, np.float32)))[1]
    truth: np.ndarray = info["truth/points"].ravel()
    goal = env.reset(seed=0)[0]["desired_goal"]
    assert env.compute_reward(truth, goal, {}) == pytest.approx(reward)
    assert not hasattr(D455Noise(RopeEnv()), "compute_reward"), "Stable-Baselines3 would take it for a GoalEnv"


@FORMS
@pytest.mark.parametrize(("camera", "episodes"), [("rl", 4), ("d455", 2)])
def test_the_shape_found_stays_close_to_the_truth(camera, episodes, fast):
    env = ShapeObservation(D455Noise(cable(camera=camera), fast=fast))
    errors, valid = [], []
    for episode in range(episodes):
        observation, info = env.reset(seed=episode)
        action = np.random.default_rng(episode).uniform(-1, 1, 6).astype(np.float32)
        for _ in range(5):
            assert info["shape/ok"]
            truth: np.ndarray = env.unwrapped.truth(20)  # type: ignore[attr-defined]
            errors.append(np.linalg.norm(truth - observation["achieved_goal"].reshape(-1, 3), axis=1).mean())
            valid.append(info["shape/centerline/valid_fraction"])
            observation, *_, info = env.step(action)
    assert np.mean(errors) < 0.005
    assert np.mean(valid) > 0.95
