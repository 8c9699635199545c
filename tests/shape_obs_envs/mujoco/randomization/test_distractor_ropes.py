"""Distractor ropes: of the object's colour, over the object, and without any effect on it."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mujoco")

from randomized import make, play, reset, same  # pyright: ignore[reportMissingImports]

from shape_obs_envs.mujoco.scene import cast_rays

ROPES = {"others": False, "distractors": {"most": 0, "ropes": 3}}


def geoms(env: Any, most: int = 3) -> np.ndarray:
    """Return the geoms of the distractor ropes that are shown."""
    model = env._body.model
    ids = np.concatenate([int(model.body(f"distractor_rope{i}_").geomadr[0]) + np.arange(24) for i in range(most)])
    return ids[model.geom_rgba[ids, 3] > 0]


def test_they_have_the_colour_of_the_object_and_lie_over_it():
    env: Any = make("Cable", ROPES | {"object": True}, render_observation=False)
    numbers, over = [], 0
    for seed in range(12):
        reset(env, seed)
        model, data = env._body.model, env._body.data
        drawn = env.randomization["distractors"]["ropes"]
        numbers.append(len(drawn))
        assert len(geoms(env)) == 24 * len(drawn)
        assert np.allclose(model.geom_rgba[geoms(env), :3], model.geom("link0").rgba[:3])
        json.dumps(drawn)
        eye = data.cam_xpos[0].copy()
        for step in range(3):
            truth = env.truth(100)
            rays = truth - eye
            away = np.linalg.norm(rays, axis=1)
            distance, hit = cast_rays(model, data, eye, rays / away[:, None])
            covered = np.isin(hit, geoms(env))
            over += int(covered.any())
            assert (away - distance)[covered].min(initial=1.0) > env._chain.spec.radius, "it is above, not within"
            if step == 0:
                assert covered.mean() <= 0.5
                assert not covered[[0, 1, -2, -1]].any()
            for _ in range(5):
                env.step(np.array([0.5, 1.0, 0.5, -0.5, -1.0, 0.5], np.float32))
    assert set(numbers) == {0, 1, 2, 3}
    assert over > 5


def test_they_change_neither_physics_nor_other_factors():
    plain, roped = make("Cable", {"others": False, "distractors": {"most": 0}}), make("Cable", ROPES)
    assert same(play(plain, 3), play(roped, 3), "achieved_goal", "gripper")
    few, many = make("Cable", True), make("Cable", {"distractors": {"ropes": 2}})
    reset(few, 4)
    reset(many, 4)
    drawn = many.randomization
    ropes = drawn["distractors"].pop("ropes")
    assert drawn == few.randomization
    assert len(ropes) <= 2
    assert same(play(many, 4), play(many, 4))


@pytest.mark.parametrize("name", ["Ring", "Cloth", "Hanging", "Cables"])
def test_they_are_ignored_where_the_object_is_no_single_rope_on_the_table(name):
    env = make(name, ROPES, render_observation=False)
    reset(env, 0)
    assert "ropes" not in env.randomization["distractors"]
    assert len(geoms(env)) == 0
