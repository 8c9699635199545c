"""Goals of strips, outlines and sheets: point i of the goal is point i of what the camera sees of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from goal_envs import COUNTS, INTRINSICS, LAYOUTS, RED, FlatGoalEnv

from shape_obs import ShapeObservation
from shape_obs.wrappers import goals

SHAPES: dict[str, dict[str, Any]] = {
    "centerline": {"kind": "centerline", "n": 12, "ends": "tips"},
    "contour": {"kind": "contour", "n": 24},
    "surface": {"kind": "surface", "rows": 4, "cols": 6, "ends": "tips"},
}
BASE = {"kind": "points3d", "frame": "base"}
GOALS = ("achieved_goal", "desired_goal")
ON = np.ones(1, np.float32)


def observing(kind: str, inner: FlatGoalEnv | None = None, **shape: Any) -> ShapeObservation:
    return ShapeObservation(inner or FlatGoalEnv(kind), [{**SHAPES[kind], **shape}], RED, [BASE])


def points(goal: Any) -> np.ndarray:
    return np.asarray(goal, float).reshape(-1, 3)


def apart(env: ShapeObservation, observation: Any) -> np.ndarray:
    """Return the distances between the achieved and the desired points, (N,) pixels."""
    inner: Any = env.unwrapped
    seen, wanted = (inner.camera_model.project_from_base(points(observation[key])) for key in GOALS)
    return np.linalg.norm(seen - wanted, axis=1)


def arrive(env: ShapeObservation, seed: int, steps: int = 20) -> Any:
    observation, info = env.reset(seed=seed)
    for _ in range(steps):
        observation, _, _, _, info = env.step(ON * 10 / steps)
    assert info["shape/ok"]
    return observation


@pytest.mark.parametrize(
    ("kind", "env", "shape", "most"),
    [
        ("centerline", {}, {}, 1.0),
        ("centerline", {"tilt": 0, "spin": 2.5}, {"spacing": "m"}, 1.0),
        ("contour", {"spin": 2.5}, {"order": "image"}, 1.0),
        ("contour", {"spin": 1.5, "lobes": 0.0}, {"order": "image"}, 1.0),
        ("contour", {"tilt": 0, "spin": -2.5}, {}, 1.5),
        ("contour", {}, {"lift": "cloud"}, 1.5),
        ("contour", {"turned_over": True}, {"order": "image", "spacing": "m"}, 1.5),
        ("surface", {"spin": -2.5}, {"spacing": "m", "ends": "centers"}, 1.0),
        ("surface", {}, {"lift": "cloud", "order": "image"}, 1.5),
        ("surface", {"turned_over": True}, {}, 1.5),
        ("surface", {"published": False}, {"rows": 5, "cols": 7}, 1.5),
    ],
)
def test_what_is_there_is_what_was_wanted_index_for_index(kind, env, shape, most):
    wrapped = observing(kind, FlatGoalEnv(kind, **env), **shape)
    observation = arrive(wrapped, seed=0)
    off = apart(wrapped, observation)
    assert off.mean() < 0.6 * most
    assert off.max() < most
    assert wrapped.observation_space.contains(observation)
    achieved, desired = (points(observation[key]) for key in GOALS)
    nearest = np.argmin(np.linalg.norm(achieved[:, None] - desired, axis=2), axis=1)
    np.testing.assert_array_equal(nearest, np.arange(len(nearest)))


def test_the_target_is_computed_again_only_when_the_env_changes_its_goal(monkeypatch):
    calls, placed = [], goals.resample
    monkeypatch.setattr(goals, "resample", lambda *args: calls.append(1) or placed(*args))
    inner = FlatGoalEnv("surface")
    env = observing("surface", inner)
    before, _ = env.reset(seed=0)
    env.step(0 * ON)
    inner.goal = inner.goal + np.array([0.02, 0, 0, 0, 0])
    after, *_ = env.step(0 * ON)
    moved = points(after["desired_goal"]) - points(before["desired_goal"])
    np.testing.assert_allclose(moved, [[0.02, 0, 0]] * 24, atol=1e-3)
    assert len(calls) == 2


def test_the_target_follows_the_camera():
    inner = FlatGoalEnv("centerline", tilt=0)
    env = ShapeObservation(inner, [SHAPES["centerline"]], RED, ["points3d"])
    before, _ = env.reset(seed=0)
    lifted = np.array(inner.camera_model.transform_camera_to_base)
    lifted[2, 3] += 0.05
    inner.camera_model = type(inner.camera_model)(INTRINSICS, lifted)
    after, _ = env.reset(seed=0)
    moved = points(after["desired_goal"]) - points(before["desired_goal"])
    np.testing.assert_allclose(moved[:, 2], 0.05, atol=1e-6)


@pytest.mark.parametrize(
    ("kind", "shape", "layout", "message"),
    [
        ("contour", {"kind": "centerline"}, {}, "layout 'contour': the first of shapes must be a 'contour', got"),
        ("surface", SHAPES["surface"], {"cols": 6}, "expected 5 x 6 points, at least 2 x 2, got 35 points; give"),
        ("surface", SHAPES["surface"], {"columns": 6}, "a 'surface': unknown entry 'columns'; did you mean 'cols'"),
        ("contour", SHAPES["contour"], {"rows": 6}, "goal_layout of a 'contour': unknown entry 'rows'"),
    ],
)
def test_goals_that_do_not_fit_the_shape_are_refused(kind, shape, layout, message):
    inner = FlatGoalEnv(kind)
    inner.goal_layout = {**LAYOUTS[kind], **layout}
    with pytest.raises(ValueError, match=message):
        ShapeObservation(inner, [shape], RED)


def test_goals_that_are_no_points_are_refused():
    inner = FlatGoalEnv("contour")
    env = observing("contour", inner)
    env.reset(seed=0)
    inner.goal = np.full(5, np.nan)
    with pytest.raises(ValueError, match=rf"desired_goal: expected {COUNTS['contour']} finite points"):
        env.step(ON)
    inner.goal = np.array([0, -3.0, 0, 0, 1])  # behind the camera, which looks away from there
    with pytest.raises(ValueError, match=r"the goal must lie in front of the camera, got \[.*\] metres"):
        env.step(ON)
