"""Images of an env wherever they are and however they lie, and what breaks the promise of its space."""

from __future__ import annotations

import json
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from rope_env import RopeEnv, run, walk, wrapped

from shape_obs import GrayRange, ShapeObservation
from shape_obs.wrappers.env_images import Images
from shape_obs_envs.d455 import D455Noise

COLOUR_AND_DEPTH = np.tile(np.array([1, 1, 1, 9], np.float32), (9, 9, 1))  # the upper bounds of four channels
RGB, DEPTH = spaces.Box(0, 255, (120, 160, 3), np.uint8), spaces.Box(0.0, 10.0, (120, 160), np.float32)


def changed(take: Any, space: spaces.Space[Any]) -> gym.Env[Any, Any]:
    """Return the rope's env with another observation."""
    return gym.wrappers.TransformObservation(RopeEnv(), take, space)


def floats(rgb: np.ndarray) -> np.ndarray:
    return (rgb / 255).astype(np.float32)


def unit(*shape: int) -> spaces.Box:
    return spaces.Box(0, 1, shape, np.float32)


def byte(*shape: int) -> spaces.Box:
    return spaces.Box(0, 255, shape, np.uint8)


IMAGES = spaces.Dict({"rgb": RGB, "depth": DEPTH})
NESTED = spaces.Dict({"images": IMAGES, "hand": spaces.Box(-5.0, 5.0, (3,), np.float32)})


@pytest.mark.parametrize("key", [("images", "rgb"), ["images", "rgb"], "images/rgb"])
def test_nested_images_are_read_and_the_spec_rebuilds_the_wrapper(key):
    nested = lambda seen: {"images": {name: seen[name] for name in ("rgb", "depth")}, "hand": seen["hand"]}  # noqa: E731
    env = wrapped(changed(nested, NESTED), rgb_key=key, keep=["hand"])
    assert env._saved_kwargs["rgb_key"] == (key if isinstance(key, str) else list(key))
    for mine, its in zip(run(env), run(wrapped(keep=["hand"])), strict=True):
        np.testing.assert_array_equal(mine[0]["shape"], its[0]["shape"])
    noisy = wrapped(D455Noise(changed(nested, NESTED), rgb_key=key), rgb_key=key)
    assert noisy.reset(seed=0)[1]["shape/ok"]
    json.dumps(env._saved_kwargs)


@pytest.mark.parametrize(
    ("rgb", "space", "depth", "deep"),
    [
        (lambda rgb: rgb.transpose(2, 0, 1), byte(3, 120, 160), lambda z: z[None], (1, 120, 160)),
        (lambda rgb: np.dstack([rgb, rgb[..., :1]]), byte(120, 160, 4), lambda z: z[..., None], (120, 160, 1)),
        (lambda rgb: floats(rgb).transpose(2, 0, 1)[None], unit(1, 3, 120, 160), lambda z: z[None], (1, 120, 160)),
        (floats, unit(120, 160, 3), lambda z: np.ma.masked_less(z, 0.1), (120, 160)),
        (lambda rgb: rgb.astype(np.float32), spaces.Box(0, 255, (120, 160, 3), np.float32), lambda z: z, (120, 160)),
        (lambda rgb: rgb.astype(np.int64), spaces.Box(0, 255, (120, 160, 3), np.int64), lambda z: z, (120, 160)),
    ],
)
def test_other_layouts_give_the_same_points(rgb, space, depth, deep):
    both = spaces.Dict({"rgb": space, "depth": spaces.Box(0.0, 10.0, deep, np.float64)})
    env = changed(lambda seen: {"rgb": rgb(seen["rgb"]), "depth": depth(seen["depth"].astype(np.float64))}, both)
    for mine, its in zip(run(wrapped(env)), run(wrapped()), strict=True):
        np.testing.assert_array_equal(mine[0], its[0])
    images, seen = Images.find(both), env.reset(seed=0)[0]
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(images)).read(seen)[0], images.read(seen)[0])


@pytest.mark.parametrize("shape", [(120, 160), (120, 160, 1), (1, 120, 160)])
def test_a_gray_image_is_read_as_colours_without_saturation(shape):
    gray = lambda seen: np.where(seen["rgb"][..., 2] == 200, 0, 255).astype(np.uint8).reshape(shape)  # noqa: E731
    env = ShapeObservation(changed(gray, byte(*shape)), segmentation=GrayRange(high=100))
    assert env.reset(seed=0)[1]["shape/ok"]


@pytest.mark.parametrize(
    ("space", "arguments", "hint"),
    [
        (NESTED, {}, "Known: .*images/rgb"),
        (NESTED, {"rgb_key": "images"}, "keys on the way to the image, one of images/depth, images/rgb"),
        (spaces.Dict({"rgb": byte(4, 120, 160, 3)}), {}, "stacked frames"),
        (spaces.Dict({"rgb": byte(120, 160, 12)}), {}, "stacked frames"),
        (spaces.Dict({"rgb": spaces.Box(-1, 1, (120, 160, 3))}), {}, "TransformObservation"),
        (spaces.Dict({"rgb": spaces.Box(0, 1, (120, 160, 3), np.uint8)}), {}, "TransformObservation"),
        (
            spaces.Dict({"rgb": spaces.Box(0, COLOUR_AND_DEPTH)}),
            {},
            "its own key",
        ),
        (spaces.Dict({"rgb": spaces.Box(-np.inf, np.inf, (4, 2))}), {}, "AddRenderObservation"),
        (RGB, {"rgb_key": "rgb"}, "leave rgb_key out"),
        (
            spaces.Dict({"rgb": RGB, "depth": spaces.Box(0, 9, (60, 80))}),
            {"depth_key": "depth"},
            "as large as the RGB image",
        ),
        (spaces.Dict({"rgb": RGB, "z": spaces.Box(0, 9, (120, 160), np.int32)}), {"depth_key": "z"}, "uint16"),
    ],
)
def test_what_is_no_image_is_refused_with_the_remedy(space, arguments, hint):
    with pytest.raises(ValueError, match=hint):
        wrapped(changed(lambda seen: seen, space), **arguments)


@pytest.mark.parametrize("keys", [(0, 1), ("0", "1"), ((0,), (1,))])
def test_images_in_a_tuple_have_numbers(keys):
    env = changed(lambda seen: (seen["rgb"], seen["depth"]), spaces.Tuple((RGB, DEPTH)))
    env = wrapped(env, rgb_key=keys[0], depth_key=keys[1], features=["points3d"])
    np.testing.assert_array_equal(env.reset(seed=0)[0], wrapped(features=["points3d"]).reset(seed=0)[0])


def test_an_axis_of_length_one_may_be_missing_in_the_space():
    env = wrapped(changed(lambda seen: {**seen, "rgb": seen["rgb"][None], "depth": seen["depth"][..., None]}, IMAGES))
    assert env.reset(seed=0)[1]["shape/ok"]


def test_a_depth_that_is_no_image_is_a_number_of_the_env():
    space = spaces.Dict({"rgb": RGB, "depth": spaces.Box(0, 1, (1,))})
    env = wrapped(changed(lambda seen: {"rgb": seen["rgb"], "depth": np.zeros(1, np.float32)}, space))
    assert env.reset(seed=0)[0].shape == (40,)


@pytest.mark.parametrize("space", [RGB, spaces.Box(0, 9, (60, 80)), spaces.Box(0, 9, (120, 160), np.int32)])
def test_a_neighbour_that_is_no_depth_of_the_image_is_left_out(space):
    with pytest.warns(UserWarning, match="depth is left out: .*as large as the RGB image"):
        env = wrapped(changed(lambda seen: {"rgb": seen["rgb"]}, spaces.Dict({"rgb": RGB, "depth": space})))
    assert env.reset(seed=0)[1]["shape/ok"]


def test_depth_of_int16_is_read_in_millimetres():
    def first(dtype: Any) -> Any:
        depth = lambda z: (1000 * z).astype(dtype)[None, ..., None]  # noqa: E731
        space = spaces.Dict({"rgb": RGB, "depth": spaces.Box(0, 32767, (1, 120, 160, 1), dtype)})
        env = changed(lambda seen: {"rgb": seen["rgb"], "depth": depth(seen["depth"])}, space)
        return wrapped(env, features=["points3d"]).reset(seed=0)[0]

    np.testing.assert_array_equal(first(np.int16), first(np.uint16))


@pytest.mark.parametrize(
    ("change", "hint"),
    [
        ({"rgb": lambda rgb: rgb[::2, ::2]}, "promises"),
        ({"rgb": floats}, "promises"),
        ({"rgb": lambda rgb: rgb.transpose(2, 0, 1)}, "promises"),
        ({"rgb": lambda rgb: rgb.tolist()}, "the image is list"),
        ({"rgb": lambda rgb: np.ma.masked_equal(rgb, 30)}, "mask"),
        ({"depth": lambda z: (1000 * z).astype(np.uint16)}, "promises"),
        ({"depth": lambda z: z[:60]}, "promises"),
        ({"hand": lambda hand: hand[:2]}, "promises observation.'hand'"),
        ({"phase": str}, "promises observation.'phase'. in Discrete"),
        ({"hand": lambda hand: hand * np.nan}, "NaN"),
    ],
)
def test_an_observation_that_breaks_the_promise_of_its_space_is_refused(change, hint):
    take = lambda seen: {key: change.get(key, lambda value: value)(value) for key, value in seen.items()}  # noqa: E731
    env = wrapped(
        changed(take, RopeEnv().observation_space), keep=["hand", "phase", "deep"], features=["points2d_normalized"]
    )
    with pytest.raises(ValueError, match=hint):
        next(walk(env))


@pytest.mark.parametrize(
    ("take", "message"),
    [
        (lambda seen: (seen, {}), "it is a tuple"),
        (lambda seen: None, "it is a NoneType"),
        (lambda seen: {**seen, "deep": {}}, "has no 'row', but its space does"),
    ],
)
def test_what_an_observation_lacks_is_named(take, message):
    env = wrapped(changed(take, RopeEnv().observation_space), keep=["deep"])
    with pytest.raises(KeyError, match=message):
        env.reset(seed=0)


@pytest.mark.parametrize(("high", "factor"), [(1, 255), (1, 2.1), (1, -1), (255, 3), (1, np.nan)])
def test_floats_on_another_scale_than_their_space_are_refused(high, factor):
    space = spaces.Box(0, high, (120, 160, 3), np.float32)
    env = changed(lambda seen: (high * factor * floats(seen["rgb"] | 255)).astype(np.float32), space)
    with pytest.raises(ValueError, match="promises values from 0 to"):
        next(walk(wrapped(env)))


def test_fractions_up_to_one_in_a_space_up_to_255_are_named_once():
    images = Images.find(spaces.Box(0, 255, (9, 9, 3), np.float32))
    for level in (0.5, 1):
        images.read(np.full((9, 9, 3), level, np.float32))
    with pytest.warns(UserWarning, match="fractions up to 1") as caught:
        assert [images.read(np.full((9, 9, 3), 0.9, np.float32))[0].max() for _ in range(2)] == [1, 1]
    assert len(caught) == 1


@pytest.mark.parametrize(
    ("high", "values", "bytes_"),
    [
        (1, (-0.1, 1.1), (0, 255)),
        (1, (-1e-7, 1.000001), (0, 255)),
        (255, (0.4, 0.4), (0, 0)),
        (255, (-20, 280), (0, 255)),
    ],
)
def test_floats_a_little_beyond_their_space_are_clipped_and_a_dark_image_is_read(high, values, bytes_):
    image = np.full((120, 160, 3), values[0], np.float32)
    image[60:] = values[1]
    seen = Images.find(spaces.Box(0, high, image.shape, np.float32)).read(image)[0]
    assert (seen[0, 0, 0], seen[-1, 0, 0]) == bytes_
