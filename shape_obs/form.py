"""Forms: parameterised geometry laid over a body. A cold start makes one, and so do the fitted nodes.

A form sorts what has no order of its own and measures equal distances: along a curve by arc length, over a patch by
its two lattice coordinates.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from typing_extensions import Self

from shape_obs.curve import arc_length, interpolate

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Form(ABC):
    """Ordered points of a curve or a surface.

    Args:
        points: (P,D) pixels (D = 2) or metres (D = 3).
        bridged: (P,) bool: nothing of the body was seen there (a gap, or an end that is hidden).
        doubt: Of a cold start: why it may be wrong; empty when there is no doubt.
    """

    points: Array
    bridged: Mask
    doubt: str = field(default="", kw_only=True)

    @property
    @abstractmethod
    def size(self) -> float:
        """What the object's own size is judged by from frame to frame, in the unit of ``points``."""

    @abstractmethod
    def measured(self, points: Array) -> Self:
        """The same form with its points elsewhere: (P,D') for (P,D), say in metres for pixels."""


@dataclass(frozen=True, eq=False)
class Curve(Form):
    """A polyline; closed, the last point is followed by the first, which is not repeated."""

    closed: bool = False

    @cached_property
    def arc(self) -> Array:
        """(P,) arc length of the points; (P+1,) when closed, the last entry the whole."""
        return arc_length(self._polyline(self.points))

    @property
    def size(self) -> float:
        """Arc length from end to end, or once around."""
        return float(self.arc[-1])

    def at(self, arc: npt.ArrayLike) -> Array:
        """(N,D) points at (N,) arc positions; a closed curve wraps around."""
        at = np.asarray(arc, dtype=np.float64)
        at = at % self.size if self.closed else at
        return interpolate(self._polyline(self.points), self.arc, at)

    def bridged_at(self, arc: npt.ArrayLike) -> Mask:
        """(N,) whether the nearer of the two neighbouring points is bridged."""
        at = np.asarray(arc, dtype=np.float64)
        at = at % self.size if self.closed else at
        flags = np.append(self.bridged, self.bridged[0]) if self.closed else self.bridged
        after = np.clip(np.searchsorted(self.arc, at), 1, len(self.arc) - 1)
        nearer = np.where(at - self.arc[after - 1] < self.arc[after] - at, after - 1, after)
        return flags[nearer]

    def measured(self, points: Array) -> Self:
        """The same curve with its points elsewhere: (P,D') for (P,D), say in metres for pixels."""
        return replace(self, points=points)

    def reversed(self) -> Curve:
        """The same curve run through backwards; closed, the first point stays the first."""
        if not self.closed:
            return Curve(self.points[::-1], self.bridged[::-1])
        back = -np.arange(len(self.points))
        return Curve(self.points[back], self.bridged[back], True)

    def _polyline(self, points: Array) -> Array:
        return np.concatenate([points, points[:1]]) if self.closed else points


@dataclass(frozen=True, eq=False)
class Patch(Form):
    """A lattice of points over a sheet, row by row; the border rows and columns lie on the sheet's border.

    Args:
        v: (rows,) 0...1, the coordinate of each row from the sheet's top (0) to its bottom.
        u: (cols,) 0...1, the coordinate of each column from left to right.
    """

    v: Array
    u: Array

    @property
    def lattice(self) -> Array:
        """(rows, cols, D)."""
        return self.points.reshape(len(self.v), len(self.u), -1)

    @property
    def size(self) -> float:
        """Half the length of the border: the mean row plus the mean column."""
        return float(
            np.mean([arc_length(self.lattice[i])[-1] for i in (0, -1)])
            + np.mean([arc_length(self.lattice[:, j])[-1] for j in (0, -1)])
        )

    def measured(self, points: Array) -> Self:
        """The same patch with its points elsewhere: (P,D') for (P,D), say in metres for pixels."""
        return replace(self, points=points)
