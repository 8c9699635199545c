"""What trainings need besides an env: the curriculum, observations that a shape is compared with, networks' inputs."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from env_checks import check_both
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from installed import needs

import shape_obs_envs  # noqa: F401
from shape_obs import ShapeGoal, ShapeObservation
from shape_obs.training import Curriculum, Pixels, PointReward, Shuffled, TrueState

pytestmark = needs("mujoco")

DIFFICULTIES = ("near", "middle", "far")
POINTS = {"kind": "points3d", "frame": "base"}
CENTROID = {"kind": "centroid", "frame": "base"}


def cable(**options: Any) -> gym.Env[Any, Any]:
    return gym.make("ShapeObs/Cable-v0", camera=[84, 84], renderer="rays", **options)


def blind(**options: Any) -> gym.Env[Any, Any]:
    return gym.make("ShapeObs/Cable-v0", render_observation=False, **options)


def scored(reward_type: Any = "sparse", threshold: float = 0.01) -> PointReward:
    features = [CENTROID, POINTS]
    goal = ShapeGoal(ShapeObservation(cable(), features=features), features=features, threshold=1.0)
    return PointReward(goal, reward_type, threshold)


WRAPPED = {
    "curriculum": lambda: Curriculum(blind(), ["near", "far"]),
    "truth": lambda: TrueState(blind(), ["gripper"]),
    "pixels": lambda: Pixels(cable()),
    "points": scored,
    "shuffled": lambda: Shuffled(TrueState(blind())),
    "shuffled_seen": lambda: Shuffled(ShapeObservation(cable())),
}


class Levels(gym.Env[Any, Any]):
    """An environment with a difficulty and no task."""

    action_space = observation_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)
    difficulty = "middle"

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        return np.zeros(1, np.float32), {}


def drawn(env: Curriculum, episodes: int, seed: int | None = None) -> list[str]:
    found = []
    for _ in range(episodes):
        env.reset(seed=seed)
        seed = None
        found.append(env.unwrapped.difficulty)  # type: ignore[attr-defined]
    return found


@pytest.fixture(scope="module", params=WRAPPED)
def wrapped(request):
    env = WRAPPED[request.param]()
    yield env
    env.close()


def test_both_checkers_pass(wrapped):
    check_both(wrapped)


def test_a_spec_rebuilds_the_env(wrapped):
    again = gym.make(EnvSpec.from_json(wrapped.spec.to_json()))
    try:
        assert again.observation_space == wrapped.observation_space
        first, second = wrapped.reset(seed=3)[0], again.reset(seed=3)[0]
        action = wrapped.action_space.sample()
        one, two = wrapped.step(action), again.step(action)
        for key in wrapped.observation_space.spaces:
            np.testing.assert_array_equal(first[key], second[key])
            np.testing.assert_array_equal(one[0][key], two[0][key])
        assert one[1:4] == two[1:4]
    finally:
        again.close()


def test_rewards_of_a_batch_are_those_of_its_goals_one_by_one(wrapped):
    observation, _ = wrapped.reset(seed=1)
    achieved, desired = observation["achieved_goal"], observation["desired_goal"]
    batch = np.stack([achieved, desired, 0.5 * achieved + 0.5 * desired])
    rewards = wrapped.compute_reward(batch, np.stack(3 * [desired]), [{}] * 3)
    assert rewards.shape == (3,)
    assert rewards.tolist() == [wrapped.compute_reward(goal, desired, {}) for goal in batch]
    assert rewards[1] == 0 > rewards[0]


def test_a_curriculum_draws_from_all_at_once():
    env = Curriculum(Levels(), ["near", "far", "far"])
    found = drawn(env, 40, seed=0)
    assert set(found) == {"near", "far"}
    assert found.count("far") > found.count("near")
    assert drawn(env, 40, seed=0) == found
    assert drawn(env, 40, seed=1) != found
    assert env.episodes == 120


def test_a_curriculum_lets_one_more_join_after_so_many_episodes():
    env = Curriculum(Levels(), DIFFICULTIES, after=20)
    found = drawn(env, 80, seed=0)
    assert set(found[:20]) == {"near"}
    assert set(found[20:40]) == {"near", "middle"}
    assert set(found[40:]) == set(DIFFICULTIES)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda env: Curriculum(env, "near"), "difficulties: expected a list of names, got 'near'"),
        (lambda env: Curriculum(env, after=-1), "after: expected a number of episodes, 0 or more, got -1"),
        (lambda env: Curriculum(gym.make("CartPole-v1")), "has no attribute 'difficulty'"),
        (lambda env: TrueState(gym.make("CartPole-v1")), "TrueState needs an environment with goals"),
        (lambda env: TrueState(env, ["rgb"]), "keep: expected vectors of"),
        (lambda env: Pixels(env), "key: expected an image .* got 'rgb'"),
        (lambda env: scored(threshold=0.0), "threshold above 0 m"),
        (lambda env: PointReward(ShapeGoal(ShapeObservation(cable(), features=[POINTS]))), "'points3d' after them"),
    ],
)
def test_what_does_not_fit_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make(blind())


def test_the_true_state_is_the_simulators():
    env = TrueState(blind(), ["gripper"])
    observation, info = env.reset(seed=5)
    simulator: Any = env.unwrapped
    np.testing.assert_allclose(observation["achieved_goal"].reshape(-1, 3), simulator.truth(), atol=1e-6)
    np.testing.assert_array_equal(observation["observation"][:60], observation["achieved_goal"])
    assert observation["observation"].shape == (70,)
    for action in simulator.goal_actions:
        observation, *_, info = env.step(action)
    distance = np.linalg.norm((observation["achieved_goal"] - observation["desired_goal"]).reshape(-1, 3), axis=1)
    assert distance.mean() == pytest.approx(info["truth/mean_error"], abs=1e-6)


def test_pixels_are_the_cameras():
    env, bare = Pixels(cable()), cable()
    seen, plain = env.reset(seed=2)[0], bare.reset(seed=2)[0]
    np.testing.assert_array_equal(seen["observation"], plain["rgb"])
    np.testing.assert_array_equal(seen["desired_goal"], plain["desired_goal"])
    assert set(seen) == {"observation", "achieved_goal", "desired_goal"}


@pytest.mark.parametrize("reward_type", ["sparse", "dense"])
def test_points_are_rewarded_in_metres_for_any_observation(reward_type):
    env = scored(reward_type, threshold=0.02)
    observation, info = env.reset(seed=0)
    assert env.visible == 3
    assert observation["observation"].shape == (3,)
    demonstration = env.unwrapped.goal_actions  # type: ignore[attr-defined]
    rewards = []
    for action in [*demonstration, *np.zeros((10, 6), np.float32)]:
        observation, reward, _, _, info = env.step(action)
        seen, wanted = (observation[key][3:].reshape(20, 3) for key in ("achieved_goal", "desired_goal"))
        distance = np.linalg.norm(seen - wanted, axis=1).mean()
        assert info["goal/distance"] == pytest.approx(distance, abs=1e-6)
        assert reward == (-1.0 + (distance < 0.02) if reward_type == "sparse" else pytest.approx(-distance, abs=1e-6))
        rewards.append(reward)
    assert rewards[0] < rewards[-1]
    assert info["is_success"]
    assert info["truth/mean_error"] < 0.02
    np.testing.assert_array_equal(observation["observation"], observation["achieved_goal"][:3])


def test_shuffled_points_are_the_same_points_in_another_order():
    env, plain = Shuffled(TrueState(blind())), TrueState(blind())
    observation, ordered = env.reset(seed=4)[0], plain.reset(seed=4)[0]
    orders = set()
    for _ in range(5):
        for key, before in (("achieved_goal", "observation"), ("desired_goal", "desired_goal")):
            shown = observation[before][: env.visible].reshape(20, 3)
            truth = ordered[key].reshape(20, 3)
            assert sorted(map(tuple, shown.tolist())) == sorted(map(tuple, truth.tolist()))
            assert not np.array_equal(shown, truth)
            np.testing.assert_array_equal(observation[key][env.visible :], ordered[key])
            orders.add(tuple(np.argmin(np.linalg.norm(shown[:, None] - truth, axis=2), axis=1)))
        action = env.action_space.sample()
        observation, reward, *_ = env.step(action)
        ordered, plain_reward, *_ = plain.step(action)
        assert reward == plain_reward
    assert len(orders) == 10  # seen and desired separately, again in each frame


@pytest.fixture(scope="module")
def torch() -> Any:
    """Return the module; collecting the tests does not load it."""
    pytest.importorskip("stable_baselines3")
    return pytest.importorskip("torch")


def goals(size: int) -> dict[str, spaces.Space]:
    box = spaces.Box(-1.0, 1.0, (size,), np.float32)
    return {"achieved_goal": box, "desired_goal": box}


def batch(torch: Any, space: spaces.Dict, size: int = 4) -> Any:
    space.seed(0)
    samples = [space.sample() for _ in range(size)]
    return {key: torch.as_tensor(np.stack([sample[key] for sample in samples])) for key in space.spaces}


@pytest.mark.parametrize("visible", [None, 2])
def test_goal_difference(torch, visible):
    from shape_obs.training import GoalDifference

    space = spaces.Dict({"observation": spaces.Box(-1.0, 1.0, (5,), np.float32), **goals(6)})
    extractor = GoalDifference(space, visible)
    seen = batch(torch, space)
    size = visible or 6
    features = extractor(seen)
    assert features.shape == (4, extractor.features_dim) == (4, 5 + 2 * size)
    desired, achieved = seen["desired_goal"][:, :size], seen["achieved_goal"][:, :size]
    torch.testing.assert_close(features, torch.cat([seen["observation"], desired, desired - achieved], dim=1))
    hidden = {**seen, "desired_goal": seen["desired_goal"].clone(), "achieved_goal": seen["achieved_goal"].clone()}
    hidden["desired_goal"][:, size:] += 1
    hidden["achieved_goal"][:, size:] -= 1
    torch.testing.assert_close(extractor(hidden), features)


def test_image_and_goal_reads_no_achieved_goal(torch):
    from shape_obs.training import ImageAndGoal

    image = spaces.Box(0, 255, (3, 40, 48), np.uint8)
    space = spaces.Dict({"observation": image, **goals(6)})
    extractor = ImageAndGoal(space, features=8)
    seen = batch(torch, space)
    seen["observation"] = seen["observation"].float() / 255  # as policies hand images on
    features = extractor(seen)
    assert features.shape == (4, extractor.features_dim) == (4, 14)
    torch.testing.assert_close(features[:, 8:], seen["desired_goal"])
    torch.testing.assert_close(extractor({**seen, "achieved_goal": 0 * seen["achieved_goal"]}), features)
    assert not torch.allclose(extractor({**seen, "observation": 0 * seen["observation"]}), features)
