"""Ablations on this machine: finished runs are kept, and a failed or killed run affects no other."""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("mujoco")
pytest.importorskip("stable_baselines3")

import yaml
from ablation_study import STUDY, here, killing, numbers, worker_of

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


@pytest.fixture(scope="module")
def study_file(tmp_path_factory):
    return written(tmp_path_factory.mktemp("study") / "study.yaml")


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


@pytest.mark.long
def test_a_study_that_was_killed_goes_on_to_the_same_numbers(study_file, clean, tmp_path):
    command = [sys.executable, "-c", "from shape_obs.cli import main; main()"]
    command += ["ablate", str(study_file), "--out", str(tmp_path)]
    workers = []

    def in_the_middle() -> bool:
        workers[:] = filter(None, map(worker_of, tmp_path.glob("*/*")))
        return bool(workers) and any(tmp_path.glob("*/*/run.json"))

    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        assert wait_for(lambda: in_the_middle() or process.poll() is not None)
    finally:
        process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    command_line = Path("/proc", str(workers[0]), "cmdline")
    assert wait_for(lambda: not command_line.exists() or not command_line.read_bytes())  # its result would be lost
    finished = [path.parent for path in tmp_path.glob("*/*/run.json")]
    assert 1 <= len(finished) <= 3
    done = {path: (path.stat().st_mtime_ns, path.read_bytes()) for run in finished for path in run.iterdir()}
    study = load_study(study_file)
    sweep(study, left(study, tmp_path), here)
    assert {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in done} == done
    assert numbers(tmp_path) == numbers(clean)
    assert not list(tmp_path.glob("*/*/progress.json"))


@pytest.mark.long
def test_results_table_and_pictures_of_what_is_done(study_file, clean, capsys):
    before = {path: path.stat().st_mtime_ns for path in clean.glob("*/*/*")}
    assert run(study_file, "--out", clean, "--json") == 0  # all is done: nothing runs
    assert {path: path.stat().st_mtime_ns for path in clean.glob("*/*/*")} == before
    result = json.loads(capsys.readouterr().out)
    assert {arm: each["runs"] for arm, each in result["arms"].items()} == {"small": 2, "smaller": 2}
    assert [Path(path).name for path in result["files"]] == ["results.csv", "table.md", "curves.png", "intervals.png"]
    assert result["table"] in (clean / "table.md").read_text(encoding="utf-8")
    with (clean / "results.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 * 2 * (1 + 2)  # runs x difficulties x goals of both evaluations
    assert {row["steps"] for row in rows} == {"30", "60"}
    assert all(float(row["final_mm"]) > 0 for row in rows)
    assert Path(result["policy"]).parent.parent.parent == clean
    assert result["next"].startswith("it is for simulation only: "), "its arms read the simulator's state"


@pytest.mark.long
def test_the_path_of_the_policy_and_the_next_command_are_printed(tmp_path, capsys):
    study = written(tmp_path / "seen.yaml", arms={"points3d": {}}, seeds=[3])
    assert run(study, "--out", tmp_path / "o") == 0
    path = tmp_path / "o" / "points3d" / "seed3" / "trained.policy"
    lines = capsys.readouterr().out.splitlines()[-2:]
    assert lines[0] == f"best policy: {path}"
    assert lines[1].startswith(f"next: shape-obs deploy {path} --source robot --robot ")
    assert path.is_file()


@pytest.mark.long
def test_every_run_leaves_a_policy_that_can_be_deployed(clean):
    from shape_obs.deploy.policy_bundle import load_bundle

    bundle = load_bundle(clean / "small" / "seed1" / "trained.policy")
    env = bundle.make_env()
    observation, _ = env.reset(seed=0)
    assert env.action_space.contains(bundle.act(observation))
    env.close()


@pytest.mark.long
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
    assert numbers(tmp_path) == {name: rows for name, rows in numbers(clean).items() if name.endswith("seed0")}


def test_another_config_for_the_same_folder_is_refused(clean, tmp_path, capsys):
    other = written(tmp_path / "other.yaml", steps=90, normalize=None)
    assert run(other, "--out", clean) == 1
    errors = capsys.readouterr().err
    assert "steps was 60, is now 90" in errors
    assert "normalize was {}, is now null" in errors


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


def wait_for(condition: Callable[[], object]) -> bool:
    for _ in range(2400):
        if condition():
            return True
        time.sleep(0.05)
    return False
