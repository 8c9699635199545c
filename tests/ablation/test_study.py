"""Ablations on this machine: finished runs are kept, and a failed or killed run affects no other."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from ablation_study import STUDY, here, killing, numbers

from shape_obs.ablation import load_study
from shape_obs.ablation.executors import Local
from shape_obs.ablation.sweep import check, left, sweep
from shape_obs.cli import main

EXAMPLES = Path(__file__).parents[2] / "examples" / "ablations"


def written(path: Path, **changes) -> Path:
    path.write_text(yaml.safe_dump({**STUDY, **changes}), encoding="utf-8")
    return path


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as exit_:
        main(["ablate", *map(str, arguments)])
    assert isinstance(exit_.value.code, int)
    return exit_.value.code


@pytest.fixture(scope="module", autouse=True)
def _installed() -> None:
    pytest.importorskip("mujoco")
    pytest.importorskip("stable_baselines3")


@pytest.fixture(scope="module")
def study_file(tmp_path_factory):
    return written(tmp_path_factory.mktemp("study") / "study.yaml", seeds=[0])


@pytest.fixture(scope="module")
def clean(tmp_path_factory, study_file):
    """Return the folder of the study, run without an interruption."""
    study, root = load_study(study_file), tmp_path_factory.mktemp("clean")
    outcomes = sweep(study, left(study, root), here)
    assert not [outcome.error for outcome in outcomes if outcome.error]
    return root


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.yaml")), ids=lambda path: path.stem)
def test_the_studies_among_the_examples_can_begin(path):
    check(load_study(path))


def test_results_table_and_pictures_of_what_is_done(study_file, clean, capsys):
    before = {path: path.stat().st_mtime_ns for path in clean.glob("*/*/*")}
    assert run(study_file, "--out", clean, "--json") == 0  # all is done: nothing runs
    assert {path: path.stat().st_mtime_ns for path in clean.glob("*/*/*")} == before
    result = json.loads(capsys.readouterr().out)
    assert {arm: each["runs"] for arm, each in result["arms"].items()} == {"small": 1, "smaller": 1}
    assert [Path(path).name for path in result["files"]] == ["results.csv", "table.md", "curves.png", "intervals.png"]
    assert result["table"] in (clean / "table.md").read_text(encoding="utf-8")
    with (clean / "results.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 2 * (1 + 2)  # runs x difficulties x goals of both evaluations
    assert {row["steps"] for row in rows} == {"30", "60"}
    assert all(float(row["final_mm"]) > 0 for row in rows)
    assert Path(result["policy"]).parent.parent.parent == clean
    assert result["next"].startswith("it is for simulation only: "), "its arms read the simulator's state"
    (clean / "table.md").write_text("mine")
    assert run(study_file, "--out", clean, "--table-only") == 1
    assert (clean / "table.md").read_text() == "mine"
    assert run(study_file, "--out", clean, "--table-only", "--overwrite") == 0


def test_every_run_leaves_a_policy_that_can_be_deployed(clean):
    from shape_obs.policy import load_policy

    policy = load_policy(clean / "small" / "seed0" / "trained.policy")
    zeros = {key: np.zeros(tensor.shape) for key, tensor in policy.spec.inputs.items()}
    assert np.abs(policy.act(zeros)).max() <= 1


@pytest.mark.nightly
def test_a_run_that_fails_or_is_killed_loses_only_itself(clean, tmp_path):
    arms = {**STUDY["arms"], "broken": {**STUDY["arms"]["small"], "hyperparameters": {"gradient_steps": "many"}}}
    study = load_study(written(tmp_path / "study.yaml", arms=arms))
    with killing(tmp_path / "small" / "seed0") as killed:
        ended = sweep(study, left(study, tmp_path, seeds=[0]), Local(2))
    outcomes = {outcome.task.arm: outcome for outcome in ended}
    assert killed
    assert [name for name, outcome in outcomes.items() if outcome.error] == ["broken"]
    assert "gradient_steps" in (tmp_path / "broken" / "seed0" / "error.txt").read_text()
    assert [folder.arm for folder in left(study, tmp_path, seeds=[0])] == ["broken"]
    assert numbers(tmp_path) == numbers(clean)


def test_another_config_for_the_same_folder_is_refused(clean, tmp_path, capsys):
    other = written(tmp_path / "other.yaml", steps=90, normalize=None)
    assert run(other, "--out", clean) == 1
    errors = capsys.readouterr().err
    assert "steps was 60, is now 90" in errors
    assert "normalize was {}, is now null" in errors


def test_a_folder_of_something_else_is_kept(study_file, tmp_path):
    mine = tmp_path / "small" / "seed0" / "photo.png"
    mine.parent.mkdir(parents=True)
    mine.write_bytes(b"mine")
    with pytest.raises(FileExistsError, match="holds no run"):
        sweep(load_study(study_file), left(load_study(study_file), tmp_path), here)
    assert mine.read_bytes() == b"mine"


def test_mistakes_are_reported_before_anything_runs(tmp_path, study_file, capsys):
    arms = {"typo": {"hyperparameters": {"gama": 0.9}}, "factor": {"env": {"randomize": {"hat": True}}}}
    assert run(written(tmp_path / "wrong.yaml", arms=arms), "--out", tmp_path / "out") == 1
    errors = capsys.readouterr().err
    assert "arms.typo: " in errors
    assert "gama" in errors
    assert "arms.factor: " in errors
    assert not list((tmp_path / "out").iterdir())
    assert run(study_file, "--out", tmp_path, "--only", "smal") == 2
    assert "did you mean 'small'?" in capsys.readouterr().err
    assert run(study_file, "--out", tmp_path, "--address", "auto") == 2
    assert "--engine ray" in capsys.readouterr().err
    assert run(study_file, "--out", tmp_path, "--table-only") == 1
    assert "no run of this study is finished" in capsys.readouterr().err
