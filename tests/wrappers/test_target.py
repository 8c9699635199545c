"""Target: goals as plain records, from points, mappings and detections."""

from __future__ import annotations

import json
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import yaml
from goal_envs import RED, FlatGoalEnv

from shape_obs import CameraModel, Centerline, ShapeGoal, ShapeObservation, SpecError, Target, record_goal
from shape_obs.features import FeatureContext

LINE = np.array([[-0.1, 0.0, 0.0], [0.0, 0.02, 0.0], [0.05, 0.03, 0.0], [0.1, 0.03, 0.0]])
KINDS: list[dict[str, Any]] = [
    {"kind": "centerline", "n": 12},
    {"kind": "contour", "n": 24},
    {"kind": "surface", "rows": 4, "cols": 6},
]


def observing(shape: dict[str, Any], features: Any = ("points3d",), **options: Any) -> ShapeObservation:
    inner = FlatGoalEnv(shape["kind"], goals=False)
    return ShapeObservation(inner, [shape], RED, features, **options)


def view_of(env: ShapeObservation) -> FeatureContext:
    return env.contexts[0]


@pytest.mark.parametrize("shape", KINDS, ids=lambda shape: shape["kind"])
@pytest.mark.parametrize("frame", ["base", "camera", "pixels"])
def test_a_recorded_shape_is_itself_again_index_for_index(shape, frame):
    env = observing(shape)
    env.reset(seed=1)
    target = record_goal(env, frame=frame)
    assert env.detection is not None
    seen, again = env.detection.shapes[0], target.shape_for(env.detector.shapes[0], view_of(env))
    np.testing.assert_allclose(again.pixels, seen.pixels, atol=2e-3)
    if frame == "pixels":
        assert again.points3d is None
        assert target.size == (160, 120)
    else:
        np.testing.assert_allclose(again.points3d, seen.points3d, atol=2e-6)  # type: ignore[arg-type]
    assert again.layout == seen.layout
    assert again.valid.all()


def test_it_travels_as_json_and_yaml():
    env = observing(KINDS[2])
    env.reset(seed=1)
    target = record_goal(env)
    assert (target.frame, target.layout) == ("base", {"kind": "surface", "rows": 4, "cols": 6})
    assert Target.from_dict(json.loads(json.dumps(target.to_dict()))) == target
    assert Target.from_dict(yaml.safe_load(yaml.safe_dump(target.to_dict()))) == target
    assert Target.read(target.to_dict()) == target
    assert Target.read(target) is target


def test_bare_points_are_metres_in_the_base_frame_and_are_resampled():
    target = Target.read(LINE)
    assert target == Target.read(LINE.ravel()) == Target.read(LINE.tolist()) == Target(LINE.tolist())  # type: ignore[arg-type]
    env = observing(KINDS[0])
    spec = Centerline(n=9, ends="tips", spacing="m")
    shape = target.shape_for(spec, view_of(env))
    camera = FlatGoalEnv().camera_model
    points = camera.to_base(np.asarray(shape.points3d, float))
    np.testing.assert_allclose(points[[0, -1]], LINE[[0, -1]], atol=1e-6)
    gap = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert gap.std() / gap.mean() < 0.01
    np.testing.assert_allclose(shape.pixels, camera.intrinsics.project(np.asarray(shape.points3d)), atol=1e-4)


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        ([], r"points \(K,3\) or flat, metres in the base frame, got an array of shape \(0,\)"),
        ([[0.0, 0.0, np.nan]], r"expected 3 finite numbers a point in frame 'base', point 0 is \(0.0, 0.0, nan\)"),
        ({"points": []}, "goal: expected points, got none"),
        ({"points": LINE, "fram": "base"}, r"Target: unknown field 'fram'; did you mean 'frame'\?"),
    ],
)
def test_what_is_no_goal_is_refused(goal, message):
    with pytest.raises((ValueError, SpecError), match=message):
        Target.read(goal)


def test_a_goal_that_does_not_fit_is_refused():
    env = observing(KINDS[0])
    view, spec = view_of(env), env.detector.shapes[0]
    nowhere = FeatureContext(160, 120, CameraModel(FlatGoalEnv().camera_model.intrinsics))
    cases: list[tuple[Any, Any, str]] = [
        ({"points": LINE, "layout": {"kind": "contour"}}, view, r"a goal of kind 'contour' does not fit shape 'cent"),
        ({"points": LINE[:2]}, view, r"goal of a 'centerline': expected at least 3 points, got 2"),
        ({"points": LINE - [0, 0, 9], "frame": "camera"}, view, r"in front of the camera, got \[-0.1, 0.0, -9.0\]"),
        ({"points": LINE}, FeatureContext(160, 120), "frame 'base' needs a camera: let the env publish it, or pass"),
        ({"points": LINE}, nowhere, "'base' needs the pose of the camera: give camera=CameraModel"),
        ({"points": 9 * LINE[:, :2], "frame": "pixels", "size": [640, 480]}, view, "image of 640 x 480, this one"),
    ]
    for goal, seen, message in cases:
        with pytest.raises(ValueError, match=message):
            Target.read(goal).shape_for(spec, seen)
    with pytest.raises(ValueError, match=r"equal gaps in metres: give its goal in metres too, not in pixels"):
        Target.read({"points": 99 * LINE[:, :2], "frame": "pixels"}).shape_for(Centerline(spacing="m"), view)


def test_a_record_of_another_configuration_is_refused():
    env = observing(KINDS[0])
    env.reset(seed=0)
    target = record_goal(env)
    other = observing({"kind": "centerline", "n": 15}, ends="tips")
    with pytest.raises(ValueError, match=r"recorded with {'n': 12, 'ends': 'centers'}, but shape 'centerline' has"):
        target.shape_for(other.detector.shapes[0], view_of(env))
    named = observing({"kind": "centerline", "n": 12, "name": "rope", "order": "image"})
    target.shape_for(named.detector.shapes[0], view_of(env))


class Hidden(FlatGoalEnv):
    """An env without a visible shape, or without depth on the right."""

    def __init__(self, what: str) -> None:
        super().__init__("contour", goals=False)
        self.what = what

    def _observe(self) -> dict[str, np.ndarray]:
        seen = super()._observe()
        if self.what == "thing":
            seen["rgb"][:] = 150
        else:
            seen["depth"][:, 80:] = 0
        return seen


def test_only_what_was_seen_is_recorded():
    def look(what: str) -> ShapeObservation:
        env = ShapeObservation(Hidden(what), ["contour"], RED)
        env.reset(seed=0)
        return env

    with pytest.raises(ValueError, match="nothing has been seen yet; call reset first"):
        record_goal(observing(KINDS[0]))
    with pytest.raises(ValueError, match="shape 'contour' was not found and cannot be a goal: the mask is empty"):
        record_goal(look("thing"))
    half = look("depth")
    with pytest.raises(ValueError, match=r"shape 'contour': \d+ of 32 points were hidden or had no"):
        record_goal(half)
    assert len(record_goal(half, unmeasured=True).points) == 32
    with pytest.raises(ValueError, match=r"no shape named 'contuor'; did you mean 'contour'\?"):
        record_goal(half, "contuor")
    with pytest.raises(ValueError, match="expected an env with a ShapeObservation inside"):
        record_goal(FlatGoalEnv())


class RgbOnly(gym.ObservationWrapper[Any, Any, Any]):
    """An env with colour images that publishes nothing."""

    camera_model, anchors = None, {}

    def __init__(self) -> None:
        super().__init__(FlatGoalEnv("contour", goals=False))
        self.observation_space = self.env.observation_space["rgb"]  # type: ignore[index]

    def observation(self, observation: Any) -> Any:
        return observation["rgb"]


def test_without_depth_it_is_recorded_in_pixels():
    plain = ShapeObservation(RgbOnly(), [KINDS[1]], RED)
    plain.reset(seed=0)
    target = record_goal(plain)
    assert (target.frame, target.size, len(target.points[0])) == ("pixels", (160, 120), 2)
    with pytest.raises(ValueError, match="was found without depth: its frame is 'pixels', not 'base'"):
        record_goal(plain, frame="base")
    env = ShapeGoal(plain, target, threshold=0.02)
    observation, info = env.reset(seed=0)
    assert info["is_success"]
    assert observation["desired_goal"].shape == (48,)
    _, _, _, _, info = env.step(np.ones(1, np.float32))
    assert info["goal/distance"] > 0.01
