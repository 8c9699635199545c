"""Ablations that lose a worker of a Ray cluster or are killed at random instants: the same numbers."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from ablation_study import STUDY, here, killing, numbers

from shape_obs.ablation import Study
from shape_obs.ablation.executors import Local, Outcome, Ray, Task
from shape_obs.ablation.sweep import left, sweep

COMMAND = (sys.executable, "-c", "from shape_obs.cli import main; main()", "ablate")


@pytest.mark.nightly
def test_a_cluster_that_loses_a_worker_gives_the_same_numbers(tmp_path):
    pytest.importorskip("mujoco")
    pytest.importorskip("stable_baselines3")
    ray = pytest.importorskip("ray")
    study = Study.from_dict({**{name: value for name, value in STUDY.items() if name != "version"}, "seeds": [0]})
    sweep(study, left(study, tmp_path / "here"), here)
    cluster = tmp_path / "cluster"
    engine = Ray(jobs=2)
    try:
        with killing(cluster / "small" / "seed0") as killed:
            outcomes = sweep(study, left(study, cluster), engine)
    finally:
        ray.shutdown()
    assert killed
    assert {outcome.task.arm: outcome.error for outcome in outcomes} == {"small": "", "smaller": ""}
    assert numbers(cluster) == numbers(tmp_path / "here")


def test_a_run_whose_process_dies_is_done_again_once_and_the_others_stay(tmp_path, monkeypatch):
    def work(task: Task) -> Outcome:
        died = task.folder / f"{task.arm}{task.seed} died"
        if task.arm == "small" and not (task.seed == 0 and died.exists()):
            died.touch()
            os._exit(1)
        return Outcome(task, about={"process": os.getpid()})

    monkeypatch.setattr("shape_obs.ablation.executors.work", work)
    study = Study.from_dict({name: value for name, value in STUDY.items() if name != "version"})
    tasks = [Task(study, arm, seed, tmp_path) for seed in (0, 1) for arm in ("small", "smaller")]
    found = {(outcome.task.arm, outcome.task.seed): outcome for outcome in Local(2)(tasks)}
    assert [key for key, outcome in found.items() if outcome.error] == [("small", 1)]
    assert "process ended" in found["small", 1].error
    assert len(found) == 4
    assert os.getpid() not in {outcome.about.get("process") for outcome in found.values()}


def test_without_ray_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ImportError, match=r'pip install "\.\[ray\]"'):
        Ray()


def finished(root: Path) -> dict[Path, bytes]:
    """Return the files of the finished runs of a study."""
    runs = [path.parent for path in root.glob("*/seed*/run.json")]
    return {path: path.read_bytes() for run in runs for path in run.iterdir()}


@pytest.mark.nightly
@pytest.mark.timeout(1200)
def test_no_kill_loses_or_changes_a_finished_run(tmp_path):
    pytest.importorskip("mujoco")
    pytest.importorskip("stable_baselines3")
    (tmp_path / "study.yaml").write_text(yaml.safe_dump(dict(STUDY)))
    whole, killed = ([*COMMAND, str(tmp_path / "study.yaml"), "--out", str(tmp_path / name)] for name in ("a", "b"))
    killed.append("--overwrite")  # of the tables, which one that is killed at its very end has written already
    subprocess.run(whole, check=True, capture_output=True)
    draw, kept = np.random.default_rng(0), dict[Path, bytes]()
    for number in range(8):  # at any instant of each of the four runs, two times
        process = subprocess.Popen(killed, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
        while len(list((tmp_path / "b").glob("*/seed*/run.json"))) < number // 2 and process.poll() is None:
            time.sleep(0.002)
        time.sleep(draw.uniform(0.0, 8.0))
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)  # its workers too
        assert process.wait() in (0, -signal.SIGKILL)
        now = finished(tmp_path / "b")
        assert {path: now.get(path) for path in kept} == kept
        kept = now
    subprocess.run(killed, check=True, capture_output=True)
    assert numbers(tmp_path / "b") == numbers(tmp_path / "a")
