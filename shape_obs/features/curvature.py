"""Turning angles, curvature and tangents of shapes at each point."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.features.coordinates import Framed
from shape_obs.features.feature import FeatureContext
from shape_obs.geometry.topology import Chain, Grid, Ring, Topology
from shape_obs.shape import Shape

Array = npt.NDArray[np.float64]


#: Curvature at which the feature saturates: a radius of 1 cm, 5 pixels, or 5 % of half the image.
MAX_CURVATURE: Final = {"camera": 100.0, "base": 100.0, "pixels": 0.2, "normalized": 20.0}


@dataclass(frozen=True)
class _Bending(Framed):
    """A value at each point of a ring, or at each inner point of a chain."""

    @abstractmethod
    def limit(self) -> float:
        """The highest value; the lowest is its negative."""

    @abstractmethod
    def bend(self, turn: Array, lengths: Array, steps: Array) -> Array:
        """Return the value at K points.

        Args:
            turn: ``(K,)`` angles in radians from the edge before the point to the edge after it.
            lengths: ``(K,)`` sums of the lengths of both edges.
            steps: ``(K,)`` number of gaps that both edges span: 2 if both neighbours are known.
        """

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """Return minus the limit and the limit for each value."""
        count = self._count(layout)
        if count < 1:
            raise ValueError(f"feature {self.kind!r} needs at least three points, got {layout}.")
        self.coordinates.box(context)  # raises an error if the context lacks what the frame needs
        return np.full(count, -self.limit()), np.full(count, self.limit())

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """Return the values, of shape (N - 2,) for a chain and ``(N,)`` for a ring."""
        places = self.coordinates.points(shape, context)[:, :2]
        closed, size = closes(shape.layout, self.kind), len(places)
        known = np.flatnonzero(~np.isnan(places[:, 0]))
        if len(known) < 3:
            return np.full(self._count(shape.layout), np.nan)
        line, at = places[known], known.astype(np.float64)
        if closed:
            line = np.concatenate([line[-1:], line, line[:1]])
            at = np.concatenate([at[-1:] - size, at, at[:1] + size])
        edge = line[1:] - line[:-1]
        length = np.sqrt(np.einsum("kd,kd->k", edge, edge))
        (x0, y0), (x1, y1) = edge[:-1].T, edge[1:].T
        turn = np.arctan2(x0 * y1 - y0 * x1, x0 * x1 + y0 * y1)
        turn[length[1:] * length[:-1] == 0] = np.nan
        value = self.bend(turn, length[1:] + length[:-1], at[2:] - at[:-2])
        if len(known) == size:
            return value
        wanted = np.arange(size) if closed else np.arange(1, size - 1)
        return np.interp(wanted, at[1:-1], value, period=size if closed else None)

    def _count(self, layout: Topology) -> int:
        return layout.size if closes(layout, self.kind) else layout.size - 2


@dataclass(frozen=True)
class TurningAngles(_Bending, kind="turning_angles"):
    """Turning angles ``phi_i = atan2(e_{i-1} x e_i, <e_{i-1}, e_i>)`` of the edges ``e_i = p_{i+1} - p_i``.

    The angles are in radians, in the plane of the frame's first two axes, from the first towards the second: clockwise
    as seen in pixels and in the camera frame, counter-clockwise from above in a base frame with z up. A chain has
    N - 2 of them; a ring has N, which sum up to a full turn. They are invariant to translation and to rotation in that
    plane. The frame ``"normalized"`` distorts angles unless the image is square; ``"pixels"`` does not.

    Across unknown points the angle is distributed over the gap, and that of an unknown point is interpolated. NaN where
    points coincide or fewer than three are known.

    References:
        K. Crane and M. Wardetzky, "A Glimpse into Discrete Differential Geometry", Notices of the AMS 64(10), 2017:
        the turning angle as the discrete curvature of a plane curve.
    """

    @property
    def unit(self) -> str:
        """Radians."""
        return "rad"

    def limit(self) -> float:
        """Return a half turn."""
        return np.pi

    def bend(self, turn: Array, lengths: Array, steps: Array) -> Array:
        """Return the angle per gap between points."""
        return 2 * turn / steps


@dataclass(frozen=True)
class Curvature(_Bending, kind="curvature"):
    """Discrete curvature ``kappa_i = 2 sin(phi_i / 2) / l_i`` with the mean length ``l_i`` of the two edges.

    The unit is 1/m, 1/px, or 1 per half the image. Sign, plane and the treatment of unknown points are those of
    ``turning_angles``. For a polygon with equal sides this is one over the radius of the circle through its corners,
    for any number of corners. It is invariant to translation and to rotation in the plane.

    For points 20 mm apart, an error of 1 mm across the line changes the curvature by 6 / m. If that is too much, use
    ``turning_angles``, which contain the same without the division.

    Args:
        max_curvature: Value at which it saturates; None for a radius of 1 cm, 5 pixels, or 5 % of half the image.

    References:
        K. Crane and M. Wardetzky, "A Glimpse into Discrete Differential Geometry", Notices of the AMS 64(10), 2017:
        the discrete curvature that is the gradient of length, divided by the length assigned to a point.
    """

    max_curvature: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.max_curvature is not None and not 0 < self.max_curvature < np.inf:
            raise ValueError(f"curvature: max_curvature must be a positive number, got {self.max_curvature}.")

    @property
    def unit(self) -> str:
        """One over the unit of the coordinates."""
        return f"1/{self.coordinates.unit}" if self.coordinates.unit else ""

    def limit(self) -> float:
        """Return ``max_curvature``, or its default for the frame."""
        return self.max_curvature or MAX_CURVATURE[self.frame]

    def bend(self, turn: Array, lengths: Array, steps: Array) -> Array:
        """Return the curvature along the edges, for any number of gaps."""
        limit = self.limit()
        return np.minimum(np.maximum(4 * np.sin(turn / 2) / lengths, -limit), limit)


@dataclass(frozen=True)
class Tangents(Framed, kind="tangents"):
    """Unit tangents ``t_i = (p_{i+1} - p_{i-1}) / |p_{i+1} - p_{i-1}|``, at an open end those of its edge.

    There are 2 N or 3 N values without a unit, point after point. A lattice has 2 N tangents: first those along the
    rows, to the right, then those down the columns. They are invariant to translation. Unknown points are filled in
    along the layout first; a tangent is NaN where both neighbours coincide.

    The frame ``"normalized"`` distorts directions unless the image is square; ``"pixels"`` does not.

    References:
        M. P. do Carmo, "Differential Geometry of Curves and Surfaces", 1976, section 1-3; here with central
        differences.
    """

    @property
    def unit(self) -> str:
        """The values have no unit."""
        return ""

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """Return -1 and 1 for each value."""
        low, _ = self.coordinates.box(context)
        count = len(_neighbours(layout)[0]) * len(low)
        return np.full(count, -1.0), np.ones(count)

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """Return the tangents, of shape (2 N,) or (3 N,); twice as many for a lattice."""
        points = self.complete(shape, context)
        after, before = _neighbours(shape.layout)
        way = points[after] - points[before]
        length = np.sqrt(np.einsum("nd,nd->n", way, way))
        length[length == 0] = np.nan
        return (way / length[:, None]).ravel()


@lru_cache(maxsize=64)
def _neighbours(layout: Any) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return for each tangent the indices of the next and the previous point; at an end the point itself."""
    at = np.arange(layout.size)
    if isinstance(layout, Ring):
        return np.roll(at, -1), np.roll(at, 1)
    if isinstance(layout, Chain):
        return np.append(at[1:], at[-1]), np.append(at[0], at[:-1])
    if not isinstance(layout, Grid):
        raise ValueError(f"feature 'tangents' is for a Chain, a Ring or a Grid, got {layout}.")
    at = at.reshape(layout.rows, layout.cols)
    wide, tall = np.pad(at, ((0, 0), (1, 1)), mode="edge"), np.pad(at, ((1, 1), (0, 0)), mode="edge")
    after, before = (wide[:, 2:], tall[2:]), (wide[:, :-2], tall[:-2])
    return np.ravel(after), np.ravel(before)


def closes(layout: Topology, kind: str) -> bool:
    """Return whether a line is closed.

    Args:
        layout: A chain or a ring.
        kind: The kind of the feature, for the error message.

    Raises:
        ValueError: The layout is not a line.
    """
    if not isinstance(layout, (Chain, Ring)):
        raise ValueError(
            f"feature {kind!r} is for a line, a Chain (centerline) or a Ring (contour), got {layout}. For a lattice "
            "there are 'tangents', 'region_moments', 'centroid' and 'orientation'."
        )
    return isinstance(layout, Ring)


def polyline(values: Array, closed: bool) -> Array:
    """Return the values along a line, with the first one repeated at the end if the line is closed."""
    return np.concatenate([values, values[:1]]) if closed else values
