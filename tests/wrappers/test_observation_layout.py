"""All three configurations through the wrapper: spaces, both env checkers, identity, a rebuild from JSON."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from sheet_env import SheetEnv

from shape_obs import ShapeObservation

RED = {"kind": "hsv", "low": [170, 120, 60], "high": [10, 255, 255]}
SHAPES = [
    {"kind": "surface", "rows": 3, "cols": 5, "ends": "tips"},
    {"kind": "contour", "n": 16},
    {"kind": "contour", "name": "in metres", "n": 12, "lift": "cloud"},
]


@pytest.fixture
def env() -> ShapeObservation:
    return ShapeObservation(SheetEnv(), SHAPES, RED, ["points3d", "valid"])


def test_every_shape_has_its_place_in_the_vector(env):
    observation, info = env.reset(seed=1)
    assert observation.shape == (4 * (15 + 16 + 12),)
    assert env.observation_space.contains(observation)
    assert {key: info[key] for key in info if key.endswith("ok")} == {
        "shape/ok": True,
        "shape/surface/ok": True,
        "shape/contour/ok": True,
        "shape/in metres/ok": True,
    }


def test_corners_stay_on_the_material_while_the_sheet_turns_half_round(env):
    env.reset(seed=3)
    inner: Any = env.unwrapped
    for _ in range(32):
        env.step(np.array([1.0, 0.5], np.float32))
        assert env.detection is not None
        assert env.detection.ok
        found = env.detection["surface"].pixels[[0, 4, 14, 10]]
        np.testing.assert_allclose(found, inner.corners(), atol=2.5)
    assert inner.angle > 3


def test_both_checkers_pass(env):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*is different from the unwrapped version")
        check_env(env, skip_render_check=True)
        pytest.importorskip("stable_baselines3.common.env_checker").check_env(env, warn=True)
