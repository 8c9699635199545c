"""Points in space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel
from shape_obs.features.base import Feature, View
from shape_obs.shape import Shape

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Points3D(Feature, kind="points3d"):
    """(x0, y0, z0, x1, ...) in metres.

    Args:
        frame: ``"camera"`` (optical frame: x right, y down, z forward), ``"base"`` (needs the camera's place), or
            ``"anchor"``: base axes, relative to the anchor.
        max_depth: Metres; how far the camera's view is taken to reach when bounds are made.
    """

    frame: Literal["camera", "base", "anchor"] = "camera"
    max_depth: float = 2.0
    needs_depth: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.max_depth < np.inf:
            raise ValueError(f"points3d: max_depth must be a positive number of metres, got {self.max_depth}.")

    def bounds(self, count: int, view: View) -> tuple[Array, Array]:
        """The camera's view up to ``max_depth``, or in the base frame the workspace where one is given."""
        camera = self._camera(view)
        if self.frame == "camera":
            low, high = _box(_frustum(camera, self.max_depth))
        elif view.workspace is not None:
            low, high = np.asarray(view.workspace[0], dtype=float), np.asarray(view.workspace[1], dtype=float)
        else:
            low, high = _box(camera.to_base(_frustum(camera, self.max_depth)))
        if self.frame == "anchor":
            low, high = low - high, high - low
        return np.tile(low, count), np.tile(high, count)

    def compute(self, shape: Shape, view: View) -> Array:
        """(3N,) metres."""
        if shape.points3d is None:
            raise ValueError("feature 'points3d' needs depth and a camera, but the shape has no points3d.")
        points = shape.points3d.astype(np.float64)
        if self.frame != "camera":
            points = self._camera(view).to_base(points)
        if self.frame == "anchor":
            if view.anchor is None:
                raise ValueError("feature 'points3d' in frame 'anchor' needs a shape anchored to a base-frame point.")
            points = points - view.anchor
        return points.ravel()

    def _camera(self, view: View) -> CameraModel:
        if view.camera is None:
            raise ValueError(
                "feature 'points3d' needs a camera model: let the env publish `camera_model`, or pass camera=."
            )
        if self.frame != "camera" and view.camera.transform_camera_to_base is None:
            raise ValueError(
                f"feature 'points3d' in frame {self.frame!r} needs transform_camera_to_base; "
                "pass camera=CameraModel(intrinsics, transform_camera_to_base=T), or frame='camera'."
            )
        return view.camera


def _frustum(camera: CameraModel, depth: float) -> Array:
    """(5,3) the corners of what a camera sees up to a depth, metres, camera frame."""
    right, bottom = camera.intrinsics.width - 0.5, camera.intrinsics.height - 0.5
    corners = camera.intrinsics.rays([[-0.5, -0.5], [right, -0.5], [-0.5, bottom], [right, bottom]]) * depth
    return np.concatenate([np.zeros((1, 3)), corners])


def _box(points: Array) -> tuple[Array, Array]:
    return points.min(axis=0), points.max(axis=0)
