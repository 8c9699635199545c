"""Forms: parameterised geometry laid over a body. A cold start makes one, and so do the fitted nodes.

A form sorts what has no order of its own and measures equal distances: along a curve by arc length, over a patch by
its two lattice coordinates.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt

from shape_obs.compiled import NUMPY, Kernels
from shape_obs.geometry.polyline import straightened

if TYPE_CHECKING:
    from typing_extensions import Self

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_SMOOTHING: Final = 9  # points of a fine curve


class Memory(NamedTuple):
    """What a form hands on to the next frame.

    Args:
        hidden: Arc length at the start and at the end of an open curve that is known to be there but hidden.
        slack: Hidden ends that are shorter than this are within what can be measured.
        size: The object's size as it is remembered, where that is not the size found; 0 where it is.
        reference: (K,D) nodes of its past that a closed curve was numbered by; else None.
    """

    hidden: tuple[float, float] = (0.0, 0.0)
    slack: float = 0.0
    size: float = 0.0
    reference: Array | None = None


@dataclass(frozen=True, eq=False)
class Form(ABC):
    """Ordered points of a curve or a surface.

    Args:
        points: (P,D) pixels (D = 2) or metres (D = 3).
        bridged: (P,) bool: nothing of the body was seen there (a gap, or an end that is hidden).
        memory: What the next frame is told beside the nodes.
        doubt: Of a cold start: why it may be wrong; empty when there is no doubt.
        kernels: What runs the inner loops.
    """

    points: Array
    bridged: Mask
    memory: Memory = field(default=Memory(), kw_only=True)
    doubt: str = field(default="", kw_only=True)
    kernels: Kernels = field(default=NUMPY, kw_only=True, repr=False)

    @property
    @abstractmethod
    def size(self) -> float:
        """What the object's own size is judged by from frame to frame, in the unit of ``points``."""

    @cached_property
    def whole(self) -> bool:
        """Whether nothing is bridged."""
        return not self.bridged.any()

    @property
    def empty(self) -> float:
        """The share of the form that is bridged."""
        return np.count_nonzero(self.bridged) / len(self.bridged)

    @abstractmethod
    def smoothed(self, values: Array, known: Mask) -> Array:
        """(P,) values at the points, the unknown ones filled in, smoothed over a few points."""

    @abstractmethod
    def measured(self, points: Array) -> Self:
        """The same form with its points elsewhere: (P,D') for (P,D), say in metres for pixels."""


@dataclass(frozen=True, eq=False)
class Curve(Form):
    """A polyline; closed, the last point is followed by the first, which is not repeated.

    Args:
        spread: Mean square distance of the body's samples from it, where the fit has measured that.
        miss: Mean distance of an outline's samples from it, where the fit has measured that.
    """

    closed: bool = False
    spread: float | None = None
    miss: float | None = None

    def along(self, arc: Array) -> Self:
        """The same curve, whose ``arc`` is known."""
        vars(self)["arc"] = arc
        return self

    @cached_property
    def arc(self) -> Array:
        """(P,) arc length of the points; (P+1,) when closed, the last entry the whole."""
        return self.kernels.arc_length(self._polyline(self.points))

    @property
    def size(self) -> float:
        """Arc length from end to end, or once around."""
        return float(self.arc[-1])

    @property
    def empty(self) -> float:
        """The share of the length that is bridged."""
        if self.whole:
            return 0.0
        step = np.diff(self.arc)
        flags = np.append(self.bridged, self.bridged[0]) if self.closed else self.bridged
        return float(step @ (flags[:-1] / 2 + flags[1:] / 2) / max(self.size, 1e-9))

    def remembering(self, memory: Memory) -> Self:
        """The same curve with another memory."""
        same = {"memory": memory, "doubt": self.doubt, "kernels": self.kernels}
        other = type(self)(self.points, self.bridged, self.closed, self.spread, **same)
        vars(other).update(arc=self.arc, whole=self.whole)
        return other

    def cut(self, piece: slice) -> Self:
        """An open curve's piece."""
        return replace(self, points=self.points[piece], bridged=self.bridged[piece])

    def at(self, arc: npt.ArrayLike) -> Array:
        """(N,D) points at (N,) arc positions; a closed curve wraps around."""
        at = np.asarray(arc, dtype=np.float64)
        if not self.closed:
            return self.kernels.interpolate(self.points, self.arc, at)
        return self.kernels.interpolate(self._polyline(self.points), self.arc, at % self.size)

    def even(self, count: int) -> Array:
        """(count,D) places of equal arc length around a closed curve, from its first point on."""
        known = vars(self).get("_even")
        if known is None or len(known) != count:
            known = vars(self)["_even"] = self.at(np.arange(count) * (self.size / count))
        return known

    def knowing(self, arc: Array, even: Array) -> Self:
        """This curve, told its ``arc`` and what it is asked for by ``even(len(even))``."""
        vars(self).update(arc=arc, _even=even)
        return self

    def bridged_at(self, arc: npt.ArrayLike) -> Mask:
        """(N,) whether the nearer of the two neighbouring points is bridged."""
        if self.whole:
            return np.zeros(np.shape(arc), bool)
        at = np.asarray(arc, dtype=np.float64)
        at = at % self.size if self.closed else at
        flags = np.append(self.bridged, self.bridged[0]) if self.closed else self.bridged
        after = np.clip(np.searchsorted(self.arc, at), 1, len(self.arc) - 1)
        nearer = np.where(at - self.arc[after - 1] < self.arc[after] - at, after - 1, after)
        return flags[nearer]

    def begun_at(self, arc: float) -> Curve:
        """The same closed curve with its first point at an arc position."""
        start, same = arc % self.size, 1e-9 * self.size
        after = int(np.searchsorted(self.arc, start + same))
        before = after - (start - self.arc[after - 1] <= same)  # the point that is there already
        if after > len(self.points):
            after, before = 1, 0
        points = np.concatenate([self.at([start]), self.points[after:], self.points[:before]])
        flags = np.concatenate([self.bridged_at([start]), self.bridged[after:], self.bridged[:before]])
        return replace(self, points=points, bridged=flags)

    def smoothed(self, values: Array, known: Mask) -> Array:
        """(P,) values at the points, the unknown ones in a straight line between the known, smoothed over nine."""
        at, count = np.arange(len(values)), len(values)
        filled = np.interp(at, at[known], values[known], period=count if self.closed else None)
        if count <= _SMOOTHING:
            return filled
        return straightened(filled, _SMOOTHING, self.closed)

    def measured(self, points: Array) -> Self:
        """The same curve with its points elsewhere: (P,D') for (P,D), say in metres for pixels."""
        return replace(self, points=points)

    def reversed(self) -> Curve:
        """The same curve run through backwards; closed, the first point stays the first."""
        if not self.closed:
            head, tail = self.memory.hidden
            memory = self.memory._replace(hidden=(tail, head))
            return replace(self, points=self.points[::-1], bridged=self.bridged[::-1], memory=memory)
        back = -np.arange(len(self.points))
        return replace(self, points=self.points[back], bridged=self.bridged[back])

    def _polyline(self, points: Array) -> Array:
        return np.concatenate([points, points[:1]]) if self.closed else points


@dataclass(frozen=True, eq=False)
class Patch(Form):
    """A lattice of points over a sheet, row by row; the border rows and columns lie on the sheet's border.

    Args:
        rows: How many rows, from the sheet's top to its bottom; the columns follow, from left to right.
        kink: Radians by which the outline that it was laid into turns at most, either way, away from its corners.
    """

    rows: int
    kink: float = 0.0

    @property
    def lattice(self) -> Array:
        """(rows, cols, D)."""
        return self.points.reshape(self.rows, -1, self.points.shape[1])

    @property
    def size(self) -> float:
        """Half the length around: the mean row plus the mean column."""
        return float(sum(gauge[-1] for gauge in self.gauges))

    @cached_property
    def gauges(self) -> tuple[Array, Array]:
        """How far down each row lies (rows,), and how far right each column (cols,): mean distances added up."""
        return self.kernels.gauges(self.lattice)

    @property
    def corners(self) -> Array:
        """(4,D) top left, top right, bottom right, bottom left."""
        return self.lattice[[0, 0, -1, -1], [0, -1, -1, 0]]

    @property
    def sides(self) -> tuple[Array, Array, Array, Array]:
        """The four border lines, (cols,D) or (rows,D), clockwise: each ends where the next begins."""
        lattice = self.lattice
        return lattice[0], lattice[:, -1], lattice[-1, ::-1], lattice[::-1, 0]

    def at(self, v: Array, u: Array) -> Array:
        """(R*C,D) points at every pair of (R,) places down and (C,) places to the right, row by row.

        Places are rows and columns of the lattice, fractions of them included; in between it is bilinear.
        """
        across = _between(u, self.lattice.shape[1]) @ self.lattice
        return np.tensordot(_between(v, self.rows), across, axes=1).reshape(len(v) * len(u), -1)

    def evenly(self, rows: int, cols: int, *, centers: bool) -> Array:
        """(rows*cols,D) points with equal gaps down and across, on the mean over the patch.

        Args:
            rows: How many.
            cols: How many.
            centers: They are the centres of equal pieces; else the outer ones lie on the border.
        """
        return self.kernels.sampled(self.lattice, *self.gauges, rows, cols, centers)

    def bridged_at(self, v: Array, u: Array) -> Mask:
        """(R*C,) whether most of what lies around such a place is bridged."""
        if not self.bridged.any():
            return np.zeros(len(v) * len(u), bool)
        flags = self.bridged.reshape(self.rows, -1).astype(np.float64)
        return (_between(v, self.rows) @ flags @ _between(u, flags.shape[1]).T).ravel() > 0.5

    def turned(self, quarters: int) -> Self:
        """The same patch with its first corner ``quarters`` corners further on, clockwise."""
        if quarters == 0:
            return self
        lattice, bridged = np.rot90(self.lattice, quarters), np.rot90(self.bridged.reshape(self.rows, -1), quarters)
        return replace(self, points=lattice.reshape(self.points.shape), bridged=bridged.ravel(), rows=lattice.shape[0])

    def smoothed(self, values: Array, known: Mask) -> Array:
        """(P,) values at the points, the unknown ones as the nearest known, smoothed over 3 x 3 by local planes."""
        lattice = values.reshape(self.rows, -1)
        if not known.all():
            missing = ~known.reshape(lattice.shape)
            nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
            lattice = lattice[tuple(np.asarray(nearest))]
        return straightened(straightened(lattice, 3).T, 3).T.ravel()

    def measured(self, points: Array) -> Self:
        """The same patch with its points elsewhere: (P,D') for (P,D), say in metres for pixels."""
        return replace(self, points=points)


def _between(at: Array, count: int) -> Array:
    """(N,count) weights that interpolate ``count`` values at (N,) fractions of an index."""
    return np.maximum(1 - np.abs(at[:, None] - np.arange(count)), 0.0)
