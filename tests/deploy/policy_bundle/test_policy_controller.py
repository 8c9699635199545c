"""`shape-obs deploy BUNDLE`, before a simulated robot whose camera is a software D455."""

from __future__ import annotations

import json
import shlex
from importlib.util import find_spec
from typing import Any

import gymnasium as gym
import pytest
from bundles import cable, learner
from installed import needs

from shape_obs import ShapeObservation, save_bundle
from shape_obs.deploy.policy_bundle import deploy_command
from shape_obs.robot import ActionSpec

pytestmark = needs("mujoco", "stable_baselines3")
CELL = ["--source", "robot", "--robot", "shape_obs_envs.robots:SimulatedRobot"]
with_d455 = pytest.mark.skipif(not find_spec("pyrealsense2"), reason="the software D455 needs librealsense")


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Any:
    """Return an untrained policy for points in the base frame at 20 Hz."""
    path = tmp_path_factory.mktemp("bundle") / "cable.policy"
    save_bundle(learner(cable()), cable(), path)
    return path


#: What a busy machine does to images is none of these tests' business.
PATIENT = ["--hold", "20", "--max-age", "5", "--watchdog", "30", "--timeout", "10"]


def test_the_next_command_names_the_robot_of_the_training(path, tmp_path):
    robot = "--source robot --robot shape_obs_envs.robots:SimulatedRobot"
    assert deploy_command(path) == f"shape-obs deploy {path} {robot} --goal robot --episodes 20"
    env = ShapeObservation(gym.make("shape_obs_envs:ShapeObs/Hanging-v0", camera=[84, 84], grippers=1, step=0.01))
    save_bundle(learner(env), env, tmp_path / "hanging one.policy")
    words = shlex.split(deploy_command(tmp_path / "hanging one.policy"))
    assert words[2] == str(tmp_path / "hanging one.policy")
    assert words[7:11] == ["--robot-set", "env=ShapeObs/Hanging-v0", "grippers=1", "step=0.01"]


@with_d455
def test_the_next_command_works_as_printed(run, path):
    words = shlex.split(deploy_command(path).replace("--episodes 20", "--episodes 1 --steps 2"))
    code, out, err = run("deploy", *words[2:], *PATIENT)
    assert code == 0, err
    assert "episodes        1, failed: 0" in out


@with_d455
def test_a_policy_plays_episodes_with_goals_of_the_robot(run, path, tmp_path):
    options = ["--goal", "robot", "--episodes", "2", "--steps", "3", "--log", tmp_path / "runs", "--json"]
    code, out, err = run("deploy", path, *CELL, *options, *PATIENT)
    assert code == 0, err
    report = json.loads(out)
    assert [episode["steps"] for episode in report["episodes"]] == [3, 3]
    assert report["true_success"] in (0.0, 0.5, 1.0)
    distances = [episode["true_mm"] for episode in report["episodes"]]
    assert all(1 < distance < 200 for distance in distances)
    assert distances[0] != distances[1]  # another start and another goal
    header = json.loads((tmp_path / "runs" / "episode-001" / "run.json").read_text())
    assert header["options"]["rate"] == "20.0"
    assert header["options"]["settle"] == "0.05"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--controller", "shape_obs.deploy:Still"], "expected a trained policy or --controller, got both"),
        (["--controller-set", "share=1"], "--controller-set: a trained policy takes no arguments"),
        ([], "give --goal FILE, or --goal robot if the robot is simulated"),
        (["--goal", "robot", "--episodes", "0"], "--episodes: expected at least 1, got 0"),
        (["--goal", "robot", "--rate", "0"], "--rate: expected a number above 0"),
        (["--goal", "robot", "--settle", "-1"], "--settle: expected at least 0"),
        (["--goal", "robot", "--robot-set", "env=ShapeObs/Cloth-v0"], "action names: ['gripper0/x'"),
        (["--goal", "robot", "--robot-set", "grippers=1"], "action names: ['gripper0/x'"),
    ],
)
@with_d455
def test_what_does_not_fit_is_reported_in_one_line(run, path, arguments, message):
    code, out, err = run("deploy", path, *CELL, *arguments)
    assert (code, out) == (1 if "--robot-set" in arguments else 2, "")
    assert message in err
    assert err.count("\n") == 1


@with_d455
def test_another_rate_is_a_warning_and_a_robot_without_goals_is_reported(run, path, tmp_path):
    shape = tmp_path / "shape.yaml"
    shape.write_text("version: 1\nscene: {segmentation: {kind: hsv, low: [100, 120, 40], high: [125, 255, 255]}}\n")
    names = [f"gripper{i}/{axis}" for i in range(2) for axis in ("x", "y", "yaw")]
    spec = ActionSpec(tuple(names), ("m", "m", "rad") * 2, (0.015, 0.015, 0.12) * 2, (-1.0,) * 6, (1.0,) * 6).to_dict()
    robot = ["--source", "shape_obs_envs:ShapeObs/Cable-v0", "--config", shape]
    robot += ["--robot", "shape_obs_envs.robots:NullRobot", "--robot-set", f"spec={json.dumps(spec)}"]
    code, _, err = run("deploy", path, *robot, "--goal", "robot", "--rate", "10")
    assert code == 1
    assert "--rate 10: the policy was trained at 20 steps per second" in err
    assert "in the base frame, but this camera has no extrinsics" in err or "NullRobot provides no goals" in err


def test_a_bundle_that_runs_code_needs_trust(run, path, tmp_path):
    from shape_obs.deploy.policy_bundle.archive import read_archive, write_archive

    members = dict(read_archive(path).members)
    record = json.loads(members["policy.json"])
    record["network"]["arguments"]["activation_fn"] = "torch.nn:Softshrink"
    write_archive(tmp_path / "own.policy", {**members, "policy.json": json.dumps(record).encode()})
    code, _, err = run("deploy", tmp_path / "own.policy", *CELL)
    assert code == 1
    assert "Load it with trust=True (--trust on the command line) only if you trust who made the file" in err
    code, _, err = run("deploy", tmp_path / "own.policy", "--trust", *CELL)
    assert code == 2
    assert "give --goal FILE, or --goal robot if the robot is simulated" in err
    code, _, err = run("deploy", "--trust", *CELL)
    assert "--trust: only for a trained policy, and none is given" in err
