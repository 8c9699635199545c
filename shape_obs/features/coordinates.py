"""Where a feature's points are measured: the frame, and what they are relative to."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel
from shape_obs.features.feature import Feature, FeatureContext
from shape_obs.shape import Shape
from shape_obs.spec import did_you_mean

Array = npt.NDArray[np.float64]
CoordinateFrame = Literal["pixels", "normalized", "camera", "base"]

_UNITS: Final = {"pixels": "px", "normalized": "", "camera": "m", "base": "m"}
#: Of a point that was filled in, beside 1 of a measured one: enough to keep a fit from running away, no more.
FILLED: Final = 0.001


@dataclass(frozen=True)
class Coordinates:
    """A frame and an origin.

    Args:
        frame: ``"pixels"`` (u right, v down), ``"normalized"`` (-1...1 from the image's first edge to its last),
            ``"camera"`` (metres, optical frame: x right, y down, z forward) or ``"base"`` (metres).
        origin: What points are relative to: None for the frame's own origin, ``"centroid"`` for the mean of the points,
            ``"anchor"`` for the shape's anchor, else the name of a published anchor.
        max_depth: Metres; how far the camera's view is taken to reach when bounds are made.
        kind: Of the feature, for messages.
    """

    frame: CoordinateFrame
    origin: str | None = None
    max_depth: float = 2.0
    kind: str = "points"

    def __post_init__(self) -> None:
        if not 0 < self.max_depth < np.inf:
            raise ValueError(f"{self.kind}: max_depth must be a positive number of metres, got {self.max_depth}.")

    @property
    def unit(self) -> str:
        """``"px"``, ``"m"`` or empty."""
        return _UNITS[self.frame]

    @property
    def planar(self) -> bool:
        """Whether points have two coordinates."""
        return self.frame in ("pixels", "normalized")

    def box(self, context: FeatureContext) -> tuple[Array, Array]:
        """Lowest and highest coordinates of a point, (2,) or (3,) each.

        Raises:
            ValueError: No camera, or no place of it in the base frame.
        """
        if self.frame == "pixels":
            low, high = np.full(2, -0.5), np.array([context.width - 0.5, context.height - 0.5])
        elif self.frame == "normalized":
            low, high = np.full(2, -1.0), np.full(2, 1.0)
        elif self.frame == "base" and context.workspace is not None:
            self._camera(context)
            low, high = (np.asarray(corner, dtype=np.float64) for corner in context.workspace)
        else:
            camera = self._camera(context)
            seen = _frustum(camera, self.max_depth)
            seen = seen if self.frame == "camera" else camera.to_base(seen)
            low, high = seen.min(axis=0), seen.max(axis=0)
        return (low, high) if self.origin is None else (low - high, high - low)

    def points(self, shape: Shape, context: FeatureContext) -> Array:
        """(N,2) or (N,3) places of a shape's points; NaN where unknown.

        Raises:
            ValueError: The shape has no such points, or there is no such origin.
        """
        points = self._absolute(shape, context)
        if self.origin is None:
            return points
        if self.origin == "centroid":
            # All of them: a mean of those alone that are measured now would jump with every one that is not.
            known = ~np.isnan(points[:, 0])
            whole = points if known.all() or not known.any() else shape.layout.interpolate(points, known)
            return points - whole.mean(axis=0)
        return points - self._place(context)

    def weights(self, shape: Shape, points: Array) -> Array:
        """(N,) how much each point counts in a fit: 1 where measured, little where filled in, 0 where unknown.

        In an image a point is measured when it is visible, in space when there was depth under it too.
        """
        weight = np.where(shape.visible if self.planar else shape.valid, 1.0, FILLED)
        weight[np.isnan(points[:, 0])] = 0.0
        return weight

    def _absolute(self, shape: Shape, context: FeatureContext) -> Array:
        if self.frame == "pixels":
            return shape.pixels.astype(np.float64)
        if self.frame == "normalized":
            return 2 * (shape.pixels.astype(np.float64) + 0.5) / (context.width, context.height) - 1
        if shape.points3d is None:
            raise ValueError(f"feature {self.kind!r} needs depth and a camera, but the shape has no points3d.")
        points = shape.points3d.astype(np.float64)
        return points if self.frame == "camera" else self._camera(context).to_base(points)

    def _place(self, context: FeatureContext) -> Array:
        """(2,) or (3,) the origin, where it is an anchor."""
        place = context.anchor if self.origin == "anchor" else context.anchors.get(str(self.origin))
        if place is None and self.origin == "anchor":
            raise ValueError(
                f"feature {self.kind!r} relative to the anchor needs a shape anchored to a base-frame point."
            )
        if place is None:
            known = ["centroid", "anchor", *context.anchors]
            raise ValueError(f"feature {self.kind!r}: no origin {self.origin!r}{did_you_mean(self.origin, known)}")
        at = np.asarray(place, dtype=np.float64)
        if len(at) == 3:
            if self.frame == "base":
                return at
            camera = self._camera(context, "base")
            at = camera.from_base(at[None])[0] if self.frame == "camera" else camera.project_from_base(at[None])[0]
        elif not self.planar:
            raise ValueError(f"feature {self.kind!r}: origin {self.origin!r} is a pixel, but its points are metres.")
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
class Placed(Feature):
    """A feature of where the points lie."""

    @property
    @abstractmethod
    def coordinates(self) -> Coordinates:
        """Where its points are measured."""

    @property
    def unit(self) -> str:
        """That of the coordinates."""
        return self.coordinates.unit

    @property
    def needs_depth(self) -> bool:
        """In metres."""
        return not self.coordinates.planar

    @property
    def anchored(self) -> bool:
        """Where the origin is an anchor."""
        return self.coordinates.origin not in (None, "centroid")

    def error(self, shape: Shape, context: FeatureContext) -> float:
        """Mean distance of the measured points from those that ``reconstruct`` makes of the values, in their unit.

        Raises:
            ValueError: The feature cannot be turned back into points.
        """
        points = self.coordinates.points(shape, context)
        back = self.reconstruct(self.compute(shape, context), shape.layout, context)
        known = self.coordinates.weights(shape, points) == 1
        return float(np.linalg.norm(points - back, axis=1)[known].mean())


@dataclass(frozen=True)
class Framed(Placed):
    """A feature that can be had in any frame.

    Args:
        frame: ``"pixels"``, ``"normalized"``, ``"camera"`` or ``"base"``; see ``Coordinates``.
    """

    frame: CoordinateFrame = "camera"

    def __post_init__(self) -> None:
        super().__post_init__()
        given = {name: getattr(self, name) for name in ("origin", "max_depth") if hasattr(self, name)}
        object.__setattr__(self, "_coordinates", Coordinates(self.frame, kind=self.kind, **given))

    @property
    def coordinates(self) -> Coordinates:
        """As given."""
        return self._coordinates  # type: ignore[attr-defined]

    def complete(self, shape: Shape, context: FeatureContext) -> Array:
        """(N,2) or (N,3) the points, unknown ones filled in along the layout from known ones; NaN if none is known."""
        points = self.coordinates.points(shape, context)
        known = ~np.isnan(points[:, 0])
        if known.all() or not known.any():
            return points
        return shape.layout.interpolate(points, known)


@dataclass(frozen=True)
class Geometric(Framed):
    """A feature that can be had in any coordinates.

    Args:
        frame: ``"pixels"``, ``"normalized"``, ``"camera"`` or ``"base"``; see ``Coordinates``.
        origin: None, ``"centroid"``, ``"anchor"`` or the name of a published anchor.
        max_depth: Metres; how far the camera's view is taken to reach when bounds are made.
    """

    origin: str | None = None
    max_depth: float = 2.0


def _frustum(camera: CameraModel, depth: float) -> Array:
    """Return the camera's centre and the corners of what it sees up to a depth: (5,3) metres, camera frame.

    Image corners to which the lens has no ray are left out.
    """
    right, bottom = camera.intrinsics.width - 0.5, camera.intrinsics.height - 0.5
    corners = camera.intrinsics.rays([[-0.5, -0.5], [right, -0.5], [-0.5, bottom], [right, bottom]]) * depth
    return np.concatenate([np.zeros((1, 3)), corners[np.isfinite(corners).all(axis=1)]])
