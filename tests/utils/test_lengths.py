"""Lengths and poses in another unit than metres: a warning names them and the unit; in metres there is none."""

from __future__ import annotations

import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from goal_envs import RED, FlatGoalEnv
from rope_env import INTRINSICS, RopeEnv, wrapped

from shape_obs import CameraModel, Centerline, DepthRange, ShapeDetector, ShapeObservation, Target
from shape_obs.calibration.board import Board
from shape_obs.calibration.hand_eye import fit_base, marker_points
from shape_obs.camera import DepthNoise
from shape_obs.extrinsics import Extrinsics
from shape_obs.features import Points3D
from shape_obs.markers import MarkerLayout

POSE = np.array([[1.0, 0, 0, 0.4], [0, -1, 0, 0.1], [0, 0, -1, 0.75], [0, 0, 0, 1]])
CORNERS = np.array([(60.0, 40), (90, 40), (90, 70), (60, 70)])
TABLE = np.random.default_rng(0).uniform(-0.4, 0.4, (8, 3))


def pose(unit: float) -> np.ndarray:
    return POSE @ np.diag([1, 1, 1, 0]) + np.diag([0, 0, 0, 1.0]) + unit * np.pad(POSE[:3, 3:], ((0, 1), (3, 0)))


def anchored(unit: float) -> Any:
    """Detect a rope whose named anchor is in the base frame."""
    mask = np.zeros((120, 160), np.uint8)
    mask[50:58, 20:140] = 1
    camera = CameraModel(INTRINSICS, POSE)
    anchors = {"hand": tuple(unit * camera.to_base([0.1, 0.0, 0.85]))}
    return ShapeDetector(Centerline(anchor="hand")).detect_mask(mask, None, camera, anchors=anchors)


def with_workspace(unit: float) -> Any:
    box = ((-0.5 * unit,) * 3, (0.5 * unit,) * 3)
    return wrapped(features=[Points3D(frame="base")], workspace=box)


def with_goal(unit: float) -> Any:
    inner = FlatGoalEnv(tilt=0)
    scaled = lambda seen: {**seen, "desired_goal": unit * seen["desired_goal"]}  # noqa: E731
    env = gym.wrappers.TransformObservation(inner, scaled, inner.observation_space)
    return ShapeObservation(env, segmentation=RED).reset(seed=0)


GIVEN = {
    "desired_goal": with_goal,
    "transform_camera_to_base": lambda unit: CameraModel(INTRINSICS, pose(unit)),
    "transform_camera_to_base of": lambda unit: wrapped(
        camera={"intrinsics": INTRINSICS.to_dict(), "transform_camera_to_base": pose(unit).tolist()}
    ),
    "translation": lambda unit: Extrinsics(T=pose(unit).tolist()).camera(INTRINSICS),
    "anchor 'hand'": anchored,
    "workspace": with_workspace,
    "centerline: length": lambda unit: Centerline(length=0.8 * unit),
    "radius": lambda unit: Centerline(radius=0.005 * unit),
    "max_depth": lambda unit: Points3D(max_depth=2 * unit),
    "near": lambda unit: DepthRange(0.3 * unit, 0.9 * unit),
    "goal: points": lambda unit: Target(((0.1 * unit, 0, 0), (0.3 * unit, 0, 0))),
    "Board": lambda unit: Board(square=0.036 * unit, marker=0.027 * unit),
    "MarkerLayout": lambda unit: MarkerLayout.rectangle(0.05 * unit, 0.6 * unit, 0.4 * unit),
    "size of the marker": lambda unit: marker_points(CORNERS, INTRINSICS, size=0.04 * unit),
    "points_base": lambda unit: fit_base(TABLE, TABLE * unit),
    "baseline": lambda unit: DepthNoise(baseline=0.095 * unit),
}


@pytest.mark.parametrize(("what", "give"), [(name.removesuffix(" of"), give) for name, give in GIVEN.items()])
def test_millimetres_are_named_and_metres_are_not(what, give):
    with pytest.warns(UserWarning, match=f"{what}.*millimetres") as caught:
        give(1000)
    assert len({str(each.message) for each in caught}) == len(caught)  # each of them once
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        give(1)


def test_centimetres_and_metres_divided_by_1000_are_named():
    with pytest.warns(UserWarning, match=r"millimetres \(0.085 m\) or centimetres \(0.85 m\)"):
        Centerline(length=85)
    with pytest.warns(UserWarning, match="divided by 1000"):
        Centerline(length=0.85e-3)


@pytest.mark.parametrize("workspace", [((-1, -1), (1, 1)), (-1, -1, -1, 1, 1, 1), 5, "table", {"low": 1, "high": 2}])
def test_a_workspace_that_is_no_two_corners_is_refused(workspace):
    with pytest.raises(ValueError, match="workspace: expected"):
        wrapped(RopeEnv(), features=[Points3D(frame="base")], workspace=workspace)
