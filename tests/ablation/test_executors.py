"""Ablations that lose a worker of a Ray cluster or are killed at random instants: the same numbers."""

from __future__ import annotations

import sys

import pytest
from ablation_study import STUDY, here, killing, numbers

from shape_obs.ablation import Study
from shape_obs.ablation.executors import Ray
from shape_obs.ablation.sweep import left, sweep


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


def test_without_ray_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ImportError, match=r'pip install "\.\[ray\]"'):
        Ray()


@pytest.mark.nightly
@pytest.mark.timeout(1200)
def test_no_kill_loses_or_changes_a_finished_run(tmp_path):
    pytest.importorskip("mujoco")
    pytest.importorskip("stable_baselines3")
    from fuzzing.killed_studies import killed_studies

    killed = killed_studies(tmp_path, kills=10)
    assert killed.kills == 10
    assert killed.finished >= 1
    assert (killed.lost, killed.different) == (0, 0)
