"""Goals seen through the same features as the shape itself."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from shape_obs.camera import CameraModel
from shape_obs.configurations import Centerline, Configuration
from shape_obs.curve import catmull_rom
from shape_obs.features import Feature, FeatureVector, Points3D, View
from shape_obs.form import Curve
from shape_obs.shape import Shape
from shape_obs.wrappers.env_protocol import GOALS


def goal_vector(
    space: spaces.Space[Any], features: Sequence[Feature], shapes: Sequence[Configuration], view: View
) -> FeatureVector | None:
    """The feature that goals are given in: the first points3d, of the first shape; None where the env has no goals.

    Raises:
        ValueError: The env has goals, but the features or the camera cannot express them.
    """
    if not isinstance(space, spaces.Dict) or not all(key in space.spaces for key in GOALS):
        return None
    if not isinstance(shapes[0], Centerline):
        raise ValueError(
            "this env has goals, which are curves from end to end: the first of shapes must be a 'centerline', "
            f"got {shapes[0].kind!r}."
        )
    metric = [feature for feature in features if isinstance(feature, Points3D)]
    if not metric:
        raise ValueError(
            "this env has goals, which are scored in metres: add 'points3d' to features, "
            f"got {[feature.kind for feature in features]}."
        )
    if view.camera is None or view.camera.transform_camera_to_base is None:
        raise ValueError(
            "this env has goals in the base frame: its camera_model (or camera=) needs transform_camera_to_base."
        )
    return FeatureVector(metric[:1], shapes[:1], view)


def target_shape(points: npt.ArrayLike, spec: Configuration, camera: CameraModel) -> Shape:
    """A target curve as the shape that the detector would report of it.

    Args:
        points: Flat or (K,3) metres, base frame, K >= 3, ordered from the end that is point 0.
        spec: The configuration whose points are wanted.
        camera: With its place in the base frame.

    Raises:
        ValueError: Not a list of points.
    """
    array = np.asarray(points, dtype=np.float64)
    if array.size % 3 or array.size < 9 or not np.all(np.isfinite(array)):
        raise ValueError(f"desired_goal: expected flat finite (x, y, z) points in the base frame, got {array.shape}.")
    points = catmull_rom(camera.from_base(array.reshape(-1, 3)))
    curve = Curve(points, np.zeros(len(points), bool))
    metric = curve if spec.spacing == "m" else curve.measured(camera.intrinsics.project(points))
    points3d = spec.place(curve, metric).places
    known = np.ones(spec.count, bool)
    points2d = camera.intrinsics.project(points3d)
    return Shape(spec.name, points2d.astype(np.float32), points3d.astype(np.float32), known, known.copy(), spec.layout)
