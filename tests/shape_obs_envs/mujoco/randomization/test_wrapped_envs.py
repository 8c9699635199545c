"""The wrapper and the environment checkers under domain randomisation."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("mujoco")

from randomized import ENVS, SINGLE, make, play  # pyright: ignore[reportMissingImports]

from shape_obs import ShapeObservation


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
