"""A bundle whose segmentation is a function of the user's is refused without trust, before anything is imported."""

from __future__ import annotations

import json
import sys

import gymnasium as gym
import numpy as np
import pytest
import yaml
from bundles import POINTS, WORKSPACE, learner, registered
from installed import needs
from rope_env import BLUE

from shape_obs import Centerline, ShapeGoal, ShapeObservation, load_bundle, save_bundle
from shape_obs.deploy.policy_bundle import BundleError
from shape_obs.deploy.policy_bundle.archive import read_archive, write_archive
from shape_obs.deploy.policy_bundle.limits import check_goal

pytestmark = needs("mujoco", "stable_baselines3")

MODULE = """
from pathlib import Path
(Path(__file__).parent / "imported").touch()

def blue(rgb, depth):
    return rgb[..., 2] > rgb[..., 0].astype(int) + 60
"""
REFUSED = r"the segmentation is code to import, 'bundle_masks:blue'. Load it with trust=True"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "bundle_masks.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    sys.modules.pop("bundle_masks", None)


def saved(folder, **arguments):
    """Save a bundle, forget the module that it names, and return the path and what the policy does."""
    env = gym.make(registered(), disable_env_checker=True)
    env = ShapeObservation(env, features=[POINTS], workspace=WORKSPACE, **arguments)
    model = learner(env, "PPO", n_steps=4, batch_size=4)
    save_bundle(model, env, folder / "a.policy")
    action = model.predict(env.reset(seed=1)[0], deterministic=True)[0]
    del sys.modules["bundle_masks"]
    (folder / "imported").unlink()
    return folder / "a.policy", action


@pytest.mark.parametrize("place", ["detector", "shape", "shorthand"])
@pytest.mark.filterwarnings("ignore:parts of the bundle are read only with trust")
def test_it_is_loaded_only_with_trust(folder, place):
    path, expected = saved(
        folder,
        **{
            "detector": {"segmentation": {"kind": "callable", "function": "bundle_masks:blue", "close": 3}},
            "shape": {"shapes": [Centerline(segmentation="bundle_masks:blue")], "segmentation": BLUE},  # pyright: ignore[reportArgumentType]
            "shorthand": {"segmentation": "bundle_masks:blue"},
        }[place],
    )
    with pytest.raises(BundleError, match=REFUSED):
        load_bundle(path)
    assert not (folder / "imported").exists()
    assert "bundle_masks" not in sys.modules
    bundle = load_bundle(path, trust=True)
    env = bundle.make_env()
    assert (folder / "imported").exists()
    np.testing.assert_array_equal(bundle.act(env.reset(seed=1)[0]), expected)


@pytest.mark.parametrize("rule", ["bundle_masks:blue", {"kind": "callable", "function": "bundle_masks:blue"}])
@pytest.mark.parametrize("place", ["scene", "shape", "wrapper"])
def test_a_changed_bundle_cannot_name_code(folder, rule, place):
    """Whatever part of the file names it, and however it is written."""
    __import__("bundle_masks")
    path, _ = saved(folder, segmentation=BLUE)
    members = dict(read_archive(path).members)
    if place == "wrapper":
        old = b'"segmentation": {"kind": "hsv", "low": [100, 120, 60], "high": [125, 255, 255]}'
        assert old in members["env.json"]
        members["env.json"] = members["env.json"].replace(old, f'"segmentation": {json.dumps(rule)}'.encode())
    else:
        config = yaml.safe_load(members["config.yaml"])
        if place == "scene":
            config["scene"]["segmentation"] = rule
        else:
            config["shape"]["shapes"][0]["segmentation"] = rule
        members["config.yaml"] = yaml.safe_dump(config, sort_keys=False).encode()
    write_archive(folder / "b.policy", members)
    with pytest.raises(BundleError, match=REFUSED):
        load_bundle(folder / "b.policy")
    assert not (folder / "imported").exists()


def test_a_goal_cannot_name_code(folder):
    configuration = {"kind": "centerline", "n": 3, "segmentation": "bundle_masks:blue"}
    goal = {"points": [[0, 0, 0]] * 3, "configuration": configuration}
    with pytest.raises(BundleError, match=REFUSED):
        check_goal({"goal": goal}, f"the wrapper {ShapeGoal.__name__}")
    assert not (folder / "imported").exists()
