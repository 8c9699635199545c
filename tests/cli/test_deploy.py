"""`shape-obs goal` and `shape-obs deploy`, before a simulated robot whose camera is a software D455."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from importlib.util import find_spec

import numpy as np
import pytest

from shape_obs import Target, save_config

pytestmark = pytest.mark.skipif(
    not (find_spec("mujoco") and find_spec("pyrealsense2")),
    reason="the simulated robot needs MuJoCo and librealsense: extras sim, realsense",
)
CELL = ["--source", "robot", "--robot", "shape_obs_envs.robots:SimulatedRobot"]


def test_a_goal_is_recorded_and_deployed(run, tmp_path):
    goal = tmp_path / "goal.yaml"
    code, out, err = run("goal", *CELL, "--robot-set", "seed=3", "-o", goal)
    assert code == 0, err
    assert "20 points, frame 'base'" in out
    assert goal.with_suffix(".png").stat().st_size > 10_000
    target = Target.load(goal)
    assert target.frame == "base"
    assert np.ptp(np.asarray(target.points)[:, 0]) > 0.2

    options = ["--robot-set", "seed=3", "--goal", goal, "--until-reached", "3", "--log", tmp_path / "run"]
    code, out, err = run("deploy", *CELL, *options, "--json")
    report = json.loads(out)
    assert code == 0, report
    assert report["success"]  # the object was not moved
    assert "goal was reached in 3 consecutive frames" in report["ended"]
    header = json.loads((tmp_path / "run" / "run.json").read_text())
    assert header["robot"] == "simulated"
    assert len(header["schema"]) == 64
    assert header["action_spec"]["units"] == ["m", "m", "rad"] * 2


@pytest.mark.nightly
@pytest.mark.parametrize("occluder", [0.0, 0.3])
def test_the_whole_real_path_keeps_its_promises_with_faults(occluder):
    from tests.benchmarks import deployment

    report, actions, robot = deployment.run(6.0, {**deployment.FAULTS, "occluder": occluder})
    assert not report.failed
    assert report.held > 0
    assert robot.affected.keys() >= {"drop", "freeze", "black"}
    assert actions
    assert [row for row in actions if row.slipped or row.wrong or row.stale] == []


def test_a_dry_run_with_a_simulated_camera_and_a_robot_that_moves_nothing(run, tmp_path):
    shape = tmp_path / "shape.yaml"
    save_config(shape, {"segmentation": {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]}})
    source = ["--source", "shape_obs_envs:ShapeObs/Cable-v0", "--set", "camera=d455", "--config", shape]
    robot = ["--robot", "shape_obs_envs.robots:NullRobot", "--robot-set", "size=2", "--dry-run"]
    controller = ["--controller", "shape_obs.deploy:Sway", "--controller-set", "share=0.5"]
    code, out, err = run("deploy", *source, *robot, *controller, "--steps", "4")
    assert code == 0, err
    assert "acted           4, held: 0" in out


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_sigterm_ends_the_command_with_a_report_and_its_own_exit_code(tmp_path):
    shape, log = tmp_path / "shape.yaml", tmp_path / "run"
    save_config(shape, {"segmentation": {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]}})
    command = ["-c", "from shape_obs.cli import main; main()", "deploy", "--set", "camera=d455"]
    command += ["--source", "shape_obs_envs:ShapeObs/Cable-v0"]
    command += ["--config", str(shape), "--robot", "shape_obs_envs.robots:NullRobot", "--json", "--log", str(log)]
    child = subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    steps = log / "steps.jsonl"
    give_up = time.monotonic() + 240
    while not (steps.exists() and steps.read_text().count("\n") > 3) and time.monotonic() < give_up:
        time.sleep(0.05)
    child.send_signal(signal.SIGTERM)
    out, err = child.communicate(timeout=30)
    assert child.returncode == 143, err
    assert err.endswith("shape-obs deploy: interrupted by SIGTERM\n")
    assert json.loads(out)["ended"] == "interrupted by SIGTERM"
    assert json.loads((log / "report.json").read_text()) == json.loads(out)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ([], 2, "--robot module:Class is needed"),
        (["--robot", "shape_obs_envs.robots:NullRobot"], 2, "--config FILE is needed"),
        (
            ["--robot", "shape_obs_envs.robots:NullRobot", "--controller", "shape_obs.deploy:Swy"],
            2,
            "did you mean 'Sway'",
        ),
        ([*CELL, "--goal", "none.yaml"], 1, "none.yaml: no such goal file"),
        ([*CELL, "--robot-set", "sede=1"], 2, "did you mean 'seed'? Known: env, "),
        ([*CELL, "--workspace-low", "0"], 2, "--workspace-low and --workspace-high: give both"),
        ([*CELL, "--max-step", "0.01"], 1, "max_step: expected 6 numbers"),
    ],
)
def test_mistakes_are_reported_in_one_line(run, arguments, code, message):
    ended, out, err = run("deploy", *arguments)
    assert (ended, out) == (code, "")
    assert message in err
    assert err.count("\n") == 1
