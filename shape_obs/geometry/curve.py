"""Fitted forms: ordered points laid over an observed object. A curve here; ``lattice`` holds the form of a sheet."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.polyline import arc_length, interpolate, starting_at, straightened

if TYPE_CHECKING:
    from typing_extensions import Self

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_SMOOTHING: Final = 9  # points of a fine curve
#: Values along a curve that are not known.
NO_VALUES: Final = np.zeros(0)  # of any unit


@dataclass(frozen=True, eq=False)
class FittedForm(ABC):
    """Ordered points of a curve or a surface.

    Args:
        points: ``(P, D)`` pixels (D = 2) or metres (D = 3).
        interpolated: ``(P,)`` bool: nothing of the object was seen there (a gap, or an end that is hidden).
        ambiguity: Why an initial form may be wrong; empty if it is not in doubt.
    """

    points: Array
    interpolated: Mask
    ambiguity: str = field(default="", kw_only=True)

    @property
    @abstractmethod
    def size(self) -> float:
        """The object's own size, which must not jump from frame to frame, in the unit of ``points``."""

    @property
    def whole(self) -> bool:
        """Whether no point is interpolated."""
        return np.count_nonzero(self.interpolated) == 0  # five times as fast as ``any``

    @abstractmethod
    def smoothed(self, values: Array, known: Mask) -> Array:
        """Fill ``(P,)`` values at the points where they are unknown, and smooth them over a few points."""

    @abstractmethod
    def with_points(self, points: Array) -> Self:
        """Return the same form with its points elsewhere, for example in metres instead of pixels."""


@dataclass(frozen=True, eq=False)
class FittedCurve(FittedForm):
    """A polyline; if closed, the last point is followed by the first, which is not repeated.

    Args:
        arc: ``(P,)`` arc length of the points; ``(P + 1,)`` if closed, the last entry the whole.
        closed: Whether it is closed.
        metres: ``(P,)`` arc length in space, for an open curve in pixels with depth under it; else ``(0,)``.
        pixels: ``(P,)`` arc length of the object in an image where its gaps are longer than they are drawn; else
            ``(0,)``.
        log_depth: ``(P,)`` the logarithm of the depth under an open curve in an image, times the focal length in
            pixels: a third coordinate, in which a step is as long as the same step in the image, at any distance; else
            ``(0,)``.
        width: Of the object, in the unit of ``points``; 0 if it is not known.
        space: ``(P, 3)`` where the points of a closed curve in an image lie in space, metres; None if it is not known.
        shown: The first point of an open curve over which a shape's are spread, and the one past the last; None for all
            of it.
    """

    arc: Array
    closed: bool = False
    metres: Array = field(default_factory=lambda: NO_VALUES)
    pixels: Array = field(default_factory=lambda: NO_VALUES)
    log_depth: Array = field(default_factory=lambda: NO_VALUES)
    width: float = 0.0
    space: Array | None = None
    shown: tuple[int, int] | None = None

    @classmethod
    def through(cls, points: Array, interpolated: Mask, closed: bool = False, **other: Any) -> Self:
        """Build a curve through ``(P, D)`` points and measure its arc length."""
        return cls(points, interpolated, arc_length(_polyline(points, closed)), closed, **other)

    @property
    def size(self) -> float:
        """Arc length from end to end, or once around."""
        return float(self.arc[-1])

    @property
    def unsupported_fraction(self) -> float:
        """The share of the length that is interpolated."""
        if self.whole:
            return 0.0
        step = np.diff(self.arc)
        flags = np.append(self.interpolated, self.interpolated[0]) if self.closed else self.interpolated
        return float(step @ (flags[:-1] / 2 + flags[1:] / 2) / max(self.size, 1e-9))

    def at(self, arc: npt.ArrayLike) -> Array:
        """Return ``(N, D)`` points at ``(N,)`` arc positions; a closed curve wraps around."""
        at = np.ascontiguousarray(arc, dtype=np.float64)
        return interpolate(_polyline(self.points, self.closed), self.arc, at % self.size if self.closed else at)

    def even(self, count: int) -> Array:
        """Return ``(count, D)`` places of equal arc length around a closed curve, from its first point on."""
        return self.at(np.arange(count) * (self.size / count))

    def starting_at(self, arc: float) -> FittedCurve:
        """Return the same closed curve, of which all was seen, with its first point at an arc position."""
        points = starting_at(self.points, self.arc, arc)
        begun = self.with_geometry(points, np.zeros(len(points), bool))
        return begun if self.space is None else replace(begun, space=starting_at(self.space, self.arc, arc))

    def smoothed(self, values: Array, known: Mask) -> Array:
        """Fill ``(P,)`` values by a straight line between the known ones, and smooth them over nine points."""
        at, count = np.arange(len(values)), len(values)
        filled = np.interp(at, at[known], values[known], period=count if self.closed else None)
        if count <= _SMOOTHING:
            return filled
        return straightened(filled, _SMOOTHING, self.closed)

    def with_points(self, points: Array) -> Self:
        """Return the same curve with its points elsewhere: ``(P, D')`` for ``(P, D)``."""
        return self.with_geometry(points, self.interpolated)

    def reversed(self) -> FittedCurve:
        """Return the same curve run through backwards; if closed, the first point stays the first."""
        if not self.closed:
            metres, pixels = (along[-1:] - along[::-1] for along in (self.metres, self.pixels))
            back = self.with_geometry(self.points[::-1].copy(), self.interpolated[::-1].copy())
            count, shown = len(self.points), self.shown
            shown = None if shown is None else (count - shown[1], count - shown[0])
            return replace(back, metres=metres, pixels=pixels, log_depth=self.log_depth[::-1].copy(), shown=shown)
        back = -np.arange(len(self.points))
        return self.with_geometry(self.points[back], self.interpolated[back])

    def with_geometry(self, points: Array, interpolated: Mask) -> Self:
        """Return a curve of the same kind through other points."""
        form = {"points": points, "interpolated": interpolated, "arc": arc_length(_polyline(points, self.closed))}
        return replace(self, **form, metres=NO_VALUES, pixels=NO_VALUES, log_depth=NO_VALUES, space=None)


def _polyline(points: Array, closed: bool) -> Array:
    return np.ascontiguousarray(np.concatenate([points, points[:1]]) if closed else points, dtype=np.float64)


@compiled
def with_log_depth(points: Array, log_depth: Array) -> Array:
    """Return ``(P, 3)`` points of an image with their log_depth."""
    out = np.empty((len(points), 3))
    for p in range(len(points)):
        out[p, 0], out[p, 1], out[p, 2] = points[p, 0], points[p, 1], log_depth[p]
    return out


@compiled
def first_coordinates(points: Array, size: int) -> Array:
    """Return the first coordinates of points."""
    if points.shape[1] == size:
        return points
    out = np.empty((len(points), size))
    for p in range(len(points)):
        for d in range(size):
            out[p, d] = points[p, d]
    return out


@compiled("(f8[::1], f8[:,::1], f8)")
def local_stretch(arc: Array, lifted: Array, reach: float) -> Array:
    """Return ``(P,)`` how much longer a curve is in space than in the image, within ``reach`` of each point."""
    first, last, out = np.empty(len(arc)), np.empty(len(arc)), np.empty(len(arc))
    for p in range(len(arc)):
        first[p], last[p] = max(arc[p] - reach, 0.0), min(arc[p] + reach, arc[-1])
    inside = arc_length(lifted).reshape(-1, 1)
    until, since = interpolate(inside, arc, last), interpolate(inside, arc, first)
    for p in range(len(arc)):
        out[p] = (until[p, 0] - since[p, 0]) / max(last[p] - first[p], 1e-9)
    return out


@compiled("(f8[::1], f8[::1])")
def nearest_along(arc: Array, at: Array) -> npt.NDArray[np.intp]:
    """Return which of ``(P,)`` arc positions is nearest to each of ``(N,)`` others."""
    out = np.empty(len(at), np.intp)
    for n in range(len(at)):
        after = min(max(np.searchsorted(arc, at[n]), 1), len(arc) - 1)
        out[n] = after - 1 if at[n] - arc[after - 1] < arc[after] - at[n] else after
    return out
