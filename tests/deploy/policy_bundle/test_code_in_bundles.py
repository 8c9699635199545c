"""Bundles are data: what names code is refused without trust, before anything is imported."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import yaml
from bundles import POINTS, WORKSPACE, learner, registered, train
from fuzzing import hostile_bundles
from installed import needs
from known_ropes import fit, ropes
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


# ---- hostile and damaged bundles: no code, only declared errors, little time and memory

SUPPORT = Path(__file__).parents[2] / "support"
CANARY = f"""
import os, pathlib
pathlib.Path(os.environ["{hostile_bundles.VARIABLE}"]).touch()

def __getattr__(name):
    raise AttributeError(name)
"""
FAMILIES = ("feature", "segmentation", "configuration", "roi", "clustering")


def write_canary(folder: Path) -> None:
    """Write a module whose code leaves a mark, installed as a plugin of each family: an unknown kind would load it."""
    installed = folder / f"{hostile_bundles.MODULE}-1.0.dist-info"
    installed.mkdir(parents=True)
    (folder / f"{hostile_bundles.MODULE}.py").write_text(CANARY)
    (installed / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {hostile_bundles.MODULE}\nVersion: 1.0\n")
    plugins = (f"[shape_obs.{family}]\ncanary = {hostile_bundles.MODULE}:Kind\n" for family in FAMILIES)
    (installed / "entry_points.txt").write_text("".join(plugins))


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_a_bundle_is_data(tmp_path):
    fit(ropes(50)).save(tmp_path / "ropes.npz")
    train(tmp_path / "sample.policy", features=[POINTS, {"kind": "pca", "file": str(tmp_path / "ropes.npz")}])
    sample = read_archive(tmp_path / "sample.policy").members
    write_canary(tmp_path / "path")
    (tmp_path / "files").mkdir()
    files = [*hostile_bundles.damaged(sample, 300, seed=0), *hostile_bundles.crafted(sample)]
    trusted = [(name, content) for name, content in files if hostile_bundles.MODULE in name]
    for number, (_, content) in enumerate([*files, *trusted]):
        suffix = ".policy" if number < len(files) else ".trusted"
        (tmp_path / "files" / f"{number:05}{suffix}").write_bytes(content)
    done = subprocess.run(
        [sys.executable, "-m", "fuzzing.bundle_trials", str(tmp_path)],
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(tmp_path / "path"), str(SUPPORT), *sys.path]),
            hostile_bundles.VARIABLE: str(tmp_path / "canary"),
        },
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    seen = (json.loads(line) for line in done.stdout.splitlines() if line.startswith("{"))
    found = [{**one, "name": name} for one, (name, _) in zip(seen, [*files, *trusted], strict=True)]
    refused = found[: len(files)]
    for what, most in (("undeclared", 0), ("code", 0), ("left", 0), ("seconds", 2.0), ("mb", 300.0)):
        value = [one for one in refused if (len(one[what]) if what == "undeclared" else one[what]) > most]
        assert value == [], what
    assert sum(one["code"] for one in found[len(files) :]) >= 5, "with trust they work, so the canary sees them"
