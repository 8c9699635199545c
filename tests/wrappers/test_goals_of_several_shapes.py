"""Goals of several shapes at once: slots of one configuration, from the env, from points and from recordings."""

from __future__ import annotations

import json
import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from strips_env import StripsEnv, observing_strips

from shape_obs import ShapeGoal, Target, record_goal, record_goals
from shape_obs.servo import ShapeServo
from shape_obs.training import PointReward

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


def test_one_of_two_at_its_goal_is_no_success():
    reached = []
    for shape in ("strip", "strip0"):
        env = ShapeGoal(observing_strips(), shape=shape, threshold=0.004)
        env.reset(seed=0)
        infos = [env.step(np.array([1.0, 0.0], np.float32))[4] for _ in range(10)]
        reached.append(infos[-1]["is_success"])
    assert reached == [False, True]


def test_a_slot_that_is_lost_is_no_success():
    source = observing_strips()
    env = ShapeGoal(source, threshold=0.05)
    assert env.reset(seed=0)[1]["is_success"]
    inner: Any = env.unwrapped
    inner.hidden = {1}
    infos = [env.step(0 * ON)[4] for _ in range(20)]
    assert infos[-1]["shape/strip0/ok"]
    assert not infos[-1]["shape/strip1/ok"]
    assert not infos[-1]["is_success"]


def test_one_slot_may_have_its_part_of_the_envs_goals():
    both, second = ShapeGoal(observing_strips()), ShapeGoal(observing_strips(), shape="strip1")
    whole, part = both.reset(seed=1)[0], second.reset(seed=1)[0]
    for key in GOALS:
        np.testing.assert_array_equal(part[key], whole[key][36:])
    turned = ShapeGoal(observing_strips(), shape=["strip1", "strip0"]).reset(seed=1)[0]
    for key in GOALS:
        np.testing.assert_array_equal(turned[key].reshape(2, 36), whole[key].reshape(2, 36)[::-1])


def test_one_goal_among_several_slots_is_as_before():
    """A single goal, which the env has without a count, gives bit for bit what slot 0 has in the goals of both."""
    alone, both = ShapeGoal(observing_strips(counted=False)), ShapeGoal(observing_strips())
    assert alone.names == ("strip0",)
    one, two = alone.reset(seed=2), both.reset(seed=2)
    for _ in range(3):
        for key in GOALS:
            np.testing.assert_array_equal(one[0][key], two[0][key][:36])
        one, two = alone.step(ON), both.step(ON)


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


def test_a_reset_takes_goals_for_one_episode():
    source = observing_strips()
    env = ShapeGoal(source)
    source.reset(seed=5)
    other = truth(source)[::-1]
    usual, given = env.reset(seed=1)[0], env.reset(seed=1, options={"goal": other})[0]
    assert np.abs(given["desired_goal"] - usual["desired_goal"]).max() > 0.05
    np.testing.assert_array_equal(env.reset(seed=1)[0]["desired_goal"], usual["desired_goal"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"goal": {"strip0": [[0, 0, 0.0]] * 3, "strip1": [[0, 0, 0.0]] * 3, "strip7": 1}}, "no shape named 'strip7'"),
        (
            {"goal": {"strip0": [[0, 0, 0.0]] * 3}, "shape": "strip"},
            r"a target for each of the shapes \['strip0', 'strip1'\], got \['strip0'\]",
        ),
        (
            {"goal": np.zeros((3, 5, 3)), "shape": "strip"},
            r"expected goals of 2 shapes, a mapping \{'strip0': points, ...\} of .* or points \(2, K, 3\).*got 3",
        ),
        ({"goal": Target(3 * ((0, 0, 0.0),)), "shape": "strip"}, r"expected goals of 2 shapes, .*, got 1"),
        ({"shape": []}, r"expected names of shapes, each once, got \[\]; there are \['strip0', 'strip1'\]"),
        ({"shape": ["strip", "strip0"]}, r"expected names of shapes, each once, got \['strip', 'strip0'\]"),
        ({"shape": "strp"}, "no shape named 'strp'; did you mean 'strip'"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        ShapeGoal(observing_strips(), **arguments)


def test_the_envs_goals_need_as_many_slots():
    with pytest.raises(
        ValueError, match=r"the env's goals are those of shape 'strip0': pass a goal= for shape 'strip1"
    ):
        ShapeGoal(observing_strips(counted=False), shape="strip1")
    source = observing_strips()
    shapes = [{"kind": "centerline", "name": "rope", "n": 12, "ends": "tips"}]
    inner: Any = source.env
    with pytest.raises(ValueError, match=r"goals of 2 shapes: expected at least 2 shapes or slots, got \['rope'\]"):
        type(source)(inner, shapes, source.detector.config.segmentation, ["points3d"])
    inner.goal_layout = {"kind": "centerline", "count": 0}
    with pytest.raises(ValueError, match="count: expected the number of shapes that have a goal, got 0"):
        type(source)(inner, shapes, source.detector.config.segmentation, ["points3d"])
    inner.goal_layout = {"kind": "centerline", "count": 2}
    with pytest.raises(ValueError, match="layout 'centerline': shape 'blob' must be a 'centerline', got 'contour'"):
        type(source)(
            inner, [*shapes, {"kind": "contour", "name": "blob"}], source.detector.config.segmentation, ["points3d"]
        )


def test_other_features_of_several_have_one_distance():
    env = ShapeGoal(observing_strips(), features=["points2d", "points3d"], threshold=0.5)
    space: Any = env.observation_space["achieved_goal"]  # type: ignore[index]
    assert space.shape == (2 * 60,)
    a, b = np.random.default_rng(0).uniform(-1, 1, (2, 7, 120))
    by_hand = np.sqrt(np.mean(((a - b) / (space.high - space.low.astype(float))) ** 2, axis=1))
    np.testing.assert_allclose(env.compute_reward(a, b, [{}] * 7), -by_hand)
    assert ShapeGoal(observing_strips(), features=["points2d"], threshold=2.0).unit == "px"


def test_rewards_are_computed_in_batches_for_hindsight_replay():
    replay = pytest.importorskip("stable_baselines3.her.her_replay_buffer")
    dummy = pytest.importorskip("stable_baselines3.common.vec_env").DummyVecEnv
    limited = gym.wrappers.TimeLimit(ShapeGoal(observing_strips()), 5)
    env = dummy([lambda: limited])
    memory = replay.HerReplayBuffer(100, env.observation_space, env.action_space, env, n_sampled_goal=4)
    observation = env.reset()
    for _ in range(15):
        following, reward, done, infos = env.step(ON[None])
        last = infos[0].get("terminal_observation", {})
        memory.add(observation, {**following, **{k: v[None] for k, v in last.items()}}, ON[None], reward, done, infos)
        observation = following
    batch = memory.sample(64)
    next_ones = batch.next_observations["achieved_goal"].numpy()
    expected = -mean_distance(next_ones, batch.observations["desired_goal"].numpy())
    np.testing.assert_allclose(batch.rewards.numpy()[:, 0], expected, atol=1e-6)


@pytest.mark.parametrize("goals", [True, False])
def test_gymnasiums_and_sb3s_checkers_are_content(goals):
    source = observing_strips(goals=goals)
    source.reset(seed=0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*is different from the unwrapped version")
        env = ShapeGoal(source, None if goals else truth(source), shape="strip")
        check_env(env, skip_render_check=True)
        pytest.importorskip("stable_baselines3.common.env_checker").check_env(env, warn=True)


def test_it_is_rebuilt_from_json():
    gym.register("TestStrips-v0", "strips_env:StripsEnv", kwargs={"goals": False})
    try:
        source = observing_strips(goals=False)
        made = type(source)(gym.make("TestStrips-v0"), **source.detector.config.to_dict())
        source.reset(seed=0)
        env = ShapeGoal(made, dict(zip(NAMES, truth(source), strict=True)))
        assert env.spec is not None
        again = gym.make(EnvSpec.from_json(env.spec.to_json()))
        assert isinstance(again, ShapeGoal)
        assert again.names == NAMES
        mine, its = env.reset(seed=4)[0], again.reset(seed=4)[0]
        for key in mine:
            np.testing.assert_array_equal(mine[key], its[key])
    finally:
        del gym.registry["TestStrips-v0"]


def test_a_servo_brings_both_to_their_goals():
    env = ShapeGoal(observing_strips(), threshold=0.003)
    servo = ShapeServo("rls")
    servo.attach(env)
    observation, info = env.reset(seed=0)
    for _ in range(40):
        observation, _, _, _, info = env.step(servo.act(observation))
    assert info["is_success"]
    inner: Any = env.unwrapped
    assert isinstance(inner, StripsEnv)
    inner.hidden = {1}
    for _ in range(20):
        observation = env.step(servo.act(observation))[0]
    assert servo.held > 0


def test_a_reward_of_points_is_of_one_shape():
    env = ShapeGoal(observing_strips(), features=["points2d", "points3d"], threshold=0.5)
    with pytest.raises(ValueError, match=r"goal of one shape, got \['strip0', 'strip1'\]; pass ShapeGoal a shape="):
        PointReward(env)
