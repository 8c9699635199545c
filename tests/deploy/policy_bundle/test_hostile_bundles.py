"""Hostile and damaged bundles run no code, raise what is declared, and take little time and memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from bundles import POINTS, train
from fuzzing.hostile_bundles import MODULE, VARIABLE, attacks, crafted, damaged, pack
from installed import needs
from known_ropes import fit, ropes

from shape_obs.deploy.policy_bundle.archive import read_archive

pytestmark = [needs("mujoco", "stable_baselines3"), pytest.mark.nightly, pytest.mark.timeout(1800)]
SUPPORT = Path(__file__).parents[2] / "support"
CANARY = f"""
import os, pathlib
pathlib.Path(os.environ["{VARIABLE}"]).touch()

def __getattr__(name):
    raise AttributeError(name)
"""
FAMILIES = ("feature", "segmentation", "configuration", "roi", "clustering")
KILLS = 10


def write_canary(folder: Path) -> None:
    """Write a module whose code leaves a mark, installed as a plugin of each family: an unknown kind would load it."""
    installed = folder / f"{MODULE}-1.0.dist-info"
    installed.mkdir(parents=True)
    (folder / f"{MODULE}.py").write_text(CANARY)
    (installed / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {MODULE}\nVersion: 1.0\n")
    plugins = (f"[shape_obs.{family}]\ncanary = {MODULE}:Kind\n" for family in FAMILIES)
    (installed / "entry_points.txt").write_text("".join(plugins))


def test_a_bundle_is_data_and_a_kill_loses_none(tmp_path):
    fit(ropes(50)).save(tmp_path / "ropes.npz")
    train(tmp_path / "sample.policy", features=[POINTS, {"kind": "pca", "file": str(tmp_path / "ropes.npz")}])
    sample = read_archive(tmp_path / "sample.policy").members
    write_canary(tmp_path / "path")
    (tmp_path / "files").mkdir()
    files = [("whole", pack(sample)), *damaged(sample, 300, seed=0), *crafted(sample)]
    trusted = list(attacks(sample))
    for number, (_, content) in enumerate([*files, *trusted]):
        suffix = ".policy" if number < len(files) else ".trusted"
        (tmp_path / "files" / f"{number:05}{suffix}").write_bytes(content)
    done = subprocess.run(
        [sys.executable, "-m", "fuzzing.bundle_trials", str(tmp_path), str(KILLS)],
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(tmp_path / "path"), str(SUPPORT), *sys.path]),
            VARIABLE: str(tmp_path / "canary"),
        },
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    *seen, killed = (json.loads(line) for line in done.stdout.splitlines() if line.startswith("{"))
    found = [{**one, "name": name} for one, (name, _) in zip(seen, [*files, *trusted], strict=True)]
    refused = found[: len(files)]
    for what, most in (("undeclared", 0), ("code", 0), ("left", 0), ("seconds", 2.0), ("mb", 300.0)):
        value = [one for one in refused if (len(one[what]) if what == "undeclared" else one[what]) > most]
        assert value == [], what
    assert sum(one["code"] for one in found[len(files) :]) >= 2, "with trust the attacks work, so the canary sees them"
    assert killed["lost"] == 0
    assert killed["writing"] >= 1
    assert killed["left"] <= KILLS
