"""Images under domain randomisation: compared with each other, with the truth, and with what a detector finds."""

from __future__ import annotations

from typing import Any, cast

import cv2
import numpy as np
import pytest

pytest.importorskip("mujoco")

from randomized import ENVS, SINGLE, make, play  # pyright: ignore[reportMissingImports]
from simulator_gl import needs_gl

from shape_obs import ShapeObservation

OFTEN = {"hand": {"probability": 1.0, "latest": 0, "speed": [0.2, 0.2]}, "distractors": {"most": 8}}


def near_an_edge(*pictures: np.ndarray, least: int = 25) -> np.ndarray:
    """Return the mask (H, W) of pixels near which, within two pixels, a picture changes by more than `least`."""
    out = np.zeros(pictures[0].shape[:2], bool)
    for picture in pictures:
        change = cv2.morphologyEx(picture, cv2.MORPH_GRADIENT, np.ones((5, 5), np.uint8))
        out |= change.reshape(*out.shape, -1).max(axis=2) > least
    return out


@pytest.mark.nightly
@needs_gl
@pytest.mark.parametrize("name", ENVS)
@pytest.mark.parametrize("camera", ["rl", "d455"])
def test_gl_and_rays_agree(name, camera):
    envs = [make(name, OFTEN, renderer=renderer, camera=camera) for renderer in ("gl", "rays")]
    for seed in range(3 if camera == "rl" else 1):
        for one, two in list(zip(*(play(env, seed, 5) for env in envs), strict=True))[::5]:
            apart = np.abs(one["rgb"].astype(int) - two["rgb"]).max(axis=2)
            depths = [observation["depth"].astype(np.uint16) for observation in (one, two)]
            inner = ~near_an_edge(one["rgb"], two["rgb"], *depths)
            assert inner.mean() > 0.02  # of a fine pattern little is left
            assert apart[inner].max() <= 30
            assert (apart > 30).mean() < 0.01
            level = ~near_an_edge(*depths, least=10)  # OpenGL's balls have corners
            lowest_edge = 8 if name == "Cables" else 5  # the rim of a rope that lies on another one is as low
            assert np.abs(depths[0].astype(int) - depths[1])[level].max() <= lowest_edge
    for env in envs:
        env.close()


@pytest.mark.parametrize("name", ENVS)
@pytest.mark.parametrize("camera", [[84, 84], "rl"])
def test_the_workspace_stays_in_view(name, camera):
    strong = {"others": False, "camera": {"tilt": 0.2, "turn": 0.4, "aim": 0.03, "roll": 0.1}}
    env = make(name, strong, camera=camera, render_observation=False)
    poses = []
    corners = np.array(np.meshgrid(*zip(*env.REACH, strict=True))).reshape(3, -1).T
    for seed in range(20):
        play(env, seed, 0)
        model = env.camera_model
        pixels, size = model.project_from_base(corners), (model.intrinsics.width, model.intrinsics.height)
        assert pixels.min() > -0.5
        assert (pixels < np.array(size) - 0.5).all()
        assert model.transform_camera_to_base is not None
        poses.append(model.transform_camera_to_base)
        aim = env.randomization["camera"]["aim"]
        assert np.allclose(model.project_from_base(np.array([aim])), (np.array(size) - 1) / 2, atol=1e-6)
    assert np.ptp(np.array(poses)[:, 2, 3]) > 0.03


def test_shown_pictures_follow_too():
    env = make("Cable", {"others": False, "table": True}, render_mode="rgb_array", render_size="rl")
    shown = []
    for seed in range(2):
        play(env, seed, 0)
        shown.append(cast(np.ndarray, env.render()).astype(int))
    assert np.abs(shown[0] - shown[1]).mean() > 10


# ---- what a detector finds in them


@pytest.mark.parametrize("name", SINGLE)
def test_the_wrapper_keeps_working(name):
    raw = make(name, camera="rl", renderer="auto")
    env, goal = ShapeObservation(raw), raw._goal_points().astype(np.float32)
    ok, errors = [], []
    for seed in range(2):
        held = np.random.default_rng(seed).uniform(-1, 1, (3, *(raw.action_space.shape or ()))).astype(np.float32)
        env.reset(seed=seed, options={"goal": goal})
        for step in range(20):
            *_, info = env.step(held[step // 8])
            ok.append(info["shape/ok"])
            assert env.detection is not None
            points = env.detection.shapes[0].points3d
            if ok[-1] and points is not None and getattr(raw, "unfolded", True):
                errors.append(np.linalg.norm(raw.camera_model.to_base(points) - raw.truth(), axis=1).mean())  # type: ignore[attr-defined]
    assert np.mean(ok) > 0.9
    assert 1000 * np.mean(errors) < (12 if name == "Cloth" else 8)


@pytest.mark.parametrize("name", ENVS)
def test_the_rule_of_colours_finds_the_object_and_nothing_else(name):
    env = make(name, camera="rl")
    rule = env.shape_obs_defaults["segmentation"]  # type: ignore[attr-defined]
    low, high = np.array(rule["low"], np.uint8), np.array(rule["high"], np.uint8)
    for seed in range(3):
        observation = play(env, seed, 1)[-1]
        mask = cv2.inRange(cv2.cvtColor(observation["rgb"], cv2.COLOR_RGB2HSV), low, high) > 0
        camera = env.camera_model
        v, u = np.nonzero(mask)
        found = camera.to_base(camera.intrinsics.deproject(np.stack([u, v], axis=1), observation["depth"][mask] / 1000))
        sizes: dict[str, tuple[Any, ...]] = {"Cloth": (40, 80), "Cables": (300, "world", "tips", False, "all")}
        true = env.truth(*sizes.get(name, (300,)))  # type: ignore[attr-defined]
        away = np.sqrt(((found[:, None] - true) ** 2).sum(axis=2)).min(axis=1)
        assert away.max() < {"Cable": 0.014, "Ring": 0.03, "Cloth": 0.012, "Hanging": 0.014, "Cables": 0.013}[name], (
            seed
        )
        pixels = np.rint(camera.project_from_base(true)).astype(int)
        around = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3)))
        assert around[pixels[:, 1], pixels[:, 0]].mean() > 0.97, seed
