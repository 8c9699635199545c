"""What a feature of the user's returns is checked, and the error names the feature."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from rope_env import BLUE, RopeEnv

from shape_obs import Feature, ShapeObservation

SWITCH: dict[str, Any] = {}
RIGHT = {"bounds": (np.zeros(2), np.ones(2)), "compute": np.array([0.25, 0.75])}


@dataclass(frozen=True)
class Own(Feature, kind="test_own"):
    def bounds(self, layout, context):
        return SWITCH["bounds"]

    def compute(self, shape, context):
        return SWITCH["compute"]


@pytest.fixture(autouse=True)
def _right():
    SWITCH.update(RIGHT)


def wrapped() -> ShapeObservation:
    return ShapeObservation(RopeEnv(), segmentation=BLUE, features=["ok", "test_own"])


@pytest.mark.parametrize(
    ("bounds", "error", "message"),
    [
        (None, TypeError, r"bounds\(\) must return \(low, high\), got None."),
        ((np.zeros(2), np.array(["1", "2"])), TypeError, "got high = an array of <U1."),
        ((np.zeros(2), np.ones(3)), ValueError, r"must return two arrays of one shape \(D,\), got \(2,\) and \(3,\)."),
        ((np.zeros(2), np.array([1, np.nan])), ValueError, "finite and low < high, got 0 and nan for value 1."),
        ((np.ones(2), np.ones(2)), ValueError, "finite and low < high, got 1 and 1 for value 0."),
        ((np.zeros(2), np.array([1, 1e300])), ValueError, "finite and low < high, got 0 and inf for value 1."),
    ],
)
def test_wrong_bounds_are_an_error_when_the_wrapper_is_made(bounds, error, message):
    SWITCH["bounds"] = bounds
    name = "feature 'test_own' of shape 'centerline'"
    with np.errstate(over="ignore"), pytest.raises(error, match=f"{name}: .*{message}"):
        wrapped()


@pytest.mark.parametrize(
    ("values", "error", "message"),
    [
        (None, TypeError, r"compute\(\) must return a numpy array of numbers, got None \(NoneType\)."),
        (np.array([None, 1.0]), TypeError, "got an array of object."),
        (np.zeros(3), ValueError, r"compute\(\) must return shape \(2,\), as its bounds have, got \(3,\)."),
        (np.array(0.5), ValueError, r"as its bounds have, got \(\)."),
    ],
)
@pytest.mark.parametrize("when", ["first frame", "later"])
def test_wrong_values_are_an_error_in_every_frame(values, error, message, when):
    env = wrapped()
    if when == "later":
        env.reset(seed=0)
        env.step(env.action_space.sample())
    SWITCH["compute"] = values
    with pytest.raises(error, match=f"^feature 'test_own' of shape 'centerline': .*{message}"):
        env.reset(seed=0) if when == "first frame" else env.step(env.action_space.sample())


@pytest.mark.parametrize(
    ("values", "expected", "message"),
    [
        ([0.5, np.nan], [0.5, 0.5], "'test_own' of shape 'centerline': value 1 is nan though all points of the"),
        ([-np.inf, 0.5], [0.5, 0.5], "value 0 is -inf though all points of the shape are known, and is replaced"),
        ([0.5, 7.0], [0.5, 1.0], "1 of 3 values lie outside their bounds and are clipped, first value 1 of feature"),
    ],
)
def test_values_that_no_feature_should_return_are_a_warning_once(values, expected, message):
    env = wrapped()
    SWITCH["compute"] = np.array(values)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        observation, _ = env.reset(seed=0)
        for _ in range(3):
            env.step(env.action_space.sample())
    assert len(caught) == 1
    assert message in str(caught[0].message)
    np.testing.assert_allclose(observation[1:], expected)
    assert env.observation_space.contains(observation)


def test_nan_of_a_shape_that_is_not_found_is_no_warning():
    env = ShapeObservation(RopeEnv(hide=[0]), segmentation=BLUE, features=["test_own"])
    SWITCH["compute"] = np.array([np.nan, 0.5])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        observation, _ = env.reset(seed=0)
    np.testing.assert_allclose(observation, [0.5, 0.5])
