"""The ring environment against its own ground truth."""

from __future__ import annotations

from typing import Any, cast

import cv2
import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("mujoco")

import shape_obs_envs  # noqa: F401
from shape_obs_envs.mujoco.cameras.gl_camera import GLUnavailableError
from shape_obs_envs.mujoco.ring import RingEnv


def make(**options: Any) -> RingEnv:
    return cast(RingEnv, gym.make("ShapeObs/Ring-v0", **{"camera": [84, 84], "renderer": "rays", **options}).unwrapped)


def bent(env: RingEnv, seeds: int = 4):
    """Bend the ring into a few shapes, and yield the seed of each."""
    rng = np.random.default_rng(0)
    for seed in range(seeds):
        env.reset(seed=seed)
        action = rng.uniform(-1, 1, 6)
        for _ in range(12):
            env._move(action)
        yield seed


def blue(env: RingEnv, rgb: np.ndarray) -> np.ndarray:
    rule = env.shape_obs_defaults["segmentation"]
    return cv2.inRange(cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV), np.array(rule["low"]), np.array(rule["high"])) > 0


@pytest.fixture(scope="module")
def episodes():
    """Return true outlines (T, 200, 3), hinges (T, links, 3) and the lengths of the band's links over 8 episodes."""
    env = make(render_observation=False)
    rng = np.random.default_rng(0)
    outlines, axes = [], []
    action = np.zeros(6, np.float32)
    for seed in range(8):
        env.reset(seed=seed)
        for step in range(50):
            if step % 8 == 0 or seed % 2:  # held, or white noise
                action = rng.uniform(-1, 1, 6).astype(np.float32)
            env.step(action)
            axes.append(env._loop.axis())
            if step % 10 == 9:
                outlines.append(env.truth(200))
    return np.array(outlines), np.array(axes), env._loop.spec


def test_the_band_keeps_its_length(episodes):
    outlines, axes, spec = episodes
    links = np.linalg.norm(np.roll(axes, -1, axis=1) - axes, axis=2)
    assert links.sum(axis=1).max() < 1.001 * spec.length
    # Where it is closed: 0.8 % of a link with MuJoCo 4.0, 2.7 % with 3.3, less than a thousandth of the band.
    assert links.max() < 1.04 * spec.link_length
    around = np.linalg.norm(np.roll(outlines, -1, axis=1) - outlines, axis=2).sum(axis=1)
    # once around a closed band: its middle, and pi times its width more
    assert np.allclose(around, spec.length + np.pi * spec.width, rtol=0.01)


def test_its_sides_never_touch(episodes):
    _, axes, spec = episodes
    count = axes.shape[1]
    apart = np.abs(np.arange(count)[:, None] - np.arange(count))
    far = np.minimum(apart, count - apart) > 4
    closest = min(np.linalg.norm(axis[:, None] - axis, axis=2)[far].min() for axis in axes)
    assert closest > 2 * spec.width


def test_truth_is_equidistant_and_clockwise_from_gripper0():
    env = make(render_observation=False)
    for _ in bent(env):
        points = env.truth(64)
        gaps = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
        assert gaps.std() / gaps.mean() < 0.01
        assert np.allclose(points[0], env.anchors["gripper0"], atol=1e-9)
        assert np.linalg.norm(points[32] - env.anchors["gripper1"]) < 0.06
        assert np.allclose(env.truth(32), points[::2], atol=1e-9)
        assert np.allclose(points[:, 2], 0.004)
        camera = env.camera_model
        assert np.allclose(camera.to_base(env.truth(9, frame="camera")), env.truth(9))
        pixels = env.truth(64, frame="pixels")
        after = np.roll(pixels, -1, axis=0)
        # v is down: a positive area is clockwise as seen
        assert (pixels[:, 0] * after[:, 1] - after[:, 0] * pixels[:, 1]).sum() > 0


@pytest.mark.parametrize("renderer", ["rays", "gl"])
def test_the_picture_is_the_true_band(renderer):
    env = make(camera="d455", renderer=renderer)
    try:
        env.reset(seed=0)
    except GLUnavailableError:
        pytest.skip("there is no OpenGL here")
    camera = env.camera_model
    for _ in bent(env):
        rgb, depth = env._rendering.capture(env._body)
        mask = blue(env, rgb)
        filled = np.zeros(mask.shape, np.uint8)
        cv2.fillPoly(filled, [np.rint(env.truth(400, frame="pixels") * 16).astype(np.int32)], 1, shift=4)
        assert np.count_nonzero(mask & (filled == 0)) < 0.02 * mask.sum()  # half a pixel along the edge
        near = cv2.dilate(mask.astype(np.uint8), np.ones((5, 5)))
        hole = cv2.connectedComponents((near == 0).astype(np.uint8))[1]
        assert len(np.unique(hole[near == 0])) == 2  # outside and inside
        v, u = np.nonzero(cv2.erode(mask.astype(np.uint8), np.ones((3, 3))))
        points = camera.to_base(camera.intrinsics.deproject(np.stack([u, v], axis=1), depth[v, u]))
        assert np.abs(points[:, 2] - 0.004).max() < 5e-4
    env.close()


@pytest.mark.parametrize(("camera", "most"), [("d455", 0.002), ("rl", 0.003)])
def test_the_wrapper_sees_the_true_outline(camera, most):
    env = gym.make("ShapeObs/RingShape-v0", camera=camera, renderer="rays")
    rng = np.random.default_rng(0)
    errors, slips, action = [], 0, np.zeros(6, np.float32)
    for seed in range(3):
        observation, info = env.reset(seed=seed)
        for step in range(25):
            if step % 8 == 0:
                action = rng.uniform(-1, 1, 6).astype(np.float32)
            observation, _, _, _, info = env.step(action)
            assert info["shape/ok"]
            found, truth = observation["achieved_goal"].reshape(-1, 3), info["truth/points"]
            errors.append(np.linalg.norm(found - truth, axis=1).mean())
            gap = np.linalg.norm(truth[1] - truth[0])
            slips += np.linalg.norm(found - truth, axis=1).max() > 0.5 * gap
    assert np.mean(errors) < most
    assert slips == 0
