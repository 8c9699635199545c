"""ShapeGoal with other wrappers, checkers, JSON, copies and vector envs."""

from __future__ import annotations

import copy
import json
import pickle
import warnings

import gymnasium as gym
import numpy as np
import pytest
from goal_envs import BASE, ON, RED, SHAPES, FlatGoalEnv, observing, target_of
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env

from shape_obs import ShapeGoal, ShapeObservation
from shape_obs.features import Points3D

GOALS = ("achieved_goal", "desired_goal")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"goal": {"points": [[0, 0, 0]] * 5, "layout": {"kind": "surface"}}}, "kind 'surface' does not fit shape"),
        ({"goal": [[0, 0, 0.0]] * 2}, "goal of a 'contour': expected at least 3 points, got 2"),
        ({"goal": [[0, 0, 0], [1, 0, np.inf]]}, r"expected 3 finite numbers a point in frame 'base', point 1 is"),
        ({"goal": {"points": [[60, 40], [90, 40], [80, 70]], "frame": "pixels"}}, r"its points are pixels, but"),
        ({"features": ["ok"]}, r"goals need features of the shape's position.*got 'ok'; pass features="),
        ({"features": []}, r"goals need features of the shape's position"),
        ({"features": ["points2d"]}, r"threshold: goals in these features have distances in the unit 'px'; pass thr"),
        ({"features": ["point3d"]}, r"feature: unknown kind 'point3d'; did you mean 'points3d'\?"),
        ({"threshold": 0}, r"threshold: expected a distance above 0, got 0"),
        ({"threshold": True}, r"threshold: expected a distance above 0, got True"),
        ({"reward_type": "spars"}, r"reward_type: unknown value 'spars'; did you mean 'sparse'\?"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        ShapeGoal(observing(), **arguments)


def test_it_needs_a_shape_observation_and_its_vector():
    with pytest.raises(ValueError, match=r"expected an env with a ShapeObservation inside, got .*FlatGoalEnv"):
        ShapeGoal(FlatGoalEnv())
    with pytest.raises(ValueError, match=r"the observation has \['ok', 'age'\]; pass features="):
        ShapeGoal(observing(features=["ok", "age"]))
    renamed = gym.wrappers.TransformObservation(
        observing(), lambda o: {"points": o}, spaces.Dict({"points": observing().observation_space})
    )
    with pytest.raises(ValueError, match="ShapeGoal: expected a Box, or a Dict with a Box as 'shape', got Dict"):
        ShapeGoal(renamed)


def test_wrappers_may_stand_between_and_kept_keys_stay():
    source = gym.wrappers.TimeLimit(observing(keep=["way", "depth"]), 3)
    env = ShapeGoal(source, target_of(observing()))
    observation, _ = env.reset(seed=0)
    assert set(observation) == {"observation", *GOALS, "depth"}
    assert observation["observation"].shape == (73,)
    assert [env.step(ON)[3] for _ in range(3)] == [False, False, True]
    own = ShapeGoal(observing(goals=True, keep=["way", "depth"]))
    observation, _ = own.reset(seed=0)
    assert set(observation) == {"observation", *GOALS, "depth"}
    assert observation["observation"].shape == (73,)
    assert own.observation_space.contains(observation)


@pytest.mark.parametrize("goals", [True, False])
def test_gymnasiums_and_sb3s_checkers_are_content(goals):
    source = observing(goals=goals, features=[BASE, "ok"], keep=["way"])
    env = ShapeGoal(source, None if goals else target_of(source))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*is different from the unwrapped version")
        check_env(env, skip_render_check=True)
        pytest.importorskip("stable_baselines3.common.env_checker").check_env(env, warn=True)


def test_it_is_rebuilt_from_json():
    gym.register("TestGoal-v0", "goal_envs:FlatGoalEnv", kwargs={"kind": "contour", "goals": False, "tilt": 0})
    try:
        source = ShapeObservation(gym.make("TestGoal-v0"), [SHAPES["contour"]], RED, [BASE])
        goal = np.array(target_of(source))
        features = (feature for feature in [Points3D(frame="base")])
        env = ShapeGoal(source, goal, features, reward_type="sparse", threshold=0.02)
        assert env.spec is not None
        text = env.spec.to_json()
        assert json.loads(text)["additional_wrappers"][-1]["kwargs"]["goal"]["frame"] == "base"
        again = gym.make(EnvSpec.from_json(text))
        assert isinstance(again, ShapeGoal)
        mine, theirs = env.reset(seed=4)[0], again.reset(seed=4)[0]
        for _ in range(3):
            for key in mine:
                np.testing.assert_array_equal(mine[key], theirs[key])
            (mine, reward, *_), (theirs, other, *_) = env.step(ON), again.step(ON)
            assert reward == other
    finally:
        del gym.registry["TestGoal-v0"]


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("goals", [True, False])
def test_a_copy_goes_on_like_the_original(copied, goals):
    env = ShapeGoal(observing(goals=goals), None if goals else target_of(observing()))
    env.reset(seed=0)
    env.step(ON)
    twin = copied(env)
    for _ in range(3):
        mine, its = env.step(ON), twin.step(ON)
        for key in mine[0]:
            np.testing.assert_array_equal(mine[0][key], its[0][key])
        assert mine[1:] == its[1:]


def test_what_is_returned_is_the_callers_own():
    env, twin = (ShapeGoal(observing(), target_of(observing())) for _ in range(2))
    observation, _ = env.reset(seed=0)
    twin.reset(seed=0)
    for _ in range(3):
        for value in observation.values():
            value[:] = 0
        observation, expected = env.step(ON)[0], twin.step(ON)[0]
        for key in observation:
            np.testing.assert_array_equal(observation[key], expected[key])
