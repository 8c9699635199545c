"""`shape-obs bench envs`: steps per second of the simulated environments. Times decide nothing."""

from __future__ import annotations

import json

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("mujoco")

from shape_obs.bench.backends import LABELS, backends
from shape_obs.bench.env_speed import EPISODE, Runner, Speed, Stopwatch, speed_claims
from shape_obs.bench.interleaved_timing import no_opengl, opengl
from shape_obs.cli import main
from shape_obs.cli.bench import envs

NO_GL = no_opengl()


def run(capsys, *arguments):
    """(exit code, stdout, stderr) of the command."""
    with pytest.raises(SystemExit) as stop:
        main(["bench", "envs", *map(str, arguments)])
    captured = capsys.readouterr()
    return stop.value.code, captured.out, captured.err


class Counting(gym.Env):
    """Counts its steps and the seeds of its resets."""

    action_space = gym.spaces.Box(-1, 1, (2,), np.float32)
    observation_space = gym.spaces.Discrete(1)

    def __init__(self):
        self.steps, self.seeds = 0, []

    def reset(self, *, seed=None, options=None):
        self.seeds.append(seed)
        return 0, {}

    def step(self, action):
        self.steps += 1
        return 0, 0.0, False, False, {}


def test_a_runner_resets_between_episodes_and_not_within():
    env = Counting()
    runner = Runner(env, 7, "wall")
    for _ in range(EPISODE + 1):
        runner.ready()
        runner.ready()
        runner.step(np.zeros(2, np.float32))
    assert env.steps == EPISODE + 1
    assert env.seeds == [7, 1007]
    assert len(runner.resets) == 2


def test_the_stopwatch_tells_of_the_step_within():
    inside = Counting()
    env = Stopwatch(inside, "wall")
    env.step(np.zeros(2, np.float32))
    assert env.milliseconds > 0
    assert inside.steps == 1


@pytest.mark.skipif(bool(NO_GL), reason=NO_GL)
def test_every_way_is_told_beside_what_was_asked(capsys):
    code, out, _ = run(
        capsys, "--only", "single", "stock", "--envs", "Cable", "--sizes", "84x84", "--steps", 3, "--slow-steps", 1,
        "--json",
    )  # fmt: skip
    document = json.loads(out)
    assert code == 0
    assert document["machine"]["opengl"] == opengl()
    assert {"processor", "mujoco", "gymnasium"} <= document["machine"].keys()
    assert [(row["image"], row["renderer"]) for row in document["single"]] == [("84 x 84", "gl"), ("84 x 84", "rays")]
    for row in document["single"]:
        assert row["no_drawing"] > 0
        assert row["bare"] > 0
        assert row["reset_ms"] > 0
        for backend in LABELS:
            if backend not in backends():
                assert row[backend] is None
                continue
            assert row[f"{backend}_of_no_drawing"] == pytest.approx(row[backend] / row["no_drawing"])
            assert 0 < row[f"{backend}_wrapper_percent"] < 100
    (stock,) = document["stock"]
    assert stock["faster"] == pytest.approx(stock["bare"] / stock["stock"])
    asked = {row["what"]: row for row in document["claims"]}
    gl = document["single"][0]
    seen = asked["Cable, 84 x 84, OpenGL, wrapped, NumPy: of the steps per second without drawing"]["seen"]
    assert seen == pytest.approx(gl["numpy_of_no_drawing"])
    faster = asked["Cable, 84 x 84, OpenGL: times the steps per second of stock mujoco.Renderer"]
    assert (faster["asked"], faster["seen"]) == (">= 5x", pytest.approx(stock["faster"]))


def test_without_opengl_there_are_rays_alone_and_it_is_said(capsys, monkeypatch):
    monkeypatch.setattr(envs, "no_opengl", lambda: "none here")
    monkeypatch.setattr(envs, "opengl", lambda: "")
    arguments = ("--only", "single", "stock", "--envs", "Ring", "--sizes", "84x84", "--steps", 1)
    code, out, _ = run(capsys, *arguments)
    assert code == 0
    assert "no OpenGL here, rays alone: none here" in out
    assert "Ring  84 x 84      rays" in out
    assert "stock" not in out


def test_two_environments_at_once(capsys):
    code, out, _ = run(
        capsys, "--only", "vector", "--envs", "Cable", "--sizes", "84x84", "--renderers", "rays", "--steps", 1, "--json"
    )
    document = json.loads(out)
    (row,) = document["vector"]
    assert code == 0
    assert row["workers"] == 2
    assert all(row[f"{kind}_{what}"] > 0 for kind in ("sync", "async") for what in ("bare", "wrapped"))
    assert document["claims"] == []


def test_claims_are_about_the_wrapper_and_stock_settings():
    row = {"env": "Ring", "image": "160 x 120", "renderer": "gl"}
    row |= {"numpy_wrapper_percent": 30.0, "numba_wrapper_percent": None}
    stock = [{"env": "Ring", "image": "84 x 84", "faster": 4.0}]
    asked = speed_claims([row, {**row, "renderer": "rays"}], stock)
    assert [(each["asked"], each["reached"]) for each in asked] == [
        ("<= 35 %", "yes"), ("<= 10 %", "not measured"), (">= 5x", "no"),
    ]  # fmt: skip


def test_rates_are_those_of_the_median_step():
    assert Speed(steps=[1.0, 2.0, 100.0]).rate == 500


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--steps", 0], "--steps: expected at least 1, got 0"),
        (["--slow-steps", 0], "--slow-steps: expected at least 1, got 0"),
        (["--burst", 0], "--burst: expected at least 1, got 0"),
        (["--sizes", "84x160"], "no higher than wide, such as 160x120, got '84x160'"),
    ],
)
def test_bad_arguments_get_one_clear_line(capsys, arguments, message):
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (1, "")
    assert message in err
    assert len(err.strip().splitlines()) == 1
