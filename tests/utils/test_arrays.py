"""Returned arrays share no memory with later results, and argument arrays are not kept."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from rope_env import RopeEnv, wrapped

from shape_obs import Centerline, Contour, Intrinsics, Shape, ShapeDetector, ShapeGoal, Target
from shape_obs.geometry.topology import Chain

ARRAYS = ("points2d", "points3d", "visible", "valid", "sigma")
INTRINSICS = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)


def arrays(shape: Shape) -> dict[str, np.ndarray]:
    return {name: getattr(shape, name) for name in ARRAYS if getattr(shape, name) is not None}


def values(shape: Shape) -> tuple[Any, ...]:
    return *(array.tobytes() for array in arrays(shape).values()), shape.ok, shape.quality, shape.reason, shape.age


@pytest.fixture
def depth(wave):
    return np.full(wave.mask.shape, 700, np.uint16)


@pytest.fixture
def detector():
    return ShapeDetector([Centerline(n=9), Contour(n=12)], on_invalid="hold")


def frames(mask: np.ndarray) -> Iterator[np.ndarray]:
    """Yield masks of a rope that moves, is partly hidden, disappears and returns."""
    for shift, hidden in ((0, 0), (2, 0), (4, 60), (5, 60), (5, 400), (6, 400), (6, 0), (7, 0)):
        moved = np.roll(mask, shift, axis=0)
        moved[:, 320 - hidden :] = 0
        yield moved


def test_the_arrays_of_a_shape_are_read_only(detector, wave, depth):
    cloud = np.random.default_rng(0).normal(0, 0.005, (500, 3)) + np.linspace((0, 0, 0.7), (0.6, 0.1, 0.7), 500)
    found = [*detector.detect_mask(wave.mask, depth, INTRINSICS), *detector.detect_mask(np.zeros_like(wave.mask))]
    for shape in [*found, *detector.detect_cloud(cloud)]:
        for name, array in arrays(shape).items():
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 0
            with pytest.raises(ValueError, match="cannot set WRITEABLE flag"):
                array.T.flags.writeable = True  # nor through a view
            assert array.copy().flags.writeable, name


def test_a_shape_copies_the_arrays_that_it_is_made_of():
    pixels, metres, flags = np.zeros((3, 2), np.float32), np.zeros((3, 3), np.float32), np.ones(3, bool)
    sigma = np.ones(3, np.float32)
    shape = Shape("mine", pixels, metres, flags, flags, Chain(3), sigma=sigma)
    for mine, array in zip((pixels, metres, flags, flags, sigma), arrays(shape).values(), strict=True):
        assert mine.flags.writeable
        assert not np.shares_memory(mine, array)
    assert Shape("exact", pixels, metres, flags, flags, Chain(3)).sigma.tolist() == [0, 0, 0]
    rows = np.zeros((2, 3, 2))
    for array in (rows[0], np.broadcast_to(rows[0], (3, 2))):  # a view, writable or not, is no owner
        assert not np.shares_memory(rows, Shape("mine", array, None, flags, flags, Chain(3)).points2d)


def test_later_frames_change_no_shape_and_no_shape_keeps_a_frame(detector, wave, depth):
    seen = [(shape, values(shape)) for mask in frames(wave.mask) for shape in detector.detect_mask(mask, depth)]
    for shape, before in seen:
        assert values(shape) == before
        assert not any(np.shares_memory(array, depth) for array in arrays(shape).values())


@pytest.mark.parametrize("again", [copy.deepcopy, copy.copy, lambda shape: pickle.loads(pickle.dumps(shape))])
def test_a_copied_or_unpickled_shape_is_read_only_and_equal(detector, wave, depth, again):
    detection = detector.detect_mask(wave.mask, depth, INTRINSICS)
    for shape, other in zip(detection, [again(shape) for shape in detection], strict=True):
        assert values(other) == values(shape)
        assert type(other.layout) is type(shape.layout)
        assert not any(array.flags.writeable for array in arrays(other).values())
    if again is not copy.copy:
        mine = {"shape": detection["contour"], "points": detection["contour"].points2d}
        other = again(mine)
        assert not (other["points"].flags.writeable and np.shares_memory(other["points"], other["shape"].points2d))


@pytest.mark.parametrize("again", [copy.deepcopy, lambda detector: pickle.loads(pickle.dumps(detector))])
def test_a_copied_detector_goes_on_identically_and_shares_nothing(detector, wave, depth, again):
    masks = list(frames(wave.mask))
    for split in (3, 5):  # while the rope is in sight, and while it is held
        detector.reset()
        for mask in masks[:split]:
            detector.detect_mask(mask, depth, INTRINSICS)
        other = again(detector)
        for mask in masks[split:]:
            pair = detector.detect_mask(mask, depth, INTRINSICS), other.detect_mask(mask, depth, INTRINSICS)
            for mine, its in zip(*pair, strict=True):
                assert values(mine) == values(its)
                assert not any(array.flags.writeable for array in arrays(its).values())


@pytest.mark.parametrize("lift", ["points", "cloud"])
def test_a_caller_may_reuse_its_buffers(wave, lift):
    """A camera driver writes each frame into the same memory."""
    options: dict[str, Any] = {"lift": lift, "segmentation": {"kind": "gray", "low": 100, "min_area": 1}}
    shapes = [Centerline(n=9, **options), Contour(n=12, **options)]
    first, second = (ShapeDetector(shapes, on_invalid="hold") for _ in range(2))
    rgb, depth = np.empty((240, 320, 3), np.uint8), np.empty((240, 320), np.float32)
    mask = np.empty((240, 320), np.uint8)
    for at, moved in enumerate(frames(wave.mask)):
        image, distance = np.repeat(moved[..., None], 3, axis=2), np.full((240, 320), 0.7 + 0.01 * at, np.float32)
        distance[:, 100:120] = 0
        rgb[:], depth[:], mask[:] = image, distance, moved
        calls = ((image, rgb), (moved, mask))[at % 2]
        call = ("detect", "detect_mask")[at % 2]
        fresh = getattr(first, call)(calls[0], distance, INTRINSICS)
        reused = getattr(second, call)(calls[1], depth, INTRINSICS)
        rgb[:], depth[:], mask[:] = 77, 9.9, 1
        assert [values(shape) for shape in reused] == [values(shape) for shape in fresh]


def memory(value: Any) -> Iterator[np.ndarray]:
    """Yield all arrays in a nested value."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, dict):
        for item in value.values():
            yield from memory(item)
    elif isinstance(value, gym.spaces.Dict):
        for space in value.spaces.values():
            yield from memory(space)
    elif isinstance(value, gym.spaces.Box):
        yield from (value.low, value.high)


GOAL = Target(((0.0, 0.0, 0.5), (0.1, 0.02, 0.5), (0.2, 0.0, 0.5)), "camera", layout={"kind": "centerline"})


@pytest.mark.parametrize(
    "make",
    [
        lambda hide: wrapped(RopeEnv(hide)),
        lambda hide: wrapped(RopeEnv(hide), keep=["hand", "deep"], features=["points3d", "ok"]),
        lambda hide: ShapeGoal(wrapped(RopeEnv(hide)), GOAL),
    ],
    ids=["vector", "kept", "goal"],
)
@pytest.mark.parametrize("hide", [(), (0, 1, 2, 3, 4)], ids=["seen", "never seen"])
def test_observations_are_writable_and_share_memory_with_nothing(make, hide):
    """Writing -1e9 into everything that was returned changes nothing that is returned later."""
    spoilt, other = make(hide), make(hide)
    bounds = list(memory(spoilt.observation_space))
    earlier: list[np.ndarray] = []
    for step in range(6):
        both = [env.reset(seed=3) if not step else env.step(np.zeros(1, np.float32))[::4] for env in (spoilt, other)]
        for mine, its in zip(*(list(memory(list_of(result))) for result in both), strict=True):
            np.testing.assert_array_equal(mine, its)
            assert mine.flags.writeable
            assert not any(np.shares_memory(mine, array) for array in earlier + bounds)
            earlier.append(mine)
        for array in memory(list_of(both[0])):
            array[...] = -1e9
        within = spoilt.get_wrapper_attr("detection")
        assert not any(np.shares_memory(array, mine) for shape in within for array in arrays(shape).values()
                       for mine in earlier)  # fmt: skip


def list_of(result: Any) -> dict[str, Any]:
    observation, info = result
    return {"observation": observation, "info": info}
