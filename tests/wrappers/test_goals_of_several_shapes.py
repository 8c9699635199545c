"""Goals of several shapes at once: slots of one configuration, from the env, from points and from recordings."""

from __future__ import annotations

import json
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from goal_envs import observing_strips

from shape_obs import ShapeGoal, Target, record_goal, record_goals

GOALS = ("achieved_goal", "desired_goal")
NAMES = ("strip0", "strip1")
ON = np.ones(2, np.float32)


def truth(env: gym.Env[Any, Any]) -> np.ndarray:
    """Return the points to which the strips are to be brought."""
    inner: Any = env.unwrapped
    return inner.points(inner.end)


def mean_distance(achieved: Any, desired: Any) -> Any:
    apart = (np.asarray(achieved, float) - desired).reshape(*np.shape(achieved)[:-1], -1, 3)
    return np.linalg.norm(apart, axis=-1).mean(axis=-1)


def test_the_envs_goals_are_those_of_as_many_slots_as_it_says():
    source = observing_strips()
    assert source.goal_count == 2
    observation, _ = source.reset(seed=0)
    assert observation["observation"].shape == (2 * 37,)
    rows = observation["observation"].reshape(2, 37)
    np.testing.assert_array_equal(observation["achieved_goal"], rows[:, :36].ravel())
    ends = observation["desired_goal"].reshape(2, 12, 3)[:, [0, -1]]
    np.testing.assert_allclose(ends, truth(source)[:, [0, -1]], atol=1e-4)
    assert [shape.name for shape in source.targets] == ["strip0", "strip1"]
    assert source.target is source.targets[0]
    rewards: list[Any] = []
    for _ in range(10):
        observation, reward, _, _, _ = source.step(ON)
        assert reward == pytest.approx(-mean_distance(*(observation[key] for key in GOALS)))
        rewards.append(reward)
    assert rewards[-1] > -0.004


@pytest.mark.parametrize("given", ["env", "points", "mapping", "targets"])
def test_all_slots_are_brought_to_their_goals(given):
    source = observing_strips(goals=given == "env")
    source.reset(seed=3)
    points = truth(source)
    goals: dict[str, Any] = {
        "env": None,
        "points": points,
        "mapping": dict(zip(reversed(NAMES), reversed(points.tolist()), strict=True)),
        "targets": [Target.read(each) for each in points],
    }
    shape = "strip" if given in ("points", "targets") else None
    env = ShapeGoal(source, goals[given], shape=shape, threshold=0.004)
    assert set(env.names) == set(NAMES)
    observation, info = env.reset(seed=3)
    assert observation["achieved_goal"].shape == observation["desired_goal"].shape == (72,)
    distances = [info["goal/distance"]]
    for _ in range(10):
        assert env.observation_space.contains(observation)
        observation, reward, _, _, info = env.step(ON)
        assert reward == -info["goal/distance"] == pytest.approx(-mean_distance(*(observation[key] for key in GOALS)))
        distances.append(info["goal/distance"])
    assert np.all(np.diff(distances) < 0.001)
    assert info["is_success"]
    assert [shape.name for shape in env.targets] == list(env.names) == [shape.name for shape in env.goal_shapes]


def test_one_of_two_at_its_goal_is_no_success_nor_is_a_slot_that_is_lost():
    reached = []
    for shape in ("strip", "strip0"):
        env = ShapeGoal(observing_strips(), shape=shape, threshold=0.004)
        env.reset(seed=0)
        reached.append([env.step(np.array([1.0, 0.0], np.float32))[4] for _ in range(10)][-1]["is_success"])
    assert reached == [False, True]
    env = ShapeGoal(observing_strips(), threshold=0.05)
    assert env.reset(seed=0)[1]["is_success"]
    inner: Any = env.unwrapped
    inner.hidden = {1}
    info = [env.step(0 * ON)[4] for _ in range(20)][-1]
    assert (info["shape/strip0/ok"], info["shape/strip1/ok"], info["is_success"]) == (True, False, False)


def test_recorded_goals_are_the_slots_of_the_frame():
    source = observing_strips(goals=False)
    source.reset(seed=4)
    for _ in range(6):
        source.step(ON)
    goals = record_goals(source, "strip")
    assert list(goals) == ["strip0", "strip1"]
    assert goals["strip1"] == record_goal(source, "strip1")
    plain = {name: goal.to_dict() for name, goal in goals.items()}
    env = ShapeGoal(source, json.loads(json.dumps(plain)), threshold=0.003)
    env.reset(seed=4)
    assert not env.step(ON)[4]["is_success"]
    infos = [env.step(ON)[4] for _ in range(5)]
    assert infos[-1]["is_success"]
    assert env.record_goals() == record_goals(env, list(NAMES))
    with pytest.raises(ValueError, match=r"'strip' has the slots \['strip0', 'strip1'\]: name one, or call record_go"):
        record_goal(source, "strip")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"goal": {"strip0": [[0, 0, 0.0]] * 3, "strip1": [[0, 0, 0.0]] * 3, "strip7": 1}}, "no shape named 'strip7'"),
        ({"goal": {"strip0": [[0, 0, 0.0]] * 3}, "shape": "strip"}, r"a target for each of the shapes \['strip0'"),
        ({"goal": np.zeros((3, 5, 3)), "shape": "strip"}, r"expected goals of 2 shapes, a mapping \{'strip0'"),
        ({"shape": ["strip", "strip0"]}, r"expected names of shapes, each once, got \['strip', 'strip0'\]"),
        ({"shape": "strp"}, "no shape named 'strp'; did you mean 'strip'"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        ShapeGoal(observing_strips(), **arguments)


def test_the_envs_goals_need_as_many_slots():
    with pytest.raises(ValueError, match=r"the env's goals are those of shape 'strip0': pass a goal= for shape"):
        ShapeGoal(observing_strips(counted=False), shape="strip1")
    source = observing_strips()
    inner: Any = source.env
    rope, blob = {"kind": "centerline", "name": "rope", "n": 12, "ends": "tips"}, {"kind": "contour", "name": "blob"}
    for shapes, count, message in (
        ([rope], 2, r"goals of 2 shapes: expected at least 2 shapes or slots, got \['rope'\]"),
        ([rope], 0, "count: expected the number of shapes that have a goal, got 0"),
        ([rope, blob], 2, "layout 'centerline': shape 'blob' must be a 'centerline', got 'contour'"),
    ):
        inner.goal_layout = {"kind": "centerline", "count": count}
        with pytest.raises(ValueError, match=message):
            type(source)(inner, shapes, source.detector.config.segmentation, ["points3d"])
