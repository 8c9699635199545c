"""The points themselves: in pixels, normalised to the image's size, or in metres.

How far a shape can be trusted, as numbers that a policy can see (it cannot read ``info``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from shape_obs.features.coordinates import Coordinates, Placed
from shape_obs.features.feature import Feature, FeatureContext
from shape_obs.geometry.topology import Topology
from shape_obs.shape import Shape
from shape_obs.spec import SpecError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Points(Placed):
    """All coordinates of all points, one point after the other."""

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """Those of a point, for each."""
        low, high = self.coordinates.box(context)
        return np.tile(low, layout.size), np.tile(high, layout.size)

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """All coordinates; those of unknown points are NaN."""
        return self.coordinates.points(shape, context).ravel()

    def measured(self, shape: Shape, size: int) -> npt.NDArray[np.bool_]:
        """Those of points that were: visible in an image, with depth in space."""
        return np.repeat(shape.visible if self.coordinates.planar else shape.valid, size // len(shape))

    def reconstruct(self, values: npt.ArrayLike, layout: Topology, context: FeatureContext) -> Array:
        """(N,2) or (N,3), exactly the points."""
        return np.asarray(values, dtype=np.float64).reshape(layout.size, -1)


@dataclass(frozen=True)
class Points2D(_Points, kind="points2d"):
    """(u0, v0, u1, v1, ...) in pixels, pixel centres at integers; within the image.

    Args:
        origin: What points are relative to: None for the image's first pixel, ``"centroid"`` for their mean,
            ``"anchor"`` for the shape's anchor as the camera sees it, else the name of a published anchor.
    """

    origin: str | None = None

    @property
    def coordinates(self) -> Coordinates:
        """Pixels."""
        return Coordinates("pixels", self.origin, kind=self.kind)


@dataclass(frozen=True)
class Points2DNormalized(_Points, kind="points2d_normalized"):
    """(u0, v0, u1, v1, ...), -1...1 from the image's first edge to its last: 2 (u + 0.5) / width - 1, likewise v.

    Args:
        origin: As for ``points2d``; None for the image's centre.
    """

    origin: str | None = None

    @property
    def coordinates(self) -> Coordinates:
        """Normalised pixels."""
        return Coordinates("normalized", self.origin, kind=self.kind)


@dataclass(frozen=True)
class Points3D(_Points, kind="points3d"):
    """(x0, y0, z0, x1, ...) in metres.

    Args:
        frame: ``"camera"`` (optical frame: x right, y down, z forward), ``"base"`` (needs the camera's place), or
            ``"anchor"``, short for ``frame="base", origin="anchor"``.
        max_depth: Metres; how far the camera's view is taken to reach when bounds are made.
        origin: What points are relative to: None for the frame's own origin, ``"centroid"`` for their mean,
            ``"anchor"`` for the shape's anchor, else the name of a published anchor, such as a second gripper.
    """

    frame: Literal["camera", "base", "anchor"] = "camera"
    max_depth: float = 2.0
    origin: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.frame == "anchor" and self.origin is not None:
            raise SpecError(
                f"points3d: frame 'anchor' has an origin already; give frame='base' with origin={self.origin!r}."
            )
        frame, origin = ("base", "anchor") if self.frame == "anchor" else (self.frame, self.origin)
        object.__setattr__(self, "_coordinates", Coordinates(frame, origin, self.max_depth, self.kind))

    @property
    def coordinates(self) -> Coordinates:
        """Metres."""
        return self._coordinates  # type: ignore[attr-defined]


@dataclass(frozen=True)
class Ok(Feature, kind="ok"):
    """1 where the shape is ok, else 0."""

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """0...1."""
        return np.zeros(1), np.ones(1)

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """(1,)."""
        return np.array([float(shape.ok)])


@dataclass(frozen=True)
class Age(Feature, kind="age"):
    """Seconds since the points were seen, at most ``max_age`` (past that ``ok`` is 0 anyway)."""

    @property
    def unit(self) -> str:
        """Seconds."""
        return "s"

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """0...max_age."""
        return np.zeros(1), np.full(1, context.max_age)

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """(1,) seconds."""
        return np.array([min(shape.age, context.max_age)])


@dataclass(frozen=True)
class Valid(Feature, kind="valid"):
    """For each point 1 where it was really measured, 0 where it was filled in."""

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """0...1."""
        return np.zeros(layout.size), np.ones(layout.size)

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """(N,)."""
        return shape.valid.astype(np.float64)
