"""Bundles of policies whose environment had goals of several slots."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from bundles import learner
from installed import needs
from strips_env import StripsEnv, observing_strips

from shape_obs import ShapeGoal, ShapeObservation, load_bundle, save_bundle
from shape_obs.deploy.policy_bundle import BundleError

pytestmark = needs("mujoco", "stable_baselines3")


@pytest.fixture
def made() -> Iterator[Any]:
    gym.register("BundleStrips-v0", "strips_env:StripsEnv")
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
    from shape_obs.deploy.policy_bundle.limits import check_goal

    goal = {"strip0": {"points": [[0, 0, 0]], "configuration": {"kind": "no such kind"}}}
    with pytest.raises((BundleError, ValueError), match="no such kind"):
        check_goal({"goal": goal}, "the goal")
