"""Orientation: which way a shape lies as a whole."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from shape_obs.features.base import View
from shape_obs.features.coordinates import Framed
from shape_obs.shape import Shape
from shape_obs.topology import Chain, Grid, Ring, Topology

Array = npt.NDArray[np.float64]

#: What float32 points leave of nothing, relative to them.
_ROUNDING: Final = 1e-6


@dataclass(frozen=True)
class Orientation(Framed, kind="orientation"):
    """A direction in the plane of the frame's first two axes, as (cos, sin), so that no angle jumps by a turn.

    The heading is ``h = sum_i w_i p_i``, and the direction is that of h. Of a chain ``w_i = i - (N - 1) / 2``: the
    slope of a straight line through the points by least squares, from the first end to the last. Of a lattice the same
    over the columns' index: along its rows, to the right. Of a ring ``w_i = cos(2 pi i / N)``, the first harmonic:
    from the middle towards point 0. It turns with the material and nowhere jumps, but where h vanishes.

    The principal axis is that of the points' largest variance, ``theta = atan2(2 s_xy, s_xx - s_yy) / 2``; of its two
    directions it is the one with ``h . (cos, sin) > 0``. It jumps where the shape is as broad as long, or h stands at a
    right angle to it, and it does not depend on where on a ring point 0 is but for the sign.

    Unknown points are filled in along the layout first. NaN where there is no such direction.

    Args:
        frame: ``"pixels"``, ``"normalized"``, ``"camera"`` or ``"base"``; see ``Coordinates``. ``"normalized"``
            stretches an image that is not square, and directions with it.
        axis: ``"heading"`` or ``"principal"``.

    References:
        B. K. P. Horn, "Robot Vision", 1986, section 3.2 (principal axis); F. P. Kuhl and C. R. Giardina, "Elliptic
        Fourier features of a closed contour", 1982 (first harmonic).
    """

    axis: Literal["heading", "principal"] = "heading"

    @property
    def unit(self) -> str:
        """None."""
        return ""

    def bounds(self, layout: Topology, view: View) -> tuple[Array, Array]:
        """-1...1."""
        _weights(layout)
        self.coordinates.box(view)  # says what the frame lacks
        return np.full(2, -1.0), np.ones(2)

    def compute(self, shape: Shape, view: View) -> Array:
        """(2,) cosine and sine from the first axis towards the second."""
        points = self.complete(shape, view)[:, :2]
        heading = _weights(shape.layout) @ points
        length = np.sqrt(heading @ heading)
        if not length > _ROUNDING * np.abs(points).max():
            return np.full(2, np.nan)
        heading /= length
        return heading if self.axis == "heading" else _principal(points, heading)


def _principal(points: Array, heading: Array) -> Array:
    """(2,) along the axis of the largest variance, to the heading's side; NaN where there is none."""
    away = points - points.mean(axis=0)
    (xx, xy), (_, yy) = away.T @ away
    if np.hypot(2 * xy, xx - yy) <= _ROUNDING * (xx + yy):
        return np.full(2, np.nan)
    angle = np.arctan2(2 * xy, xx - yy) / 2
    axis = np.array([np.cos(angle), np.sin(angle)])
    return axis if axis @ heading > 0 else -axis


@lru_cache(maxsize=64)
def _weights(layout: Any) -> Array:
    """(N,) of the points in the heading."""
    at = np.arange(layout.size, dtype=np.float64)
    if isinstance(layout, Ring):
        return np.cos(2 * np.pi * at / layout.size)
    if not isinstance(layout, (Chain, Grid)):
        raise ValueError(f"feature 'orientation' is of a Chain, a Ring or a Grid, got {layout}.")
    column = at % layout.cols if isinstance(layout, Grid) else at
    return column - column.mean()
