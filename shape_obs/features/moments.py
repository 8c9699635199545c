"""Moments of a line, and of the region that it encloses."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final, Literal

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.features.coordinates import Geometric
from shape_obs.features.curvature import closes, polyline
from shape_obs.features.feature import FeatureContext
from shape_obs.geometry.topology import Grid, Ring, Topology
from shape_obs.shape import Shape

Array = npt.NDArray[np.float64]

#: Area of a region, as a share of the squared extent of its outline, below which it counts as a line without moments.
_LEAST_AREA: Final = 1e-3


@dataclass(frozen=True)
class _Moments(Geometric):
    """Size, centroid and normalised central moments, in the plane of the frame's first two axes.

    Args:
        order: Highest order; 2 gives six values, 3 ten.
    """

    order: Literal[2, 3] = 2

    @abstractmethod
    def size(self, layout: Topology, extent: Array) -> float:
        """Return the highest value of the size, for points within an extent of shape ``(2,)``."""

    @abstractmethod
    def largest(self) -> tuple[float, float]:
        """Return the highest normalised central moments of second and third order."""

    @property
    def unit(self) -> str:
        """Empty, since the units differ; see ``units``."""
        return ""

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """Return the bounds of the size, of the centroid (as for a point), and of the moments."""
        low, high = replace(self.coordinates, origin=None).box(context)
        size = self.size(layout, (high - low)[:2])
        low, high = self.coordinates.box(context)
        second, third = self.largest()
        lowest = [0.0, *low[:2], 0.0, -second / 2, 0.0, *4 * [-third]]
        highest = [size, *high[:2], second, second / 2, second, *4 * [third]]
        count = 6 if self.order == 2 else 10
        return np.array(lowest[:count]), np.array(highest[:count])

    def _units(self, size: str) -> tuple[str, ...]:
        unit = self.coordinates.unit
        return (size, unit, unit, *(3 if self.order == 2 else 7) * ("",))


@dataclass(frozen=True)
class ContourMoments(_Moments, kind="contour_moments"):
    """Moments of a chain or a ring as a line, ``m_pq = int x^p y^q ds`` along its edges, in closed form.

    The values are ``(L, x, y, eta_20, eta_11, eta_02)`` and, with ``order=3``, ``eta_30, eta_21, eta_12, eta_03``: the
    length ``L = m_00``, the centroid ``(m_10, m_01) / L``, and the central moments ``eta_pq = mu_pq / L^(p+q+1)``,
    which have no unit and are invariant to translation and scale. The distance between two points of a line is at most
    their arc length, so ``eta_20 + eta_02 <= 1/12``, the value of a straight line, and moments of third order lie
    within 1/24.

    Unknown points are filled in along the layout first. The values are NaN if all points coincide.

    Args:
        frame: ``"pixels"``, ``"normalized"``, ``"camera"`` or ``"base"``; see ``Coordinates``.
        origin: The origin of the centroid: None, ``"centroid"``, ``"anchor"`` or the name of a published anchor.
        max_depth: Depth in metres up to which the camera's view is taken into account for bounds.
        order: Highest order; 2 gives six values, 3 ten.

    References:
        C.-C. Chen, "Improved moment invariants for shape discrimination", Pattern Recognition 26(5), 1993.
    """

    def size(self, layout: Topology, extent: Array) -> float:
        """Return the length with each edge as long as the diagonal."""
        edges = layout.size if closes(layout, self.kind) else layout.size - 1
        return edges * float(np.hypot(*extent))

    def largest(self) -> tuple[float, float]:
        """Return the moment of a straight line, and half of it."""
        return 1 / 12, 1 / 24

    def units(self, layout: Topology, context: FeatureContext) -> tuple[str, ...]:
        """Return the units of the length and the centroid, and none for the moments."""
        return self._units(self.coordinates.unit)

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """Return the values, of shape ``(6,)`` or ``(10,)``."""
        line = polyline(self.complete(shape, context)[:, :2], closes(shape.layout, self.kind))
        edge = line[1:] - line[:-1]
        length = np.sqrt(np.einsum("kd,kd->k", edge, edge))
        total = length.sum()
        if not total > 0:
            return np.full(6 if self.order == 2 else 10, np.nan)
        share, middle = length / total, (line[1:] + line[:-1]) / 2
        centroid = share @ middle
        (x, y), (dx, dy) = (middle - centroid).T / total, edge.T / total
        # Along an edge (x + t dx, y + t dy), t from -1/2 to 1/2: the mean of t^2 is 1/12.
        terms = [x * x + dx * dx / 12, x * y + dx * dy / 12, y * y + dy * dy / 12]
        if self.order == 3:
            terms += [
                x * (x * x + dx * dx / 4),
                x * x * y + dx * (2 * x * dy + dx * y) / 12,
                x * y * y + dy * (2 * y * dx + dy * x) / 12,
                y * (y * y + dy * dy / 4),
            ]
        return np.concatenate([[total], centroid, np.stack(terms) @ share])


@dataclass(frozen=True)
class RegionMoments(_Moments, kind="region_moments"):
    """Moments of the region inside a ring, or inside the border of a lattice, ``m_pq = int int x^p y^q dx dy``.

    The values are ``(A, x, y, nu_20, nu_11, nu_02)`` and, with ``order=3``, ``nu_30, nu_21, nu_12, nu_03``: the area
    ``A = m_00``, the centroid ``(m_10, m_01) / A``, and the central moments ``nu_pq = mu_pq / A^(1 + (p+q)/2)``, which
    have no unit and are invariant to translation and scale. By Green's theorem they are sums over the edges
    (``cv2.moments``, computed about the centre of the outline and in units of its extent, because it ignores small
    areas). The direction of the outline does not matter.

    Unknown points are filled in along the layout first. The values are NaN if hardly any area is enclosed. Where an
    outline crosses itself, area counts once per winding.

    Args:
        frame: ``"pixels"``, ``"normalized"``, ``"camera"`` or ``"base"``; see ``Coordinates``.
        origin: The origin of the centroid: None, ``"centroid"``, ``"anchor"`` or the name of a published anchor.
        max_depth: Depth in metres up to which the camera's view is taken into account for bounds.
        order: Highest order; 2 gives six values, 3 ten.
        max_elongation: Ratio of length to width at which the moments saturate; they grow as a region gets thinner.
            Those of second order saturate at a twelfth of it, as for a rectangle, those of third order at that to the
            power 3/2.

    References:
        M.-K. Hu, "Visual pattern recognition by moment invariants", IRE Trans. Information Theory 8(2), 1962;
        C. Steger, "On the calculation of arbitrary moments of polygons", FGBV-96-05, TU Muenchen, 1996.
    """

    max_elongation: float = 12.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.max_elongation < np.inf:
            raise ValueError(f"region_moments: max_elongation must be a number from 1 on, got {self.max_elongation}.")

    def size(self, layout: Topology, extent: Array) -> float:
        """Return the area of the whole box."""
        _border(layout)
        return float(np.prod(extent))

    def largest(self) -> tuple[float, float]:
        """Return the values at which the moments saturate."""
        return self.max_elongation / 12, (self.max_elongation / 12) ** 1.5

    def units(self, layout: Topology, context: FeatureContext) -> tuple[str, ...]:
        """Return the units of the area and the centroid, and none for the moments."""
        unit = self.coordinates.unit
        return self._units(f"{unit}²" if unit else "")

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """Return the values, of shape ``(6,)`` or ``(10,)``."""
        border = self.complete(shape, context)[_border(shape.layout), :2]
        low, high = border.min(axis=0), border.max(axis=0)
        middle, reach = (low + high) / 2, float((high - low).max()) / 2
        found = cv2.moments(((border - middle) / reach).astype(np.float32)) if reach > 0 else {"m00": 0.0}
        if not found["m00"] > _LEAST_AREA:
            return np.full(6 if self.order == 2 else 10, np.nan)
        centroid = middle + reach * np.array([found["m10"], found["m01"]]) / found["m00"]
        second, third = self.largest()
        values = [
            found["m00"] * reach**2,
            # The centroid lies inside the box, except for outlines that cross themselves.
            *np.minimum(np.maximum(centroid, low), high),
            min(max(found["nu20"], 0.0), second),
            min(max(found["nu11"], -second / 2), second / 2),
            min(max(found["nu02"], 0.0), second),
        ]
        if self.order == 3:
            values += [min(max(found[name], -third), third) for name in ("nu30", "nu21", "nu12", "nu03")]
        return np.array(values)


@lru_cache(maxsize=64)
def _border(layout: Any) -> npt.NDArray[np.intp]:
    """Return the indices of the points around a region, in order.

    Raises:
        ValueError: The layout encloses no region.
    """
    at = np.arange(layout.size)
    if isinstance(layout, Ring):
        return at
    if not isinstance(layout, Grid):
        raise ValueError(
            f"feature 'region_moments' is for the region inside a Ring (contour) or a Grid (surface), got {layout}. "
            "For a line there are 'contour_moments'."
        )
    at = at.reshape(layout.rows, layout.cols)
    return np.concatenate([at[0], at[1:, -1], at[-1, -2::-1], at[-2:0:-1, 0]])
