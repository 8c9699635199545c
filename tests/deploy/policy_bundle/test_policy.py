"""Bundles in other environments: differences are refused by name."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from bundles import POINTS, WORKSPACE, cable, learner, train
from fake_cell import rope_camera
from goal_envs import StripsEnv, observing_strips
from installed import needs

import shape_obs_envs  # noqa: F401
from shape_obs import ShapeGoal, ShapeObservation, load_bundle, save_bundle
from shape_obs.deploy.policy_bundle import BundleError
from shape_obs.deploy.policy_bundle.limits import check_goal
from shape_obs.training import PointReward, TrueState
from shape_obs_envs.robots import NullRobot

pytestmark = needs("mujoco", "stable_baselines3")


@pytest.fixture(scope="module")
def bundle(tmp_path_factory) -> Any:
    path = tmp_path_factory.mktemp("bundle") / "cable.policy"
    train(path)
    return load_bundle(path)


class TestMismatch:
    """Each difference is named, with both values."""

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"shapes": [{"kind": "centerline", "n": 10, "anchor": "gripper0"}]}, r"shapes\[0\].n: 20 in training, 10"),
            (
                {"shapes": [{"kind": "centerline", "anchor": "gripper0"}]},
                r"shapes\[0\].ends: 'tips' in training, 'cent",
            ),
            ({"features": [POINTS, "ok"]}, r"features\[1\]: None in training, {'kind': 'ok'} here"),
            (
                {"features": [{**POINTS, "origin": "centroid"}]},
                r"features\[0\].origin: None in training, 'centroid'",
            ),
            ({"features": [{"kind": "points3d"}]}, r"features\[0\].frame: 'base' in training, 'camera' here"),
            ({"keep": ["gripper"]}, r"observation 'observation' shape: \[60\] in training, \[70\] here"),
            ({"clustering": "kmeans", "shapes": ["centerline"]}, "clustering kind: 'som' in training, 'kmeans' here"),
        ],
    )
    def test_of_what_is_seen(self, bundle, options, message):
        with pytest.raises(BundleError, match=f"does not fit this environment: .*{message}"):
            bundle.check_env(cable(**options))

    @pytest.mark.parametrize(
        ("changes", "rate", "message"),
        [
            ({"scale": [0.02] * 6}, 20, r"action scale: \[0.015, .* in training, \[0.02, "),
            ({"units": ["m"] * 6}, 20, "action units: .*'rad'.* in training, .* here"),
            ({"mode": "velocity"}, 20, "action mode: 'displacement' in training, 'velocity' here"),
            ({"frame": "gripper"}, 20, "action frame: 'base' in training, 'gripper' here"),
            ({}, 30, r"dt \[s\]: 0.05 in training, 0.033333 here"),
        ],
    )
    def test_of_what_is_done(self, bundle, changes, rate, message):
        env = bundle.wrap(self.cell(bundle, changes, rate), scene=BLUE)
        with pytest.raises(BundleError, match=message):
            bundle.check_env(env)

    def test_what_may_differ(self, bundle):
        assert bundle.differences(cable(workspace=WORKSPACE, segmentation=BLUE["segmentation"])) == []
        shapes = [{**shape, "length": 0.8} for shape in bundle.record.config["shapes"]]
        assert bundle.differences(cable(shapes=shapes, max_speed=3.0)) == []
        slow = bundle.wrap(self.cell(bundle, {"low": [-0.3] * 6}, 30), scene=BLUE)
        assert bundle.differences(slow, same_rate=False) == []
        assert isinstance(slow, ShapeGoal)
        other = bundle.wrap(self.cell(bundle, {}, 20), scene={**BLUE, "shapes": shapes, "max_speed": 3.0})
        config = other.get_wrapper_attr("detector").config
        assert (config.shapes[0].length, config.max_speed) == (0.8, 3.0)

    def test_a_camera_without_extrinsics(self, bundle):
        env = self.cell(bundle, {}, 20)
        env.unwrapped.source.extrinsics = None  # as of a camera without --extrinsics
        with pytest.raises(BundleError, match=r"'points3d' in the base frame, .* give --extrinsics"):
            bundle.wrap(env, scene=BLUE)

    def cell(self, bundle, changes, rate) -> Any:
        spec = {**bundle.action_spec.to_dict(), **changes}
        return gym.make(
            "shape_obs_envs:ShapeObs/D455-v0",
            source=rope_camera(),
            robot=NullRobot(spec=spec),
            rate=rate,
            size=[160, 120],
            disable_env_checker=True,
        )


def rescaled() -> Any:
    bounds: Any = -2.0, 2.0
    return gym.wrappers.RescaleAction(cable(), *bounds)


BLUE = {"segmentation": {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]}}


class TestDeployable:
    @pytest.mark.parametrize(
        ("make", "reason"),
        [
            (lambda: TrueState(gym.make("ShapeObs/Cable-v0", render_observation=False)), "simulator's state"),
            (lambda: cable(keep=["gripper"]), "it also reads gripper, which only its simulator provides"),
            (rescaled, "the wrapper RescaleAction does on a robot"),
        ],
    )
    def test_what_only_a_simulator_has_is_kept_and_rebuilt_but_not_deployed(self, tmp_path, make, reason):
        env = make()
        save_bundle(learner(env), env, tmp_path / "a.policy")
        bundle = load_bundle(tmp_path / "a.policy")
        again = bundle.make_env()
        assert again.action_space.contains(bundle.act(again.reset(seed=0)[0]))
        with pytest.raises(BundleError, match=f"the policy cannot be deployed: .*{reason}"):
            bundle.controller()

    def test_wrappers_that_belong_to_the_policy_come_along(self, tmp_path):
        features = ["centroid", POINTS]
        env = PointReward(ShapeGoal(cable(features=features), features=features, threshold=1.0), threshold=0.02)
        save_bundle(learner(env), env, tmp_path / "a.policy")
        bundle = load_bundle(tmp_path / "a.policy")
        cell = bundle.wrap(TestMismatch().cell(bundle, {}, 20), scene=BLUE)
        assert isinstance(cell, PointReward)
        assert cell.threshold == 0.02
        bundle.check_env(cell)


# ---- goals of several slots


@pytest.fixture
def made() -> Iterator[Any]:
    gym.register("BundleStrips-v0", "goal_envs:StripsEnv")
    yield lambda: gym.make("BundleStrips-v0", disable_env_checker=True)
    del gym.registry["BundleStrips-v0"]


def saved(made: Any, path: Any, wrap: Any = lambda env: env) -> Any:
    source = observing_strips()
    config, features = source.detector.config.to_dict(), source.features
    env = wrap(ShapeObservation(made(), features=features, **config))
    save_bundle(learner(env), env, path)
    return load_bundle(path)


def test_the_slots_that_had_goals_have_them_on_a_robot_too(made, tmp_path):
    bundle = saved(made, tmp_path / "a.policy")
    cell = StripsEnv(goals=False)
    env = bundle.wrap(cell, scene={"segmentation": observing_strips().detector.config.segmentation})
    assert isinstance(env, ShapeGoal)
    assert env.names == ("strip0", "strip1")
    cell.reset(seed=0)
    observation, _ = env.reset(seed=0, options={"goal": cell.points(cell.end)})
    assert observation["desired_goal"].shape == (72,)
    assert env.action_space.contains(bundle.act(observation))
    with pytest.raises(ValueError, match=r"expected goals of 2 shapes"):
        env.reset(options={"goal": cell.points(cell.end)[0]})


def test_recorded_goals_of_several_come_along(made, tmp_path):
    source = observing_strips(goals=False)
    source.reset(seed=0)
    inner: Any = source.unwrapped
    goals: Any = dict(zip(("strip0", "strip1"), inner.points(inner.end).tolist(), strict=True))
    bundle = saved(made, tmp_path / "a.policy", lambda env: ShapeGoal(env, goals))
    assert bundle.has_goal
    again = bundle.make_env()
    assert again.names == ("strip0", "strip1")
    np.testing.assert_allclose(again.reset(seed=0)[0]["desired_goal"][:3], goals["strip0"][0], atol=1e-4)


def test_a_configuration_in_one_of_several_goals_is_checked():
    goal = {"strip0": {"points": [[0, 0, 0]], "configuration": {"kind": "no such kind"}}}
    with pytest.raises((BundleError, ValueError), match="no such kind"):
        check_goal({"goal": goal}, "the goal")
