"""ShapeServo reaches goals, learns only from measured points, and otherwise stands still."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shape_obs import CameraModel, Intrinsics, Shape, ShapeGoal, ShapeObservation
from shape_obs.deploy import Controller
from shape_obs.deploy.controller import check_controller
from shape_obs.features import FeatureContext, read_features
from shape_obs.geometry.topology import Chain, Grid, Ring
from shape_obs.robot import ActionSpec
from shape_obs.servo import LAWS, DampedLeastSquares, Excitation, RecursiveLeastSquares, ShapeServo, geometric_weights

POINTS = 8


class Plant:
    """A linear plant, ``x += J a``, whose features are noisy; `lost` marks the shape as lost."""

    def __init__(self, seed: int = 0, features: int = 6, actions: int = 3, noise: float = 1e-3) -> None:
        self._rng = np.random.default_rng(seed)
        self.matrix = 0.01 * self._rng.normal(size=(features, actions))
        self.x, self.noise = np.zeros(features), noise
        self.goal = self.matrix @ self._rng.uniform(-8, 8, actions)
        self.valid, self.reason, self.blank = POINTS, "", False

    def seen(self) -> Shape:
        zeros = np.zeros((POINTS, 2), np.float32)
        known = np.arange(POINTS) < self.valid
        return Shape("rope", zeros, None, visible=known, valid=known, layout=Chain(POINTS), reason=self.reason)

    def observation(self) -> dict[str, Any]:
        seen = self.x + self.noise * self._rng.normal(size=len(self.x))
        return {"achieved_goal": np.full_like(seen, np.nan) if self.blank else seen, "desired_goal": self.goal}

    def away(self) -> float:
        return float(np.linalg.norm(self.goal - self.x) / np.linalg.norm(self.goal))

    def run(self, servo: ShapeServo, steps: int) -> np.ndarray:
        actions = np.array([self._step(servo) for _ in range(steps)])
        assert np.abs(actions).max() <= 1
        return actions

    def _step(self, servo: ShapeServo) -> np.ndarray:
        action = servo.act(self.observation())
        self.x = self.x + self.matrix @ action
        return action


def servo_of(plant: Plant, law: Any = "mfac", **options: Any) -> ShapeServo:
    return ShapeServo(law, actions=plant.matrix.shape[1], seen=plant.seen, **options)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("weights", [None, "noise", 3 * np.eye(6)])
def test_it_reaches_the_goal_of_a_linear_plant(law, weights):
    plant = Plant()
    servo = servo_of(plant, law, weights=weights)
    plant.run(servo, 25)
    assert not servo.exciting
    # Model-free adaptive control goes downhill, which takes its time across a valley.
    plant.run(servo, 300 if law == "mfac-law" else 75)
    assert plant.away() < 0.1
    assert servo.held == 0


def test_at_first_each_coordinate_moves_there_and_back():
    plant = Plant()
    servo = servo_of(plant, excitation=Excitation(0.5, 3))
    assert servo.exciting
    actions = plant.run(servo, 18)
    assert actions == pytest.approx(Excitation(0.5, 3).actions(3))
    assert (np.count_nonzero(actions, axis=1) == 1).all()
    assert np.abs(actions).max() == 0.5
    assert plant.x == pytest.approx(np.zeros(6), abs=1e-9)
    assert not servo.exciting
    assert servo.law.learnt > 3


@pytest.mark.parametrize(("least", "learnt"), [(0.2, 18), (0.6, 6), (100.0, 0)])
def test_it_learns_from_motions_that_are_long_enough(least, learnt):
    plant = Plant()
    servo = servo_of(plant, excitation=Excitation(0.25, 3), least_motion=least)
    plant.run(servo, 19)
    assert servo.law.learnt == learnt


def test_weights_by_noise_wait_and_look_first():
    plant = Plant()
    plant.matrix[0], plant.noise = 0, 0.0  # a feature that never answers, and no noise
    servo = servo_of(plant, weights="noise")
    assert (plant.run(servo, 8) == 0).all()
    plant.run(servo, 40)
    assert servo.law.weights is not None
    assert np.isfinite(servo.law.weights).all()
    assert servo.law.weights[0, 0] == 0


LOST = {
    "too few points": lambda plant: setattr(plant, "valid", 3),
    "held": lambda plant: setattr(plant, "reason", "not found"),
    "features are NaN": lambda plant: setattr(plant, "blank", True),
}


@pytest.mark.parametrize("lose", LOST.values(), ids=LOST)
@pytest.mark.parametrize("at", [4, 20])
@pytest.mark.parametrize("law", LAWS)
def test_in_a_blackout_nothing_moves_and_nothing_is_learnt_and_then_it_goes_on(law, at, lose):
    plant = Plant()
    servo = servo_of(plant, law)
    plant.run(servo, at)
    before, learnt, fine = servo.law.estimator.matrix, servo.law.learnt, dict(vars(plant))
    lose(plant)
    assert (plant.run(servo, 10) == 0).all()
    assert servo.law.estimator.matrix is before
    assert servo.law.learnt == learnt
    assert servo.held == 10
    vars(plant).update({name: fine[name] for name in ("valid", "reason", "blank")})
    plant.run(servo, 300 if law == "mfac-law" else 90)
    assert plant.away() < 0.1


@pytest.mark.parametrize("law", [law for law in LAWS if law != "mfac-law"])  # which takes its time
def test_features_that_come_and_go_are_left_out_while_they_are_gone(law):
    """A random fifth of the features is reported far from its true value."""
    plant, rng = Plant(noise=2e-4), np.random.default_rng(4)
    known = np.ones(6, bool)
    servo = servo_of(plant, law, measured=lambda: known)
    for _ in range(150):
        known = rng.random(6) >= 0.2
        observation = plant.observation()
        observation["achieved_goal"] = np.where(known, observation["achieved_goal"], 10.0)
        plant.x = plant.x + plant.matrix @ servo.act(observation)
    assert plant.away() < 0.1


def test_an_action_that_was_not_sent_is_not_learnt_from():
    plant = Plant(noise=0.0)
    servo = servo_of(plant, DampedLeastSquares(RecursiveLeastSquares(uncertainty=1e6)), excitation=Excitation(0.5, 6))
    for step in range(36):
        action = servo.act(plant.observation())
        if step % 3 == 1:
            servo.withheld()
        else:
            plant.x = plant.x + plant.matrix @ action
    servo.act(plant.observation())
    assert servo.law.estimator.matrix == pytest.approx(plant.matrix, abs=1e-5)


def test_it_says_what_it_expects():
    plant = Plant()
    with pytest.raises(ValueError, match="the size of actions is unknown"):
        ShapeServo().act(plant.observation())
    with pytest.raises(ValueError, match="did you mean 'kalman'"):
        ShapeServo("kalmann")
    with pytest.raises(ValueError, match="least_motion: expected a number above 0"):
        ShapeServo(least_motion=0)
    servo = servo_of(plant)
    for size in (7, 5):
        plant.run(servo, 3)
        with pytest.raises(ValueError, match=f"6 features.*got {size}"):
            servo.act({"achieved_goal": np.zeros(size), "desired_goal": np.zeros(size)})
    with pytest.raises(ValueError, match="desired_goal"):
        servo.act({"achieved_goal": np.zeros(6), "desired_goal": np.zeros(1)})
    with pytest.raises(ValueError, match=r"weights: expected \(M, 6\)"):
        plant.run(servo_of(plant, weights=np.eye(5)), 1)


def test_bind_sets_the_number_of_actions():
    servo = ShapeServo()
    servo.bind([1, 2, 3, 4])  # type: ignore[arg-type]
    assert isinstance(servo, Controller)
    assert servo.act({"achieved_goal": np.zeros(2), "desired_goal": np.ones(2)}).shape == (4,)


# ---- some values of an action only


def test_only_the_named_values_move():
    plant = Plant(actions=4)
    plant.matrix[:, [0, 3]] = 0
    plant.goal = plant.matrix @ np.array([0.0, 6.0, -4.0, 0.0])
    servo = servo_of(plant, "rls", coordinates=[1, 2])
    actions = plant.run(servo, 80)
    assert not actions[:, [0, 3]].any()
    assert actions[:8, 1:3] == pytest.approx(Excitation().actions(2))
    assert plant.away() < 0.1
    servo.reset()
    plant.run(servo, 8)
    servo.withheld()
    plant.run(servo, 30)
    assert plant.away() < 0.1


def test_other_indices_are_refused():
    wrong: Any = ([], [0, 0], [-1], [0.5])
    for coordinates in wrong:
        with pytest.raises(ValueError, match="coordinates: expected different indices of values of an action"):
            ShapeServo("rls", coordinates=coordinates)
    plant = Plant()
    with pytest.raises(ValueError, match=r"coordinates: expected indices below 3, the size of actions, got \[1, 3\]"):
        servo_of(plant, coordinates=[1, 3]).act(plant.observation())


# ---- weights, and a goal in an environment

CAMERA = CameraModel(
    Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5),
    np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1], [0, 0, 0, 1]]),
)
VIEW = FeatureContext(320, 240, CAMERA, ((-0.5, -0.4, -0.1), (0.5, 0.4, 0.3)))
LINEAR = [
    (["points3d"], Chain(20)),
    ([{"kind": "fourier", "harmonics": 3}], Chain(20)),
    ([{"kind": "bspline", "frame": "base"}], Chain(20)),
    ([{"kind": "bspline", "coefficients": 7}], Ring(32)),
    ([{"kind": "elliptic_fourier", "frame": "pixels"}], Ring(24)),
    ([{"kind": "bezier", "degree": 3}], Grid(4, 8)),
    (["points2d", {"kind": "bezier"}], Chain(12)),
]


@pytest.mark.parametrize(("kinds", "layout"), LINEAR, ids=repr)
@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1))
def test_geometric_weights_measure_how_far_points_lie_apart(kinds, layout, seed):
    features = read_features(kinds)
    weights = geometric_weights(features, layout, VIEW)
    assert weights is not None
    counts = [len(feature.bounds(layout, VIEW)[0]) for feature in features]
    here, there = np.random.default_rng(seed).normal(size=(2, sum(counts)))
    squares = 0.0
    for feature, a, b in zip(
        features, *(np.split(values, np.cumsum(counts)[:-1]) for values in (here, there)), strict=True
    ):
        apart = feature.reconstruct(a, layout, VIEW) - feature.reconstruct(b, layout, VIEW)
        squares += (apart**2).sum(axis=1).mean()
    assert np.linalg.norm(weights @ (here - there)) == pytest.approx(np.sqrt(squares))


def test_what_cannot_be_turned_back_into_points_has_no_geometric_weights():
    assert geometric_weights(read_features(["points3d", "centroid"]), Chain(20), VIEW) is None


def goal_env(*features: Any, noise: bool = False, **options: Any) -> ShapeGoal:
    env: Any = gym.make("shape_obs_envs:ShapeObs/Cable-v0", camera=(160, 120), max_episode_steps=500, **options)
    if noise:
        from shape_obs_envs.d455 import D455Noise

        env = D455Noise(env)
    return ShapeGoal(ShapeObservation(env), features=features, threshold=0.01)


def test_attach_takes_weights_shape_and_size_from_the_env():
    pytest.importorskip("mujoco")
    fourier = goal_env({"kind": "fourier", "frame": "base"})
    curvature = goal_env("curvature", {"kind": "centroid", "frame": "base"}, grippers=1)
    servo = ShapeServo()
    for env, size in ((fourier, 6), (curvature, 3), (fourier, 6)):
        observation, _ = env.reset(seed=0)
        servo.attach(env)
        servo.reset()
        actions = [servo.act(observation) for _ in range(8 + 4 * size + 1)]
        assert np.shape(actions[-1]) == (size,)
        weights = servo.law.weights
        assert weights is not None
        if env is fourier:
            assert weights == pytest.approx(
                geometric_weights(env.goal_features, env.goal_configuration.layout, env.goal_context)
            )
        else:
            assert weights == pytest.approx(np.diag(np.diag(weights)))
    kept = ShapeServo(weights=np.eye(27))
    kept.attach(fourier)
    kept.act(fourier.reset(seed=0)[0])
    assert kept.law.weights == pytest.approx(np.eye(27))
    fourier.close()
    curvature.close()


def test_attach_refuses_what_it_cannot_act_on():
    pytest.importorskip("mujoco")
    env = goal_env("points3d")
    with pytest.raises(ValueError, match="wrap it in ShapeGoal"):
        ShapeServo().attach(env.env)
    for box in (gym.spaces.Box(-2, 2, (6,)), gym.spaces.Box(-1, 1, (2, 3)), gym.spaces.Discrete(3)):
        env.action_space = box
        with pytest.raises(ValueError, match=r"flat Box of -1\.\.\.1"):
            ShapeServo().attach(env)
    env.close()


def test_from_the_camera_it_reaches_a_goal():
    pytest.importorskip("mujoco")
    env = goal_env({"kind": "bspline", "frame": "base"}, noise=True, difficulty="near")
    servo, names = ShapeServo(), tuple("abcdef")
    spec = ActionSpec(names, 6 * ("m",), 6 * (1.0,), 6 * (-1.0,), 6 * (1.0,), mode="displacement", frame="base")
    check_controller(servo, spec, env)  # as the deployment loop does: attach, bind, reset
    observation, info = env.reset(seed=3)
    for _ in range(120):
        observation, _, _, _, info = env.step(servo.act(observation))
    assert info["truth/mean_error"] < 0.01
    assert info["shape/ok"]
    hidden = SimpleNamespace(ok=False, reason="gone", valid=np.zeros(20, bool))
    blind = ShapeServo(seen=lambda: hidden)  # type: ignore[arg-type, return-value]
    blind.attach(env)
    assert (blind.act(observation) == 0).all()
    assert blind.held == 1
    env.close()
