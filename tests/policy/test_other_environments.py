"""Policies in other environments: differences are refused by name."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from fake_cell import rope_camera
from goal_envs import StripsEnv, observing_strips
from installed import needs
from policies import POINTS, WORKSPACE, cable, saved, trained_cable, untrained

import shape_obs_envs  # noqa: F401
from shape_obs import ShapeGoal, ShapeObservation, Target
from shape_obs.features import PointDistribution, distribution
from shape_obs.geometry.topology import Chain
from shape_obs.policy import PolicyError, deploy_command, load_policy, save_policy
from shape_obs.recording import ShapeTable
from shape_obs.robot import ActionSpec
from shape_obs.training import PointReward, TrueState
from shape_obs_envs.robots import NullRobot

pytestmark = needs("mujoco", "stable_baselines3", "onnxscript", "onnxruntime")


@pytest.fixture(scope="module")
def policy(tmp_path_factory) -> Any:
    return trained_cable(tmp_path_factory.mktemp("policy") / "cable.policy")


class TestMismatch:
    """Each difference is named, with both values."""

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"shapes": [{"kind": "centerline", "n": 10, "anchor": "gripper0"}]}, r"shapes\[0\].n: 20 in training, 10"),
            ({"features": [POINTS, "ok"]}, r"features\[1\].kind: None in training, 'ok' here"),
            ({"features": [{"kind": "points3d"}]}, r"features\[0\].frame: 'base' in training, 'camera' here"),
            ({"keep": ["gripper"]}, r"observation 'observation' shape: \[60\] in training, \[70\] here"),
            ({"clustering": "kmeans", "shapes": ["centerline"]}, "clustering.kind: 'som' in training, 'kmeans' here"),
        ],
    )
    def test_of_what_is_seen(self, policy, options, message):
        with pytest.raises(PolicyError, match=f"does not fit this environment: .*{message}"):
            policy.check_env(cable(**options))

    @pytest.mark.parametrize(
        ("changes", "rate", "message"),
        [
            ({"scale": [0.02] * 6}, 20, r"action scale: \[0.015, .* in training, \[0.02, "),
            ({"units": ["m"] * 6}, 20, "action units: .*'rad'.* in training, .* here"),
            ({"mode": "velocity"}, 20, "action mode: 'displacement' in training, 'velocity' here"),
            ({"frame": "gripper"}, 20, "action frame: 'base' in training, 'gripper' here"),
            ({}, 30, r"dt \[s\]: 0.05 in training, 0.0333 here"),
        ],
    )
    def test_of_what_is_done(self, policy, changes, rate, message):
        env = policy.wrap(self.cell(policy, changes, rate), scene=BLUE)
        with pytest.raises(PolicyError, match=message):
            policy.check_env(env)

    def test_what_may_differ(self, policy):
        policy.check_env(cable(workspace=WORKSPACE, segmentation=BLUE["segmentation"]))
        shapes = [{**shape, "length": 0.8} for shape in policy.spec.config["shapes"]]
        policy.check_env(cable(shapes=shapes, max_speed=3.0))
        slow = policy.wrap(self.cell(policy, {"low": [-0.3] * 6}, 30), scene=BLUE)
        policy.check_env(slow, same_rate=False)
        assert isinstance(slow, ShapeGoal)
        other = policy.wrap(self.cell(policy, {}, 20), scene={**BLUE, "shapes": shapes, "max_speed": 3.0})
        config = other.get_wrapper_attr("detector").config
        assert (config.shapes[0].length, config.max_speed) == (0.8, 3.0)

    def test_a_camera_without_extrinsics(self, policy):
        env = self.cell(policy, {}, 20)
        env.unwrapped.source.extrinsics = None  # as of a camera without --extrinsics
        with pytest.raises(PolicyError, match=r"'points3d' in the base frame, .* give --extrinsics"):
            policy.wrap(env, scene=BLUE)

    def cell(self, policy, changes, rate) -> Any:
        spec = {**policy.action_spec.to_dict(), **changes}
        return gym.make(
            "shape_obs_envs:ShapeObs/D455-v0",
            source=rope_camera(),
            robot=NullRobot(spec=spec),
            rate=rate,
            size=[160, 120],
            disable_env_checker=True,
        )


def transformed() -> Any:
    env = cable()
    return gym.wrappers.TransformObservation(env, dict, env.observation_space)


BLUE = {"segmentation": {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]}}


class TestDeployable:
    @pytest.mark.parametrize(
        ("make", "reason"),
        [
            (lambda: TrueState(gym.make("ShapeObs/Cable-v0", render_observation=False)), "the wrapper TrueState does"),
            (lambda: cable(keep=["gripper"]), "it also reads gripper, which only its simulator provides"),
            (transformed, "the wrapper TransformObservation does on a robot"),
        ],
    )
    def test_what_only_a_simulator_has_is_kept_and_rebuilt_but_not_deployed(self, tmp_path, make, reason):
        env = make()
        policy = saved(untrained(env), env, tmp_path / "a.policy")
        assert env.unwrapped.action_space.contains(policy.act(env.reset(seed=0)[0]))
        with pytest.raises(PolicyError, match=f"the policy cannot be deployed: .*{reason}"):
            policy.wrap(env)

    def test_wrappers_that_belong_to_the_policy_come_along(self, tmp_path):
        features = ["centroid", POINTS]
        env = PointReward(ShapeGoal(cable(features=features), features=features, threshold=1.0), threshold=0.02)
        policy = saved(untrained(env), env, tmp_path / "a.policy")
        cell = policy.wrap(TestMismatch().cell(policy, {}, 20), scene=BLUE)
        assert isinstance(cell, PointReward)
        assert cell.threshold == 0.02
        policy.check_env(cell)


def blue(rgb: Any, depth: Any) -> Any:
    return rgb[..., 2] > rgb[..., 0] + 60


def test_a_segmentation_that_is_a_function_is_given_again_at_each_site(tmp_path):
    env = cable(segmentation=blue)
    policy = saved(untrained(env), env, tmp_path / "a.policy")
    assert policy.spec.config["segmentation"] is None
    cell = policy.wrap(TestMismatch().cell(policy, {}, 20), scene=BLUE)
    policy.check_env(cell)


def test_files_to_which_features_were_fitted_come_along(tmp_path, monkeypatch):
    model = PointDistribution.fit(np.random.default_rng(0).normal(size=(30, 20, 3)), layout=Chain(20), frame="base")
    model.save(tmp_path / "rope.npz")
    env = cable(features=[{"kind": "pca", "file": str(tmp_path / "rope.npz")}, POINTS])
    save_policy(untrained(env), env, tmp_path / "a.policy")
    monkeypatch.setattr(distribution, "_HELD", {})  # as in another process, on another machine
    (tmp_path / "rope.npz").unlink()
    policy = load_policy(tmp_path / "a.policy")
    cell = policy.wrap(TestMismatch().cell(policy, {}, 20), scene=BLUE)
    policy.check_env(cell)
    feature = cell.get_wrapper_attr("features")[0]
    np.testing.assert_array_equal(feature.model.components, model.components)


# ---- goals of several slots


@pytest.fixture
def made() -> Iterator[Any]:
    gym.register("PolicyStrips-v0", "goal_envs:StripsEnv")
    yield lambda: gym.make("PolicyStrips-v0", disable_env_checker=True)
    del gym.registry["PolicyStrips-v0"]


def strips(made: Any, path: Any, wrap: Any = lambda env: env) -> Any:
    source = observing_strips()
    config, features = source.detector.config.to_dict(), source.features
    env = wrap(ShapeObservation(made(), features=features, **config))
    return saved(untrained(env), env, path)


def test_the_slots_that_had_goals_have_them_on_a_robot_too(made, tmp_path):
    policy = strips(made, tmp_path / "a.policy")
    cell = StripsEnv(goals=False)
    env = policy.wrap(cell, scene={"segmentation": observing_strips().detector.config.segmentation})
    assert isinstance(env, ShapeGoal)
    assert env.names == ("strip0", "strip1")
    cell.reset(seed=0)
    observation, _ = env.reset(seed=0, options={"goal": cell.points(cell.end)})
    assert observation["desired_goal"].shape == (72,)
    assert env.action_space.contains(policy.act(observation))
    with pytest.raises(ValueError, match=r"expected goals of 2 shapes"):
        env.reset(options={"goal": cell.points(cell.end)[0]})


def test_recorded_goals_of_several_come_along(made, tmp_path):
    source = observing_strips(goals=False)
    source.reset(seed=0)
    inner: Any = source.unwrapped
    goals: Any = dict(zip(("strip0", "strip1"), inner.points(inner.end).tolist(), strict=True))
    policy = strips(made, tmp_path / "a.policy", lambda env: ShapeGoal(env, goals))
    assert policy.spec.has_goal
    again = policy.wrap(StripsEnv(goals=False), scene={"segmentation": source.detector.config.segmentation})
    assert again.names == ("strip0", "strip1")
    np.testing.assert_allclose(again.reset(seed=0)[0]["desired_goal"][:3], goals["strip0"][0], atol=1e-4)


# ---- ``shape-obs deploy POLICY``, before a simulated robot whose camera is a software D455

CELL = ["--source", "robot", "--robot", "shape_obs_envs.robots:SimulatedRobot"]
with_d455 = pytest.mark.skipif(not find_spec("pyrealsense2"), reason="the software D455 needs librealsense")


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Any:
    """Return an untrained policy for points in the base frame at 20 Hz."""
    path = tmp_path_factory.mktemp("policy") / "cable.policy"
    save_policy(untrained(cable()), cable(), path)
    return path


#: What a busy machine does to images is none of these tests' business.
PATIENT = ["--hold", "20", "--max-age", "5", "--watchdog", "30", "--timeout", "10"]


def test_the_next_command_names_the_robot_of_the_training(path, tmp_path):
    robot = "--source robot --robot shape_obs_envs.robots:SimulatedRobot"
    assert deploy_command(path) == f"shape-obs deploy {path} {robot} --goal robot --episodes 20"
    env = ShapeObservation(gym.make("shape_obs_envs:ShapeObs/Hanging-v0", camera=[84, 84], grippers=1, step=0.01))
    save_policy(untrained(env), env, tmp_path / "hanging one.policy")
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


@with_d455
def test_a_replay_of_a_recorded_run_gives_its_actions(run, path, tmp_path):
    goal, table = tmp_path / "goal.yaml", tmp_path / "shapes.npz"
    Target(tuple((0.3 + 0.01 * i, 0.0, 0.01) for i in range(20))).save(goal)
    options = ["--goal", goal, "--steps", "5", "--record", tmp_path / "run"]
    code, _, err = run("deploy", path, *CELL, *options, *PATIENT)
    assert code == 0, err
    replay = ["replay", tmp_path / "run", "--policy", path]
    code, out, err = run(*replay, "--goal", goal, "--npz", table, "--json")
    assert code == 0, err
    report = json.loads(out)["policy"]
    assert (report["actions"], report["compared"]) == (6, 5)
    assert report["largest"] < 1e-3
    columns = ShapeTable.load(table)
    np.testing.assert_allclose(columns["policy"][0], columns["action"][0], atol=1e-6)
    assert not np.isfinite(columns["action"][5]).any()
    code, _, err = run(*replay)
    assert (code, err.count("\n")) == (2, 1)
    assert "the policy needs a goal: give --goal FILE, as `shape-obs goal` writes it." in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--controller", "shape_obs.deploy:Still"], "expected a trained policy or --controller, got both"),
        (["--controller-set", "share=1"], "--controller-set: a trained policy takes no arguments"),
        ([], "give --goal FILE, or --goal robot if the robot is simulated"),
        (["--goal", "robot", "--episodes", "0"], "--episodes: expected at least 1, got 0"),
        (["--goal", "robot", "--rate", "0"], "--rate: expected a number above 0"),
        (["--goal", "robot", "--robot-set", "env=ShapeObs/Cloth-v0"], "action names: ['gripper0/x'"),
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
