"""Estimators, control laws and excitation against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from shape_obs.servo import (
    LAWS,
    Broyden,
    DampedLeastSquares,
    Excitation,
    Kalman,
    ModelFreeAdaptiveControl,
    PseudoJacobian,
    RecursiveLeastSquares,
    make_law,
)
from shape_obs.spec import SpecError

ESTIMATORS = [Broyden, RecursiveLeastSquares, Kalman, PseudoJacobian]
every = pytest.mark.parametrize("estimator", ESTIMATORS)
sizes = st.tuples(st.integers(1, 12), st.integers(1, 6))
seeds = st.integers(0, 2**32 - 1)


def learnt(estimator, plant, motions):
    """Return the estimate after motions of a plant, given by one matrix or one for each motion."""
    estimator.start(*plant.shape[-2:])
    plants = np.broadcast_to(plant, (len(motions), *plant.shape[-2:]))
    for matrix, motion in zip(plants, motions, strict=True):
        assert estimator.update(matrix @ motion, motion)
    return estimator.matrix


@every
@settings(max_examples=10)
@given(sizes, seeds)
def test_a_constant_map_is_learnt_from_random_motions(estimator, size, seed):
    rng = np.random.default_rng(seed)
    plant = rng.normal(size=size)
    found = learnt(estimator(), plant, rng.uniform(-1, 1, (200, size[1])))
    assert found == pytest.approx(plant, abs=1e-2 * np.abs(plant).max())


def test_recursive_least_squares_forgets_one_direction_while_another_rests():
    motions = np.tile([1.0, 0.0], (200, 1))
    plants = np.repeat([[[1.0, 0.0]], [[3.0, 0.0]]], [170, 30], axis=0)
    found = learnt(RecursiveLeastSquares(forgetting=0.8), plants, motions)
    assert found == pytest.approx(np.array([[3.0, 0.0]]), abs=0.01)


@every
def test_nothing_is_learnt_from_what_is_not_finite_nor_without_a_motion(estimator):
    rng = np.random.default_rng(1)
    made = estimator()
    plant = learnt(made, rng.normal(size=(4, 2)), rng.uniform(-1, 1, (50, 2)))
    for bad in np.nan, np.inf:
        assert not made.update([bad, 0, 0, 0], [1, 0])
        assert not made.update([1, 1, 1, 1], [bad, 0])
    assert not made.update([1, 1, 1, 1], [0, 0])
    assert made.matrix is plant


@every
@given(seeds, st.floats(1e-3, 1e3))
def test_the_unit_of_features_changes_no_action(estimator, seed, unit):
    rng = np.random.default_rng(seed)
    plant, motions, error = rng.normal(size=(6, 3)), rng.uniform(-1, 1, (20, 3)), rng.normal(size=6)
    law, scaled = DampedLeastSquares(estimator()), DampedLeastSquares(estimator())
    matrix = learnt(law.estimator, plant, motions)
    assert learnt(scaled.estimator, unit * plant, motions) == pytest.approx(unit * matrix, rel=1e-9, abs=1e-9 * unit)
    assert scaled.act(unit * error) == pytest.approx(law.act(error), abs=1e-9)


@every
@settings(max_examples=8)
@given(seeds)
def test_long_motion_in_one_direction_spoils_nothing(estimator, seed):
    """A small noisy motion in another direction changes little, and predictions of any motion improve."""
    rng = np.random.default_rng(seed)
    plant = rng.normal(size=(4, 3))
    made = estimator()
    learnt(made, plant, rng.uniform(-1, 1, (60, 3)))
    for _ in range(300):
        made.update(plant @ [0.8, 0, 0] + 1e-3 * rng.normal(size=4), np.array([0.8, 0, 0]))
    made.update(plant @ [0.8, 1e-3, 0] + 1e-3 * rng.normal(size=4), np.array([0.8, 1e-3, 0]))
    assert made.matrix == pytest.approx(plant, abs=0.15)
    for motion in rng.uniform(-1, 1, (20, 3)):
        change = rng.normal(size=4)
        before = change - made.matrix @ motion
        made.update(change, motion)
        assert made.error == pytest.approx(np.linalg.norm(before) / np.linalg.norm(change))
        after = change - made.matrix @ motion
        # Of the same direction, shorter: true of any gain from a positive covariance.
        left = after @ before / (before @ before)
        assert -1e-9 <= left < 1
        assert after == pytest.approx(left * before, abs=1e-9)


@every
def test_estimators_say_what_they_expect(estimator):
    made = estimator()
    with pytest.raises(ValueError, match="call start"):
        made.update([1.0], [1.0])
    made.start(3, 2)
    with pytest.raises(ValueError, match=r"3 features and 2 actions, got \(2,\) and \(2,\)"):
        made.update([1.0, 2], [1.0, 2])
    with pytest.raises(ValueError, match=r"finite Jacobian \(3, 2\)"):
        made.start(3, 2, np.full((3, 2), np.nan))
    made.start(3, 2, np.ones((3, 2)))
    assert (made.matrix == 1).all()


def with_jacobian(law, matrix):
    """Give a law its Jacobian."""
    law.start(*np.shape(matrix), matrix=matrix)
    return law


@given(sizes, seeds)
def test_damped_least_squares_is_its_closed_form(size, seed):
    rng = np.random.default_rng(seed)
    jacobian, error = rng.normal(size=size), 1e-3 * rng.normal(size=size[0])
    damping = 0.1 * np.trace(jacobian.T @ jacobian) / size[1]
    # The same step as least squares with the damping as further rows.
    rows = np.concatenate([jacobian, np.sqrt(damping) * np.eye(size[1])])
    step = np.linalg.lstsq(rows, np.concatenate([0.5 * error, np.zeros(size[1])]), rcond=None)[0]
    assume(np.abs(step).max() < 1)
    assert with_jacobian(DampedLeastSquares(PseudoJacobian()), jacobian).act(error) == pytest.approx(step, abs=1e-9)


@pytest.mark.parametrize("name", LAWS)
@given(sizes, seeds)
def test_saturation_keeps_the_direction(name, size, seed):
    rng = np.random.default_rng(seed)
    law, error = with_jacobian(make_law(name), rng.normal(size=size)), rng.normal(size=size[0])
    small, large = law.act(1e-4 * error), law.act(1e6 * error)
    assert np.abs(large).max() <= 1 + 1e-12
    assert large @ small == pytest.approx(np.linalg.norm(large) * np.linalg.norm(small))


@pytest.mark.parametrize("name", LAWS)
def test_without_an_estimate_or_an_error_nothing_moves(name):
    law = make_law(name)
    with pytest.raises(ValueError, match="call start"):
        law.act([1.0])
    law.start(3, 2)
    assert not law.ready
    assert (law.act([1.0, 2, 3]) == 0).all()
    with_jacobian(law, np.ones((3, 2)))
    assert law.ready
    assert (law.act([1.0, np.nan, 3]) == 0).all()
    assert (law.act(np.zeros(3)) == 0).all()
    with pytest.raises(ValueError, match=r"an error of 3 features, got \(2,\)"):
        law.act([1.0, 2])


@pytest.mark.parametrize("name", LAWS)
def test_weights_are_as_a_map_that_was_weighted_before(name):
    rng = np.random.default_rng(2)
    jacobian, error, weights = rng.normal(size=(5, 3)), 0.1 * rng.normal(size=5), rng.normal(size=(4, 5))
    law = with_jacobian(make_law(name), jacobian)
    plain = law.act(error)
    law.weights = weights
    assert law.act(error) == pytest.approx(with_jacobian(make_law(name), weights @ jacobian).act(weights @ error))
    law.weights = np.eye(5)
    assert law.act(error) == pytest.approx(plain)


@given(sizes, seeds, st.floats(0.05, 1.0))
def test_model_free_adaptive_control_comes_nearer_with_every_step(size, seed, step):
    """On a known linear plant the error never grows, and its reachable part shrinks."""
    rng = np.random.default_rng(seed)
    plant, error = rng.normal(size=size), rng.normal(size=size[0])
    law = with_jacobian(ModelFreeAdaptiveControl(PseudoJacobian(), step=step), plant)
    for _ in range(20):
        after = error - plant @ law.act(error)
        assert np.linalg.norm(after) <= np.linalg.norm(error) * (1 + 1e-12)
        if np.linalg.norm(plant.T @ error) > 1e-6:
            assert np.linalg.norm(after) < np.linalg.norm(error)
        error = after


def test_names_and_specs():
    assert Excitation.from_dict({"amplitude": 0.3}) == Excitation(0.3)
    with pytest.raises(SpecError, match="amplitude above 0"):
        Excitation(amplitude=0)
    for make in ESTIMATORS:
        for value in (0.0, np.nan, True, "1"):
            with pytest.raises(ValueError, match="expected a number above 0"):
                make(value)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="did you mean 'mfac'"):
        make_law("mfaq")
    assert {type(make_law(name).estimator) for name in LAWS} == set(ESTIMATORS)
