"""The D455 model compared with its closed forms, and D455Noise on environments."""

from __future__ import annotations

import copy
import json
import math
import pickle
import warnings
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from hypothesis import given
from hypothesis import strategies as st
from rope_env import PixelEnv, RopeEnv

from shape_obs import ShapeObservation
from shape_obs_envs.d455 import Cause, D455Camera, D455Model, D455Noise, Light, Measurement

MODEL = D455Model()
PRODUCT = 386 * 0.095  # f B
CLEAR = D455Model(
    subpixel=0, disparity_step=0, left_band=False, edge_share=0, dark_share=0, speckle_share=0, min_z=0, max_z=None,
    exposure=0, white_balance=0, drift=0, read=0, shot=0,
)  # fmt: skip
NATIVE, SMALL = (480, 640), (120, 160)
FORMS = pytest.mark.parametrize("fast", [False, True], ids=["exact", "fast"])


def measure(
    model: D455Model, metres: Any, fast: bool = False, value: int = 255, seed: int = 0, frames: int = 1
) -> list[Measurement]:
    """Return frames of one scene with one brightness."""
    metres = np.asarray(metres)
    camera, rng = D455Camera(model, metres.shape, fast), np.random.default_rng(seed)
    rgb = np.full((*metres.shape, 3), value, np.uint8)
    return [camera.measure(metres, rgb, rng) for _ in range(frames)]


def share(found: list[Measurement], cause: Cause, where: Any = slice(None)) -> float:
    return float(np.mean([frame.lost_to(cause)[where].mean() for frame in found]))


# ---- depth


@FORMS
@pytest.mark.parametrize("size", [NATIVE, SMALL], ids=["native", "small"])
@pytest.mark.parametrize("z", [0.4, 0.6, 0.8, 1.0, 1.25, 1.5])
def test_noise_is_that_of_the_formula(z, size, fast):
    found = measure(MODEL, np.full(size, z), fast, frames=2 if size == NATIVE else 12)
    values = np.concatenate([frame.metres[frame.causes == 0] for frame in found])
    sigma = z**2 * 0.08 / PRODUCT
    assert MODEL.sigma(z) == pytest.approx(sigma)
    assert values.std() == pytest.approx(sigma, rel=0.2)
    rounding = z**2 / (32 * PRODUCT)
    assert values.std() == pytest.approx(math.hypot(sigma, rounding / math.sqrt(12)), rel=0.04)
    assert values.mean() == pytest.approx(z, abs=0.1 * sigma)


@pytest.mark.nightly
@FORMS
@pytest.mark.parametrize("size", [NATIVE, (960, 1280)], ids=["native", "double"])
def test_noise_correlates_over_native_pixels(size, fast):
    model = replace(CLEAR, subpixel=0.08, correlation=2.0)
    error = PRODUCT / measure(model, np.full(size, 1.0), fast)[0].metres - PRODUCT
    error /= error.std()
    for lag in (1, 2, 4, 8):
        expected = math.exp(-((lag * 480 / size[0]) ** 2) / 16)
        assert (error[:, lag:] * error[:, :-lag]).mean() == pytest.approx(expected, abs=0.05)
        assert (error[lag:] * error[:-lag]).mean() == pytest.approx(expected, abs=0.05)


def test_depth_comes_in_steps_of_disparity():
    ramp = np.linspace(0.9, 1.1, SMALL[0] * SMALL[1]).reshape(SMALL)
    (found,) = measure(replace(CLEAR, disparity_step=1 / 32), ramp)
    steps = PRODUCT * 32 / found.metres.astype(np.float64)
    assert np.abs(steps - np.rint(steps)).max() < 1e-3
    assert MODEL.depth_step(0.7) == pytest.approx(0.7**2 / (32 * PRODUCT))
    assert np.abs(found.metres - ramp).max() <= 0.51 * MODEL.depth_step(1.1)


@pytest.mark.parametrize("size", [NATIVE, SMALL, (120, 120), (240, 480)])
@pytest.mark.parametrize("z", [0.35, 0.5, 1.0, 3.0])
def test_left_band_is_as_wide_as_the_disparity(z, size):
    (found,) = measure(replace(CLEAR, left_band=True), np.full(size, z))
    band = found.lost_to(Cause.LEFT_BAND)
    width = band.sum(axis=1)
    # a narrower image is a crop about the centre
    cropped = max(0, 640 - size[1] * 480 / size[0]) / 2
    assert np.abs(width - max(0, PRODUCT / z - cropped) * size[0] / 480).max() <= 0.51
    assert band[:, : width[0]].all()
    assert not found.metres[band].any()
    assert np.allclose(found.metres[~band], z)
    assert MODEL.band_width(z) == pytest.approx(PRODUCT / z)


@FORMS
def test_depths_outside_the_range_are_lost(fast):
    ramp = np.broadcast_to(np.linspace(0.05, 9, 640), NATIVE)
    (found,) = measure(replace(CLEAR, min_z=0.32, max_z=6.0), ramp, fast)
    assert np.array_equal(found.lost_to(Cause.NEAR), ramp < 0.32)
    assert np.array_equal(found.lost_to(Cause.FAR), ramp > 6)


@pytest.mark.parametrize("nothing", [0.0, -1.0, np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_what_the_clean_image_lacks_stays_missing(nothing, dtype):
    metres = np.full(SMALL, 1.0, dtype)
    metres[50:70, 100:120] = nothing
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (found,) = measure(MODEL, metres)
    missing = np.isin(found.causes & Cause.MISSING, Cause.MISSING)
    assert np.array_equal(missing, metres != 1)
    assert not (found.causes & Cause.FAR).any()
    assert found.lost_to(Cause.EDGE).any(), "an object before nothing has an edge"
    assert np.array_equal(found.metres == 0, found.causes != 0)


# ---- holes by cause


@FORMS
@pytest.mark.parametrize("size", [NATIVE, SMALL], ids=["native", "small"])
@pytest.mark.parametrize("value", [0, 20, 50, 79, 80, 200])
def test_dark_surfaces_lose_their_share(value, size, fast):
    found = measure(MODEL, np.full(size, 1.0), fast, value, frames=3 if size == NATIVE else 12)
    designed = 0.8 * max(0, 1 - value / 80)
    assert MODEL.dark_probability(value) == pytest.approx(designed)
    assert share(found, Cause.DARK) == pytest.approx(designed, rel=0.05, abs=1 / 255)


@FORMS
@pytest.mark.parametrize("colour", [(10, 10, 200), (200, 0, 0), (0, 90, 0)])
def test_strong_colours_are_not_dark(colour, fast):
    camera = D455Camera(MODEL, SMALL, fast)
    rgb = np.broadcast_to(np.array(colour, np.uint8), (*SMALL, 3))
    found = camera.measure(np.full(SMALL, 1.0), rgb, np.random.default_rng(0))
    assert not found.lost_to(Cause.DARK).any()


@FORMS
@pytest.mark.parametrize("size", [NATIVE, SMALL], ids=["native", "small"])
def test_speckle_takes_its_share_in_blobs(size, fast):
    model = replace(CLEAR, speckle_share=0.01)
    found = measure(model, np.full(size, 1.0), fast, frames=10 if size == NATIVE else 100)
    assert share(found, Cause.SPECKLE) == pytest.approx(0.01, rel=0.1)
    if size == NATIVE:
        lost = np.stack([frame.lost_to(Cause.SPECKLE) for frame in found])
        paired = (lost[:, :, 1:] & lost[:, :, :-1]).sum() / lost.sum()
        assert paired > 0.5, "single pixels"


@FORMS
@pytest.mark.parametrize("rows", [84, 120, 480, 960])
def test_pixels_next_to_a_jump_lose_their_share(rows, fast):
    size = (rows, rows * 4 // 3)
    reach, probability = MODEL.edge_reach(rows)
    assert reach * probability == pytest.approx(0.3 * 2 * rows / 480, rel=0.01)
    period = 12 * reach
    column = np.arange(size[1]) % period
    steps = np.broadcast_to(np.where(column < period // 2, 0.8, 0.6), size)
    apart = np.minimum(column % (period // 2), (-1 - column) % (period // 2))
    inner = (np.arange(size[1]) >= reach) & (np.arange(size[1]) < size[1] - reach)  # no step at the border
    near = np.broadcast_to((apart < reach) & inner, size)
    far = np.broadcast_to(apart >= reach, size)
    found = measure(replace(CLEAR, edge_share=0.3), steps, fast, frames=max(2, 5000 // rows))
    assert share(found, Cause.EDGE, near) == pytest.approx(probability, rel=0.06)
    assert share(found, Cause.EDGE, far) == 0


@pytest.mark.parametrize("size", [(84, 84), NATIVE])
def test_steep_slopes_are_no_jumps(size):
    v, u = np.mgrid[: size[0], : size[1]] * (480 / size[0]) / 386
    for slope in ((1.5, 0), (0, -1.5), (1, 1)):  # of a plane z = 1 + a x + b y
        plane = 1 / np.maximum(1 - slope[0] * (u - u.mean()) - slope[1] * (v - v.mean()), 0.1)
        (found,) = measure(replace(CLEAR, edge_share=1), plane)
        assert not found.lost_to(Cause.EDGE)[1:-1, 1:-1].any()
    # a rope of 16 mm on a table at 0.56 m is no slope, and its table is none either
    (found,) = measure(replace(CLEAR, edge_share=1), np.where(np.abs(v - v.mean()) < 0.02, 0.544, 0.56))
    assert found.lost_to(Cause.EDGE).any(axis=1).sum() == 4 * MODEL.edge_reach(size[0])[0]


# ---- colour


@FORMS
@pytest.mark.parametrize("value", [20, 100, 220])
def test_colour_noise_grows_with_brightness(value, fast):
    camera, rng = D455Camera(replace(MODEL, read=2.0, shot=0.05), SMALL, fast), np.random.default_rng(0)
    rgb = np.full((*SMALL, 3), value, np.uint8)
    error = np.stack([camera.colour(rgb, Light(), rng) for _ in range(5)]).astype(float) - value
    assert error.var() == pytest.approx(2**2 + 0.05 * value + 1 / 12, rel=0.03)
    assert abs(error.mean()) < 0.05


@FORMS
def test_gains_are_those_of_the_light(fast):
    camera, rng = D455Camera(replace(MODEL, read=0, shot=0), SMALL, fast), np.random.default_rng(0)
    light = Light(episode=(math.log(1.2), math.log(0.9), 0.0), wander=(0.0, 0.0, math.log(1.1)))
    assert light.gains == pytest.approx((1.08, 1.2, 1.32))
    rgb = np.broadcast_to(np.array([50, 100, 150], np.uint8), (*SMALL, 3))
    assert np.array_equal(np.unique(camera.colour(rgb, light, rng).reshape(-1, 3), axis=0), [[54, 120, 198]])
    bright = camera.colour(np.full((*SMALL, 3), 250, np.uint8), light, rng)
    assert (bright == 255).all(), "no wrap-around"
    noisy = D455Camera(replace(MODEL, read=20), SMALL, fast)
    for value in (0, 255):
        picture = noisy.colour(np.full((*SMALL, 3), value, np.uint8), Light(), rng)
        assert np.abs(picture.astype(int) - value).max() < 120, "no wrap-around"


def test_light_is_drawn_for_an_episode_and_wanders_in_it():
    model, rng = replace(MODEL, exposure=0.1, white_balance=0.05, drift=0.5, drift_frames=20), np.random.default_rng(0)
    start = [Light.draw(model, rng) for _ in range(4000)]
    assert np.std([light.episode for light in start], axis=0) == pytest.approx([0.1, 0.05, 0.05], rel=0.05)
    assert np.std([light.wander for light in start], axis=0) == pytest.approx([0.05, 0.025, 0.025], rel=0.05)
    walks = []
    for light in start[:1000]:
        walk = [light]
        for _ in range(20):
            walk.append(walk[-1].later(model, rng))
        assert all(later.episode == light.episode for later in walk)
        walks.append([later.wander for later in walk])
    wander = np.array(walks)
    assert wander[:, -1].std(axis=0) == pytest.approx([0.05, 0.025, 0.025], rel=0.1)
    assert np.corrcoef(wander[:, 0, 0], wander[:, -1, 0])[0, 1] == pytest.approx(math.exp(-1), abs=0.1)
    assert Light.draw(CLEAR, rng).later(CLEAR, rng) == Light()


def test_bad_images():
    camera, rng, rgb = D455Camera(MODEL, SMALL), np.random.default_rng(0), np.zeros((*SMALL, 3), np.uint8)
    with pytest.raises(ValueError, match=r"metres: expected \(120, 160\) floats, got \(120, 160\) uint16. Divide"):
        camera.measure(np.full(SMALL, 700, np.uint16), rgb, rng)
    with pytest.raises(ValueError, match=r"rgb: expected \(120, 160, 3\) uint8, got \(84, 84, 3\) uint8"):
        camera.colour(np.zeros((84, 84, 3), np.uint8), Light(), rng)
    with pytest.raises(ValueError, match=r"size: expected \(height, width\) in pixels, .* got \(120,\)"):
        D455Camera(MODEL, (120,))


# ---- the wrapper: spaces, seeds, rebuilding, and detection through the noise


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
    assert not np.array_equal(bare.reset(seed=0)[0], bare.env.reset(seed=0)[0])
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
        ({"model": {"width": 640.5}}, r"D455Model.width: expected int, got 640.5"),
        ({"model": {"min_z": 1, "max_z": 0.5}}, r"max_z: expected metres above min_z, .* got 0.5 with min_z 1.0"),
        ({"fast": "yes"}, r"fast: expected True or False, got 'yes'"),
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
    with pytest.raises(ValueError, match="makes uint16"):
        D455Noise(Images(np.full(SMALL, 700, np.int16), 32767))


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
