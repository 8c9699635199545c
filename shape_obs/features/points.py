"""Features of single points: their coordinates, whether they were measured, and the status of the shape."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from shape_obs.features.coordinates import Coordinates, Positional
from shape_obs.features.feature import Feature, FeatureContext
from shape_obs.geometry.topology import Topology
from shape_obs.shape import Shape
from shape_obs.spec import SpecError
from shape_obs.tracking.belief import MAX_SIGMA

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Points(Positional):
    """All coordinates of all points, point after point."""

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """Return the bounds of one point, repeated for each point."""
        low, high = self.coordinates.box(context)
        return np.tile(low, layout.size), np.tile(high, layout.size)

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """Return all coordinates; NaN for unknown points."""
        return self.coordinates.points(shape, context).ravel()

    def measured(self, shape: Shape, size: int) -> npt.NDArray[np.bool_]:
        """Return which coordinates were measured: those of visible points in the image, of valid points in space."""
        return np.repeat(shape.visible if self.coordinates.planar else shape.valid, size // len(shape))

    def components(self, size: int) -> tuple[str, ...]:
        """Return ``("u0", "v0", "u1", ...)`` in the image, ``("x0", "y0", "z0", ...)`` in space."""
        axes = "uv" if self.coordinates.planar else "xyz"
        return tuple(f"{axes[i % len(axes)]}{i // len(axes)}" for i in range(size))

    def reconstruct(self, values: npt.ArrayLike, layout: Topology, context: FeatureContext) -> Array:
        """Return exactly the points, of shape ``(N, 2)`` or ``(N, 3)``."""
        return np.asarray(values, dtype=np.float64).reshape(layout.size, -1)


@dataclass(frozen=True)
class Points2D(_Points, kind="points2d"):
    """Pixels (u0, v0, u1, v1, ...) within the image, pixel centres at integers.

    Args:
        origin: The origin of the points: None for the first pixel of the image, ``"centroid"`` for their mean,
            ``"anchor"`` for the shape's anchor as the camera sees it, or the name of a published anchor.
    """

    origin: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self._set_coordinates(Coordinates("pixels", self.origin, kind=self.kind))


@dataclass(frozen=True)
class Points2DNormalized(_Points, kind="points2d_normalized"):
    """Pixels (u0, v0, u1, v1, ...) scaled to -1...1 over the image: 2 (u + 0.5) / width - 1, likewise for v.

    Args:
        origin: As for ``points2d``; None for the centre of the image.
    """

    origin: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self._set_coordinates(Coordinates("normalized", self.origin, kind=self.kind))


@dataclass(frozen=True)
class Points3D(_Points, kind="points3d"):
    """Positions (x0, y0, z0, x1, ...) in metres.

    Args:
        frame: ``"camera"`` (optical frame: x right, y down, z forward), ``"base"`` (needs the pose of the camera), or
            ``"anchor"``, short for ``frame="base", origin="anchor"``.
        max_depth: Depth in metres up to which the camera's view is taken into account for bounds.
        origin: The origin of the points: None for the frame's own origin, ``"centroid"`` for their mean, ``"anchor"``
            for the shape's anchor, or the name of a published anchor, such as a second gripper.
    """

    frame: Literal["camera", "base", "anchor"] = "camera"
    max_depth: float = 2.0
    origin: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.frame == "anchor" and self.origin is not None:
            raise SpecError(
                f"points3d: frame 'anchor' already has an origin; use frame='base' with origin={self.origin!r}."
            )
        frame, origin = ("base", "anchor") if self.frame == "anchor" else (self.frame, self.origin)
        self._set_coordinates(Coordinates(frame, origin, self.max_depth, self.kind))


@dataclass(frozen=True)
class Ok(Feature, kind="ok"):
    """1 if the shape is ok, else 0. Policies need it because they cannot read ``info``."""

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """Return 0 and 1."""
        return np.zeros(1), np.ones(1)

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """Return ``shape.ok`` as an array of shape ``(1,)``."""
        return np.array([float(shape.ok)])


@dataclass(frozen=True)
class Age(Feature, kind="age"):
    """Seconds since the points were seen, at most ``max_age``, after which ``ok`` is 0."""

    @property
    def unit(self) -> str:
        """Seconds."""
        return "s"

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """Return 0 and ``max_age``."""
        return np.zeros(1), np.full(1, context.max_age)

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """Return the age in seconds as an array of shape ``(1,)``."""
        return np.array([min(shape.age, context.max_age)])


@dataclass(frozen=True)
class Valid(Feature, kind="valid"):
    """For each point, 1 if it was measured and 0 if it was filled in."""

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """Return 0 and 1 for each point."""
        return np.zeros(layout.size), np.ones(layout.size)

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """Return ``shape.valid`` as numbers, of shape ``(N,)``."""
        return shape.valid.astype(np.float64)


@dataclass(frozen=True)
class Sigma(Feature, kind="sigma"):
    """For each point, the RMS error per axis that is expected of it: ``shape.sigma``, at most 1 m or the diagonal.

    Args:
        frame: ``"camera"`` for metres, which need depth; ``"pixels"``, of points in space at their own distance.
    """

    frame: Literal["camera", "pixels"] = "camera"

    @property
    def unit(self) -> str:
        """``"m"`` or ``"px"``."""
        return "m" if self.frame == "camera" else "px"

    @property
    def needs_depth(self) -> bool:
        """Whether the values are in metres."""
        return self.frame == "camera"

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """Return 0 and 1 m, or the diagonal of the image, for each point."""
        most = MAX_SIGMA if self.frame == "camera" else float(np.hypot(context.width, context.height))
        return np.zeros(layout.size), np.full(layout.size, most)

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """Return the errors, of shape ``(N,)``.

        Raises:
            ValueError: ``frame="camera"``, and the shape has no ``points3d``; or ``"pixels"``, and there is no camera.
        """
        sigma, points3d = shape.sigma.astype(np.float64), shape.points3d
        if self.frame == "camera":
            if points3d is None:
                raise ValueError("feature 'sigma' in metres needs depth and a camera; without them, frame='pixels'.")
            return sigma
        if points3d is None:
            return sigma
        if context.camera is None:
            raise ValueError("feature 'sigma' in pixels of points in space needs a camera model: pass camera=.")
        z = points3d[:, 2].astype(np.float64)
        known = np.isfinite(z) & (z > 0)
        if not known.any():
            return self.bounds(shape.layout, context)[1]
        z = shape.layout.interpolate(z[:, None], known)[:, 0]
        pixels_per_metre = (context.camera.intrinsics.fx + context.camera.intrinsics.fy) / 2 / z
        return np.minimum(sigma * pixels_per_metre, self.bounds(shape.layout, context)[1])


@dataclass(frozen=True)
class New(Feature, kind="new"):
    """1 in the first frame of a track, in which point i may be another material point than before; else 0."""

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """Return 0 and 1."""
        return np.zeros(1), np.ones(1)

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """Return ``shape.new`` as an array of shape ``(1,)``."""
        return np.array([float(shape.new)])
