"""The coordinates of a feature's points: their frame and their origin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel
from shape_obs.features.feature import Feature, FeatureContext
from shape_obs.shape import Shape
from shape_obs.spec import did_you_mean
from shape_obs.utils.lengths import warn_unless_metres

Array = npt.NDArray[np.float64]
CoordinateFrame = Literal["pixels", "normalized", "camera", "base"]

_UNITS: Final = {"pixels": "px", "normalized": "", "camera": "m", "base": "m"}
#: Weight of a filled-in point; a measured one has 1. It only keeps a fit from diverging where points are missing.
FILLED: Final = 0.001


@dataclass(frozen=True)
class Coordinates:
    """A frame and an origin.

    Args:
        frame: ``"pixels"`` (u right, v down), ``"normalized"`` (-1...1 from the first to the last edge of the image),
            ``"camera"`` (metres, optical frame: x right, y down, z forward) or ``"base"`` (metres).
        origin: The origin of the points: None for the frame's own origin, ``"centroid"`` for the mean of the points,
            ``"anchor"`` for the shape's anchor, or the name of a published anchor.
        max_depth: Depth in metres up to which the camera's view is taken into account for bounds.
        kind: The kind of the feature, for error messages.
    """

    frame: CoordinateFrame
    origin: str | None = None
    max_depth: float = 2.0
    kind: str = "points"

    def __post_init__(self) -> None:
        if not 0 < self.max_depth < np.inf:
            raise ValueError(f"{self.kind}: max_depth must be a positive number of metres, got {self.max_depth}.")
        warn_unless_metres(f"{self.kind}: max_depth", self.max_depth, most=100.0, stacklevel=5)

    @property
    def unit(self) -> str:
        """``"px"``, ``"m"`` or empty."""
        return _UNITS[self.frame]

    @property
    def planar(self) -> bool:
        """Whether points have two coordinates."""
        return self.frame in ("pixels", "normalized")

    def box(self, context: FeatureContext) -> tuple[Array, Array]:
        """Return the lowest and highest coordinates of a point, of shape ``(2,)`` or ``(3,)`` each.

        Raises:
            ValueError: The context has no camera, or no pose of the camera in the base frame.
        """
        if self.frame == "pixels":
            low, high = np.full(2, -0.5), np.array([context.width - 0.5, context.height - 0.5])
        elif self.frame == "normalized":
            low, high = np.full(2, -1.0), np.full(2, 1.0)
        elif self.frame == "base" and context.workspace is not None:
            self._camera(context)
            low, high = _corners(context.workspace)
        else:
            camera = self._camera(context)
            seen = _frustum(camera, self.max_depth)
            seen = seen if self.frame == "camera" else camera.to_base(seen)
            low, high = seen.min(axis=0), seen.max(axis=0)
        return (low, high) if self.origin is None else (low - high, high - low)

    def points(self, shape: Shape, context: FeatureContext) -> Array:
        """Return the points of a shape, of shape ``(N, 2)`` or ``(N, 3)``; NaN where unknown.

        Raises:
            ValueError: The shape has no such points, or the origin is unknown.
        """
        if self.frame == "pixels":
            points = shape.pixels.astype(np.float64)
        elif self.frame == "normalized":
            points = 2 * (shape.pixels.astype(np.float64) + 0.5) / (context.width, context.height) - 1
        elif shape.points3d is None:
            raise ValueError(f"feature {self.kind!r} needs depth and a camera, but the shape has no points3d.")
        else:
            points = shape.points3d.astype(np.float64)
            if self.frame == "base":
                points = self._camera(context).to_base(points)
        if self.origin is None:
            return points
        if self.origin == "centroid":
            # Fill in unknown points first: the mean of the known ones alone would jump with each that is lost.
            known = ~np.isnan(points[:, 0])
            complete = points if known.all() or not known.any() else shape.layout.interpolate(points, known)
            return points - complete.mean(axis=0)
        return points - self._anchor(context)

    def weights(self, shape: Shape, points: Array) -> Array:
        """Return the weight of each point in a fit, of shape ``(N,)``: 1 if measured, small if filled in, 0 if unknown.

        A pixel is measured if the point is visible, a position in space if it also had depth.
        """
        weight = np.where(shape.visible if self.planar else shape.valid, 1.0, FILLED)
        weight[np.isnan(points[:, 0])] = 0.0
        return weight

    def _anchor(self, context: FeatureContext) -> Array:
        """Return the anchor that is the origin, of shape ``(2,)`` or ``(3,)``, in this frame."""
        anchor = context.anchor if self.origin == "anchor" else context.anchors.get(str(self.origin))
        if anchor is None and self.origin == "anchor":
            raise ValueError(
                f"feature {self.kind!r} relative to the anchor needs a shape anchored to a base-frame point."
            )
        if anchor is None:
            known = ["centroid", "anchor", *context.anchors]
            raise ValueError(f"feature {self.kind!r}: no origin {self.origin!r}{did_you_mean(self.origin, known)}")
        at = np.asarray(anchor, dtype=np.float64)
        if len(at) == 3:
            if self.frame == "base":
                return at
            camera = self._camera(context, "base")
            at = camera.from_base(at[None])[0] if self.frame == "camera" else camera.project_from_base(at[None])[0]
        elif not self.planar:
            raise ValueError(f"feature {self.kind!r}: origin {self.origin!r} is a pixel, but its points are in metres.")
        return 2 * (at + 0.5) / (context.width, context.height) - 1 if self.frame == "normalized" else at

    def _camera(self, context: FeatureContext, frame: str | None = None) -> CameraModel:
        frame = frame or self.frame
        if context.camera is None:
            raise ValueError(
                f"feature {self.kind!r} needs a camera model: let the env publish `camera_model`, or pass camera=."
            )
        if frame != "camera" and context.camera.transform_camera_to_base is None:
            raise ValueError(
                f"feature {self.kind!r} in frame {frame!r} needs transform_camera_to_base; "
                "pass camera=CameraModel(intrinsics, transform_camera_to_base=T), or frame='camera'."
            )
        return context.camera


@dataclass(frozen=True)
class Positional(Feature):
    """A feature of the positions of the points.

    Attributes:
        coordinates: The frame and origin of its points.
    """

    # Set for each instance in ``__post_init__``; ``ClassVar`` only keeps it from being a field.
    coordinates: ClassVar[Coordinates]

    def _set_coordinates(self, coordinates: Coordinates) -> None:
        object.__setattr__(self, "coordinates", coordinates)

    @property
    def unit(self) -> str:
        """The unit of the coordinates."""
        return self.coordinates.unit

    @property
    def needs_depth(self) -> bool:
        """Whether the coordinates are in metres."""
        return not self.coordinates.planar

    @property
    def anchored(self) -> bool:
        """Whether the origin is an anchor."""
        return self.coordinates.origin not in (None, "centroid")

    def error(self, shape: Shape, context: FeatureContext) -> float:
        """Return the mean distance of the measured points from the reconstructed ones, in the feature's unit.

        Raises:
            ValueError: The feature cannot be turned back into points.
        """
        points = self.coordinates.points(shape, context)
        back = self.reconstruct(self.compute(shape, context), shape.layout, context)
        known = self.coordinates.weights(shape, points) == 1
        return float(np.linalg.norm(points - back, axis=1)[known].mean())


@dataclass(frozen=True)
class Framed(Positional):
    """A feature that is defined in every frame.

    Args:
        frame: ``"pixels"``, ``"normalized"``, ``"camera"`` or ``"base"``; see ``Coordinates``.
    """

    frame: CoordinateFrame = "camera"

    def __post_init__(self) -> None:
        super().__post_init__()
        given = {name: getattr(self, name) for name in ("origin", "max_depth") if hasattr(self, name)}
        self._set_coordinates(Coordinates(self.frame, kind=self.kind, **given))

    def complete(self, shape: Shape, context: FeatureContext) -> Array:
        """Return the points, of shape ``(N, 2)`` or ``(N, 3)``, with unknown ones interpolated along the layout.

        All points are NaN if none is known.
        """
        points = self.coordinates.points(shape, context)
        known = ~np.isnan(points[:, 0])
        if known.all() or not known.any():
            return points
        return shape.layout.interpolate(points, known)


@dataclass(frozen=True)
class Geometric(Framed):
    """A feature that is defined in every frame and relative to every origin.

    Args:
        frame: ``"pixels"``, ``"normalized"``, ``"camera"`` or ``"base"``; see ``Coordinates``.
        origin: None, ``"centroid"``, ``"anchor"`` or the name of a published anchor.
        max_depth: Depth in metres up to which the camera's view is taken into account for bounds.
    """

    origin: str | None = None
    max_depth: float = 2.0


def check_workspace(workspace: Any) -> None:
    """Warn of a workspace whose corners are not plausible in metres; None passes.

    Raises:
        ValueError: It is not two corners.
    """
    if workspace is not None:
        warn_unless_metres("workspace", _corners(workspace), stacklevel=4)


def _corners(workspace: Any) -> Array:
    """Return the corners (low, high) of a workspace, of shape ``(2, 3)``, metres."""
    try:
        corners = np.asarray(workspace, dtype=np.float64)
    except (TypeError, ValueError):
        corners = np.empty(0)
    if corners.shape != (2, 3):
        raise ValueError(f"workspace: expected (low, high), two corners (x, y, z) in metres, got {workspace!r:.200}.")
    return corners


def _frustum(camera: CameraModel, depth: float) -> Array:
    """Return the camera's centre and the corners of its view at a depth, of shape ``(5, 3)``, metres, camera frame.

    Image corners for which the lens has no ray are left out.
    """
    right, bottom = camera.intrinsics.width - 0.5, camera.intrinsics.height - 0.5
    corners = camera.intrinsics.rays([[-0.5, -0.5], [right, -0.5], [-0.5, bottom], [right, bottom]]) * depth
    return np.concatenate([np.zeros((1, 3)), corners[np.isfinite(corners).all(axis=1)]])
