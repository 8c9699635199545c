"""Centroid: where a shape is as a whole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shape_obs.features.base import View
from shape_obs.features.coordinates import Geometric
from shape_obs.shape import Shape
from shape_obs.topology import Topology

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Centroid(Geometric, kind="centroid"):
    """The mean of the points: (u, v) or (x, y, z), in the coordinates' unit.

    Unknown points are filled in along the layout first: the mean of the others would lie away from them.
    """

    def bounds(self, layout: Topology, view: View) -> tuple[Array, Array]:
        """Those of a point."""
        return self.coordinates.box(view)

    def compute(self, shape: Shape, view: View) -> Array:
        """(2,) or (3,)."""
        return self.complete(shape, view).mean(axis=0)
