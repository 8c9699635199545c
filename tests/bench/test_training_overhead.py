"""`shape-obs bench training`: the wrapper's share of a training. Times decide nothing."""

from __future__ import annotations

import json

import gymnasium as gym
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("stable_baselines3")

from shape_obs.bench.backends import LABELS, backends
from shape_obs.bench.training_overhead import TRUTH, Course, Meter, Overhead, overhead_claims, overhead_rows
from shape_obs.cli import main


def run(capsys, *arguments):
    """(exit code, stdout, stderr) of the command."""
    with pytest.raises(SystemExit) as stop:
        main(["bench", "training", *arguments])
    captured = capsys.readouterr()
    return stop.value.code, captured.out, captured.err


def test_the_wrappers_share_is_what_is_not_the_environments():
    course = Course("SAC", (84, 84), 100)
    found = {TRUTH: Overhead(1000.0, 210.0, 200.0), "NumPy": Overhead(1500.0, 500.0, 300.0)}
    truth, wrapped = overhead_rows(course, found)
    assert wrapped["ms_per_step"] == 15
    assert wrapped["env_ms"] == 3
    assert wrapped["wrapper_ms"] == 2
    assert wrapped["wrapper_percent"] == pytest.approx(100 * 200 / 1500)
    assert (truth["times_true_state"], wrapped["times_true_state"]) == (1, 1.5)
    (claim,) = overhead_claims([truth, wrapped])
    assert (claim["asked"], claim["reached"]) == ("<= 10 %", "no")
    assert not overhead_claims([{**wrapped, "algorithm": "PPO"}, {**wrapped, "image": "160 x 120"}])


def test_turns_are_whole():
    assert [Course("SAC", (84, 84), steps).counted for steps in (20, 50, 101)] == [20, 50, 150]
    assert [Course("PPO", (84, 84), steps).counted for steps in (20, 257)] == [20, 512]


def test_a_meter_inside_counts_no_more_than_one_outside():
    inner = Meter(gym.make("CartPole-v1"), "wall")
    outer = Meter(inner, "wall")
    outer.reset(seed=0)
    for _ in range(5):
        outer.step(1)
    assert 0 < inner.milliseconds < outer.milliseconds


def test_both_algorithms_train_on_everything(capsys):
    code, out, _ = run(capsys, "--sizes", "84x84", "--steps", "16", "--json")
    assert code == 0
    document = json.loads(out)
    sees = [TRUTH, *(LABELS[backend] for backend in backends())]
    rows = document["trainings"]
    assert [(row["algorithm"], row["sees"]) for row in rows] == [(a, s) for a in ("SAC", "PPO") for s in sees]
    for row in rows:
        assert 0 < row["wrapper_ms"] < row["ms_per_step"]
        assert row["env_ms"] < row["ms_per_step"]
    assert len(document["claims"]) == len(backends())


def test_wrong_arguments_are_told(capsys):
    assert run(capsys, "--steps", "1")[::2] == (
        1, "shape-obs bench: --steps: expected at least 16, got 1.\n"
    )  # fmt: skip
    code, _, err = run(capsys, "--sizes", "big")
    assert code == 1
    assert "--sizes: expected WIDTHxHEIGHT" in err
