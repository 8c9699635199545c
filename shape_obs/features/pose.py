"""The position, orientation and length of a shape as a whole."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from shape_obs.features.coordinates import Framed, Geometric
from shape_obs.features.curvature import closes, polyline
from shape_obs.features.feature import FeatureContext
from shape_obs.geometry.topology import Chain, Grid, Ring, Topology
from shape_obs.shape import Shape

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Centroid(Geometric, kind="centroid"):
    """The mean of the points: (u, v) or (x, y, z), in the coordinates' unit.

    Unknown points are filled in along the layout first, because the mean of the others alone would be biased.
    """

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """Return the bounds of a point."""
        return self.coordinates.box(context)

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """Return the centroid, of shape ``(2,)`` or ``(3,)``."""
        return self.complete(shape, context).mean(axis=0)


#: Size of the heading, relative to the points, below which it is float32 rounding.
_ROUNDING: Final = 1e-6


@dataclass(frozen=True)
class Orientation(Framed, kind="orientation"):
    """A direction in the plane of the frame's first two axes, as (cos, sin), which has no jump at a full turn.

    The heading is the direction of ``h = sum_i w_i p_i``. For a chain, ``w_i = i - (N - 1) / 2``: the direction of the
    least-squares line through the points, from the first end to the last. For a lattice it is the same over the column
    index: along the rows, to the right. For a ring, ``w_i = cos(2 pi i / N)``, the first harmonic: from the centre
    towards point 0. The heading rotates with the material and is continuous except where h vanishes.

    The principal axis is that of the largest variance, ``theta = atan2(2 s_xy, s_xx - s_yy) / 2``; of its two
    directions it is the one with ``h . (cos, sin) > 0``. It jumps where the shape is as wide as long, or where h is
    perpendicular to it. For a ring, only its sign depends on the position of point 0.

    Unknown points are filled in along the layout first. The values are NaN where the direction is undefined.

    Args:
        frame: ``"pixels"``, ``"normalized"``, ``"camera"`` or ``"base"``; see ``Coordinates``. ``"normalized"``
            distorts directions unless the image is square.
        axis: ``"heading"`` or ``"principal"``.

    References:
        B. K. P. Horn, "Robot Vision", 1986, section 3.2 (principal axis); F. P. Kuhl and C. R. Giardina, "Elliptic
        Fourier features of a closed contour", 1982 (first harmonic).
    """

    axis: Literal["heading", "principal"] = "heading"

    @property
    def unit(self) -> str:
        """The values have no unit."""
        return ""

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """Return -1 and 1."""
        _weights(layout)
        self.coordinates.box(context)  # raises an error if the context lacks what the frame needs
        return np.full(2, -1.0), np.ones(2)

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """Return cosine and sine, counted from the first axis towards the second, of shape ``(2,)``."""
        points = self.complete(shape, context)[:, :2]
        heading = _weights(shape.layout) @ points
        length = np.sqrt(heading @ heading)
        if not length > _ROUNDING * np.abs(points).max():
            return np.full(2, np.nan)
        heading /= length
        return heading if self.axis == "heading" else _principal(points, heading)


def _principal(points: Array, heading: Array) -> Array:
    """Return the axis of the largest variance, of shape ``(2,)``, on the side of the heading; NaN if undefined."""
    away = points - points.mean(axis=0)
    (xx, xy), (_, yy) = away.T @ away
    if np.hypot(2 * xy, xx - yy) <= _ROUNDING * (xx + yy):
        return np.full(2, np.nan)
    angle = np.arctan2(2 * xy, xx - yy) / 2
    axis = np.array([np.cos(angle), np.sin(angle)])
    return axis if axis @ heading > 0 else -axis


@lru_cache(maxsize=64)
def _weights(layout: Any) -> Array:
    """Return the weights of the points in the heading, of shape ``(N,)``."""
    at = np.arange(layout.size, dtype=np.float64)
    if isinstance(layout, Ring):
        return np.cos(2 * np.pi * at / layout.size)
    if not isinstance(layout, (Chain, Grid)):
        raise ValueError(f"feature 'orientation' is for a Chain, a Ring or a Grid, got {layout}.")
    column = at % layout.cols if isinstance(layout, Grid) else at
    return column - column.mean()


@dataclass(frozen=True)
class Length(Framed, kind="length"):
    """The arc length of a chain or the perimeter of a ring, ``E sum_e w_e |e| / sum_e w_e`` over its E edges.

    If all points are measured, this is the sum of the edges. Points are equidistant, so an edge to an unknown point
    counts as the mean of the others, and one to a filled-in point has a small weight. NaN if no edge is known.

    Args:
        frame: ``"pixels"``, ``"normalized"``, ``"camera"`` or ``"base"``; see ``Coordinates``.
        max_depth: Depth in metres up to which the camera's view is taken into account for bounds.
    """

    max_depth: float = 2.0

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """Return 0 and the length with each edge as long as the diagonal of the points' box."""
        edges = layout.size if closes(layout, self.kind) else layout.size - 1
        low, high = self.coordinates.box(context)
        return np.zeros(1), np.full(1, edges * np.linalg.norm(high - low))

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """Return the length, of shape ``(1,)``."""
        closed = closes(shape.layout, self.kind)
        points = self.coordinates.points(shape, context)
        weight = polyline(self.coordinates.weights(shape, points), closed)
        line = polyline(points, closed)
        edge, weight = line[1:] - line[:-1], weight[1:] * weight[:-1]
        known = weight > 0
        if not known.any():
            return np.full(1, np.nan)
        length = np.sqrt(np.einsum("kd,kd->k", edge, edge))
        return np.full(1, len(edge) * (weight[known] @ length[known]) / weight.sum())
