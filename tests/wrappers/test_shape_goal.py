"""ShapeGoal: goals in features over goal-conditioned envs and any others; JSON, copies and other wrappers."""

from __future__ import annotations

import json
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from env_checks import check_both
from goal_envs import BASE, ON, RED, SHAPES, FlatGoalEnv, observing, target_of
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec

from shape_obs import ShapeGoal, ShapeObservation
from shape_obs.features import Points3D

GOALS = ("achieved_goal", "desired_goal")


def mean_distance(achieved: Any, desired: Any, d: int = 3) -> Any:
    apart = (np.asarray(achieved, float) - desired).reshape(*np.shape(achieved)[:-1], -1, d)
    return np.linalg.norm(apart, axis=-1).mean(axis=-1)


@pytest.mark.parametrize("goals", [True, False])
@pytest.mark.parametrize("kind", SHAPES)
def test_a_goal_is_approached_and_reached(kind, goals):
    source = observing(kind, goals=goals)
    layout = {"kind": kind, "rows": 5, "cols": 7} if kind == "surface" else {"kind": kind}
    goal = None if goals else {"points": target_of(source), "layout": layout}
    env = ShapeGoal(source, goal, threshold=0.004)
    assert env.unit == "m"
    observation, info = env.reset(seed=0)
    distances, reached = [info["goal/distance"]], [info["is_success"]]
    for _ in range(10):
        assert env.observation_space.contains(observation)
        observation, reward, terminated, truncated, info = env.step(ON)
        assert reward == -info["goal/distance"] == -float(mean_distance(*(observation[k] for k in GOALS)))
        assert not terminated
        assert not truncated
        distances.append(info["goal/distance"])
        reached.append(info["is_success"])
    assert np.all(np.diff(distances) < 0.001)
    assert distances[-1] < 0.1 * distances[0]
    assert (reached[0], reached[-1]) == (False, True)


@pytest.mark.parametrize(
    ("features", "size", "unit"),
    [
        (["points3d"], 72, "m"),
        ("points3d", 72, "m"),
        (["points2d"], 48, "px"),
        (["points2d_normalized"], 48, "of half the image"),
        ([BASE, Points3D(frame="camera")], 144, "m"),
        (["points2d", "points3d"], 120, "of the range"),
    ],
)
def test_goals_may_be_in_some_features_or_in_others(features, size, unit):
    env = ShapeGoal(observing(goals=True, features=[BASE, "ok"]), features=features, threshold=0.1)
    observation, _ = env.reset(seed=0)
    assert observation["observation"].shape == (73,)
    assert observation["achieved_goal"].shape == observation["desired_goal"].shape == (size,)
    assert env.unit == unit
    if features == ["points3d"]:  # that of the observation, in its frame
        np.testing.assert_array_equal(observation["achieved_goal"], observation["observation"][:72])


class TestReward:
    def test_distances_are_as_documented(self):
        env = ShapeGoal(observing(goals=True), features=["points2d"], threshold=0.5)
        a, b = np.random.default_rng(0).uniform(-1, 1, (2, 4, 5, 48))
        np.testing.assert_allclose(env.compute_reward(a, b, None), -mean_distance(a, b, 2))
        assert isinstance(env.compute_reward(a[0, 0], b[0, 0], {}), float)
        env = ShapeGoal(observing(goals=True), features=["points2d", "points3d"], threshold=0.5)
        space: Any = env.observation_space["achieved_goal"]  # type: ignore[index]
        a, b = np.random.default_rng(0).uniform(-1, 1, (2, 7, 120))
        by_hand = np.sqrt(np.mean(((a - b) / (space.high - space.low.astype(float))) ** 2, axis=1))
        np.testing.assert_allclose(env.compute_reward(a, b, [{}] * 7), -by_hand)

    def test_sparse_is_zero_below_the_threshold_and_else_minus_one(self):
        env = ShapeGoal(observing(goals=True), reward_type="sparse")
        assert env.threshold == 0.01
        a = np.zeros((2, 72), np.float32)
        a[1] = 0.02
        np.testing.assert_array_equal(env.compute_reward(a, np.zeros_like(a), None), [0, -1])
        env.reset(seed=0)
        assert env.step(ON)[1] == -1.0

    def test_the_envs_own_reward_and_success_stay_apart(self):
        env = ShapeGoal(observing(goals=True), threshold=1e-6)
        _, info = env.reset(seed=0)
        assert (info["is_success"], info["truth/is_success"]) == (False, False)
        for way in range(1, 11):
            _, reward, _, _, info = env.step(ON)
            assert info["truth/reward"] == pytest.approx(way / 10)
            assert reward == -info["goal/distance"]
        assert (info["is_success"], info["truth/is_success"]) == (False, True)
        plain = ShapeGoal(observing(), target_of(observing()))
        _, info = plain.reset(seed=0)
        assert "truth/is_success" not in info
        assert plain.step(ON)[4]["truth/reward"] == pytest.approx(0.1)


class TestGoals:
    def test_one_for_an_episode_and_other_options_go_on(self):
        source = observing()
        first, other = target_of(source, 1), target_of(source, 2)
        env = ShapeGoal(source, first)
        usual = env.reset(seed=0)[0]["desired_goal"]
        given = env.reset(seed=0, options={"goal": np.array(other)})[0]["desired_goal"]
        assert np.abs(given - usual).max() > 0.01
        np.testing.assert_array_equal(env.reset(seed=0)[0]["desired_goal"], usual)
        with pytest.raises(ValueError, match=r"no options, got {'start': 1}"):
            env.reset(options={"goal": other, "start": 1})
        options = {"goal": other}
        env.reset(options=options)
        assert list(options) == ["goal"]

    def test_there_must_be_one(self):
        env = ShapeGoal(observing())
        with pytest.raises(ValueError, match=r"no goal, and the env provides none. Pass goal=Target\(points\) to the"):
            env.reset(seed=0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"goal": {"points": [[0, 0, 0]] * 5, "layout": {"kind": "surface"}}}, "kind 'surface' does not fit shape"),
        ({"goal": [[0, 0, 0.0]] * 2}, "goal of a 'contour': expected at least 3 points, got 2"),
        ({"goal": {"points": [[60, 40], [90, 40], [80, 70]], "frame": "pixels"}}, r"its points are pixels, but"),
        ({"features": ["ok"]}, r"goals need features of the shape's position.*got 'ok'; pass features="),
        ({"features": ["points2d"]}, r"threshold: goals in these features have distances in the unit 'px'; pass thr"),
        ({"threshold": 0}, r"threshold: expected a distance above 0, got 0"),
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
def test_both_checkers_pass(goals):
    source = observing(goals=goals, features=[BASE, "ok"], keep=["way"])
    check_both(ShapeGoal(source, None if goals else target_of(source)))


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
