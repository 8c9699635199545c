"""`shape-obs bench envs`: steps per second of the simulated environments. No test depends on times."""

from __future__ import annotations

import json

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("mujoco")

from shape_obs.cli import main
from tests.benchmarks import interleaved_timing
from tests.benchmarks.env_speed import Runner, Stopwatch, rate, speed_targets
from tests.benchmarks.envs import EPISODE
from tests.benchmarks.interleaved_timing import Turn, opengl
from tests.benchmarks.tables import Row

GL, NO_GL = opengl()


def run(capsys, *arguments):
    """Return (exit code, stdout, stderr) of the command."""
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


def test_the_stopwatch_times_the_step_within():
    inside = Counting()
    env = Stopwatch(inside, "wall")
    env.step(np.zeros(2, np.float32))
    assert env.milliseconds > 0
    assert inside.steps == 1


@pytest.mark.skipif(bool(NO_GL), reason=NO_GL)
def test_every_way_is_reported_with_its_target(capsys):
    code, out, _ = run(capsys, "--envs", "Cable", "--sizes", "84x84", "--steps", 3, "--json")
    document = json.loads(out)
    assert code == 0
    assert document["machine"]["opengl"] == GL
    assert {"processor", "mujoco", "gymnasium"} <= document["machine"].keys()
    assert [(row["image"], row["renderer"]) for row in document["single"]] == [("84 x 84", "gl"), ("84 x 84", "rays")]
    for row in document["single"]:
        assert min(row["no_drawing"], row["bare"], row["wrapped"], row["reset_ms"]) > 0
        assert row["wrapped_of_no_drawing"] == pytest.approx(row["wrapped"] / row["no_drawing"])
        assert 0 < row["wrapper_percent"] < 100
    asked = {row["what"]: row for row in document["claims"]}
    seen = asked["Cable, 84 x 84, OpenGL, wrapped: of the steps per second without drawing"]["seen"]
    assert seen == pytest.approx(document["single"][0]["wrapped_of_no_drawing"])


def test_without_opengl_only_rays_are_measured_and_the_reason_is_printed(capsys, monkeypatch):
    monkeypatch.setattr(interleaved_timing, "opengl", lambda: ("", "none here"))
    code, out, _ = run(capsys, "--envs", "Ring", "--sizes", "84x84", "--steps", 1)
    assert code == 0
    assert "no OpenGL here, rays alone: none here" in out
    assert "Ring  84 x 84      rays" in out


def test_targets_are_those_of_training_with_opengl():
    row = Row(env="Ring", image="160 x 120", renderer="gl", wrapper_percent=30.0)
    cable = Row(env="Cable", image="84 x 84", renderer="gl", wrapped_of_no_drawing=0.5)
    compared = speed_targets([row, Row(row, renderer="rays"), cable])
    assert [(each["asked"], each["reached"]) for each in compared] == [("<= 10 %", "no"), (">= 0.4x", "yes")]


def test_rates_are_those_of_the_median_step():
    assert rate([Turn(i, "bare", ms, None) for i, ms in enumerate((1.0, 2.0, 100.0))]) == 500


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--steps", 0], "--steps: expected at least 1, got 0"),
        (["--burst", 0], "--burst: expected at least 1, got 0"),
        (["--sizes", "84x160"], "no higher than wide, such as 640x480, got '84x160'"),
    ],
)
def test_bad_arguments_get_one_clear_line(capsys, arguments, message):
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (2, "")
    assert message in err
    assert len(err.strip().splitlines()) == 1
