"""Tangents: which way the shape runs at each point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from shape_obs.features.base import View
from shape_obs.features.coordinates import Framed
from shape_obs.shape import Shape
from shape_obs.topology import Chain, Grid, Ring, Topology

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Tangents(Framed, kind="tangents"):
    """Unit tangents: ``t_i = (p_{i+1} - p_{i-1}) / |p_{i+1} - p_{i-1}|``, at an open end those of its edge.

    N x 2 or N x 3 values without a unit, one point after the other. Of a lattice 2 N tangents: first along the rows,
    to the right, then down the columns. It does not matter where the shape lies. Unknown points are filled in along the
    layout first; a tangent is NaN where both neighbours are at one place.

    ``"normalized"`` stretches an image that is not square, and directions with it: ``"pixels"`` does not.

    References:
        M. P. do Carmo, "Differential Geometry of Curves and Surfaces", 1976, section 1-3; by central differences.
    """

    @property
    def unit(self) -> str:
        """None."""
        return ""

    def bounds(self, layout: Topology, view: View) -> tuple[Array, Array]:
        """-1...1."""
        low, _ = self.coordinates.box(view)
        count = len(_neighbours(layout)[0]) * len(low)
        return np.full(count, -1.0), np.ones(count)

    def compute(self, shape: Shape, view: View) -> Array:
        """(2 N,) or (3 N,), of a lattice twice as many."""
        points = self.complete(shape, view)
        after, before = _neighbours(shape.layout)
        way = points[after] - points[before]
        length = np.sqrt(np.einsum("nd,nd->n", way, way))
        length[length == 0] = np.nan
        return (way / length[:, None]).ravel()


@lru_cache(maxsize=64)
def _neighbours(layout: Any) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """For each tangent the point after and the point before it, the point itself at an end."""
    at = np.arange(layout.size)
    if isinstance(layout, Ring):
        return np.roll(at, -1), np.roll(at, 1)
    if isinstance(layout, Chain):
        return np.append(at[1:], at[-1]), np.append(at[0], at[:-1])
    if not isinstance(layout, Grid):
        raise ValueError(f"feature 'tangents' is of a Chain, a Ring or a Grid, got {layout}.")
    at = at.reshape(layout.rows, layout.cols)
    wide, tall = np.pad(at, ((0, 0), (1, 1)), mode="edge"), np.pad(at, ((1, 1), (0, 0)), mode="edge")
    after, before = (wide[:, 2:], tall[2:]), (wide[:, :-2], tall[:-2])
    return np.ravel(after), np.ravel(before)
