"""ShapeObservation with a function as its segmentation, and without any segmentation."""

from __future__ import annotations

import sys
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from rope_env import BLUE, RopeEnv

from shape_obs import Centerline, ShapeObservation, SpecError
from shape_obs.image.mask_function import MaskFunction

ROPES = Centerline(name="rope", count=2)
MODULE = """
import numpy as np

def blue(rgb, depth):
    assert depth.dtype == np.float32
    return rgb[..., 2] > rgb[..., 0].astype(int) + 60

def floats(rgb, depth):
    return rgb[..., 2] / 255
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    (tmp_path / "my_masks.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    yield "my_masks"
    sys.modules.pop("my_masks", None)


@pytest.fixture(scope="module")
def rope():
    if "OwnRope-v0" not in gym.registry:
        gym.register("OwnRope-v0", "rope_env:RopeEnv")
    return lambda: gym.make("OwnRope-v0", disable_env_checker=True)


def by_colour(rope):
    return ShapeObservation(rope(), segmentation=BLUE).reset(seed=1)[0]


@pytest.mark.parametrize("given", ["function", "path", "mapping", "of a shape", "of a shape's mapping"])
def test_the_env_is_rebuilt_from_its_spec(rope, module, given):
    path = f"{module}:blue"
    function = getattr(__import__(module), "blue")  # noqa: B009
    arguments = {
        "function": {"segmentation": function},
        "path": {"segmentation": path},
        "mapping": {"segmentation": {"kind": "callable", "function": function}},
        "of a shape": {"shapes": [Centerline(segmentation=function)]},
        "of a shape's mapping": {"shapes": [{"kind": "centerline", "segmentation": function}]},
    }[given]
    env = ShapeObservation(rope(), **arguments)
    expected = by_colour(rope)
    np.testing.assert_array_equal(env.reset(seed=1)[0], expected)
    assert env.spec is not None
    np.testing.assert_array_equal(gym.make(env.spec).reset(seed=1)[0], expected)
    text = env.spec.to_json()
    assert f'"function": "{path}"' in text or f'"segmentation": "{path}"' in text
    np.testing.assert_array_equal(gym.make(EnvSpec.from_json(text)).reset(seed=1)[0], expected)


def test_a_function_without_an_import_path_is_refused_when_the_wrapper_is_made():
    def mask(rgb, depth):
        return rgb[..., 2] > 100

    shapes = Centerline(segmentation=MaskFunction(mask)), {"kind": "centerline", "segmentation": mask}
    arguments: list[dict[str, Any]] = [{"segmentation": mask}, *({"shapes": [shape]} for shape in shapes)]
    for given in arguments:
        with pytest.raises(SpecError, match=r"segmentation: <function .* cannot be saved or recorded, since it has no"):
            ShapeObservation(RopeEnv(), **given)


def test_a_wrong_mask_is_named_in_reset(rope, module):
    env = ShapeObservation(rope(), segmentation=f"{module}:floats")
    with pytest.raises(TypeError, match=r"^segmentation my_masks:floats: expected a numpy array of bool or uint8,"):
        env.reset()


def test_a_shape_without_a_segmentation_is_an_error_when_the_wrapper_is_made():
    blue = {"kind": "centerline", "name": "a", "segmentation": BLUE}
    for shapes, name in ((["centerline"], "centerline"), ([blue, "centerline"], "centerline"), ([ROPES], "rope")):
        with pytest.raises(ValueError, match=f"shape '{name}' has no segmentation, so no frame would be understood"):
            ShapeObservation(RopeEnv(), shapes)
    assert ShapeObservation(RopeEnv(), [blue]).reset()[1]["shape/ok"]
