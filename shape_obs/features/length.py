"""Length: how long a line is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shape_obs.features.base import View
from shape_obs.features.coordinates import Framed
from shape_obs.features.line import closes, polyline
from shape_obs.shape import Shape
from shape_obs.topology import Topology

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Length(Framed, kind="length"):
    """The arc length of a chain, the perimeter of a ring: ``E sum_e w_e |e| / sum_e w_e`` over its E edges.

    With all points measured that is the sum of the edges. Points are equidistant, so that an edge to a point that is
    unknown counts as the others' mean, and one to a point that was filled in hardly counts. NaN where no edge is known.

    Args:
        frame: ``"pixels"``, ``"normalized"``, ``"camera"`` or ``"base"``; see ``Coordinates``.
        max_depth: Metres; how far the camera's view is taken to reach when bounds are made.
    """

    max_depth: float = 2.0

    def bounds(self, layout: Topology, view: View) -> tuple[Array, Array]:
        """0 to each edge as long as the diagonal of the points' box."""
        edges = layout.size if closes(layout, self.kind) else layout.size - 1
        low, high = self.coordinates.box(view)
        return np.zeros(1), np.full(1, edges * np.linalg.norm(high - low))

    def compute(self, shape: Shape, view: View) -> Array:
        """(1,)."""
        closed = closes(shape.layout, self.kind)
        points = self.coordinates.points(shape, view)
        weight = polyline(self.coordinates.weights(shape, points), closed)
        line = polyline(points, closed)
        edge, weight = line[1:] - line[:-1], weight[1:] * weight[:-1]
        known = weight > 0
        if not known.any():
            return np.full(1, np.nan)
        length = np.sqrt(np.einsum("kd,kd->k", edge, edge))
        return np.full(1, len(edge) * (weight[known] @ length[known]) / weight.sum())
