"""A rope's points: spread evenly along its curve, in the image or in space."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import local_stretch, nearest_along, with_log_depth
from shape_obs.geometry.polyline import MAX_SHIFT, equal_chords, interpolate

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

_NEAR: Final = 0.04  # of its length: so near to a piece that is seen end-on points are off


@compiled("(f8[:,::1], f8[::1], f8[:,::1], f8[::1], f8[::1], f8[::1], f8[::1], b1[::1], i8, i8, i8, b1, b1, f8)")
def points_along(
    points: Array, arc: Array, metric: Array, metric_arc: Array, metres: Array, pixels: Array, log_depth: Array,
    flags: Flags, first: int, past: int, count: int, tips: bool, in_metres: bool, reach: float,
) -> tuple[Array, Flags, Indices, Array, Array]:  # fmt: skip
    """Spread points along a curve: with equal steps of a measure along it, else with equal chords.

    Args:
        points: ``(P, D)``.
        arc: ``(P,)`` its arc length.
        metric: ``(P, D')`` the same curve in the space in which chords are to be equal.
        metric_arc: ``(P,)`` arc length there.
        metres: ``(P,)`` arc length in metres; ``(0,)`` if it is not known.
        pixels: ``(P,)`` arc length in the image of a curve with hidden pieces; ``(0,)`` for equal chords.
        log_depth: ``(P,)`` see ``FittedCurve.log_depth``, or ``(0,)``.
        flags: ``(P,)`` what is interpolated.
        first: The first point of the piece over which they are spread.
        past: The one past the last.
        count: How many points, N.
        tips: Whether the first and the last lie at the ends; else all lie at the centres of N equal pieces.
        in_metres: Whether the steps are equal in metres, if these are known.
        reach: To either side of a place, within which it is measured how steep the curve is, in units of ``arc``.

    Returns:
        ``(N, D)`` the points; ``(N,)`` whether they are interpolated; ``(N,)`` which of the curve's points is nearest
        along it; ``(N,)`` their log-depth; ``(N,)`` how much longer the curve is near there in space than in the
        image; both ``(0,)`` if the log-depth is not known.
    """
    if past - first < len(arc):
        points, metric, flags, arc = points[first:past], metric[first:past], flags[first:past], _from(arc, first, past)
        metric_arc, metres = _from(metric_arc, first, past), _from(metres, first, past)
        pixels = _from(pixels, first, past)
        log_depth = log_depth[first:past] if len(log_depth) > 0 else log_depth
    last, at, along = len(arc) - 1, np.empty(count), metres if in_metres and len(metres) > 0 else pixels
    if len(along) > 0:
        for n in range(count):
            at[n] = (n / (count - 1) if tips else (n + 0.5) / count) * along[last]
        at = interpolate(arc.reshape(-1, 1), along, at).reshape(count)
        places, nearest = interpolate(points, arc, at), nearest_along(arc, at)
    else:
        margin = 0.0 if tips else metric_arc[last] / (2 * count)
        places, at = equal_chords(points, arc, metric, metric_arc, count, margin, MAX_SHIFT)
        nearest = nearest_along(metric_arc, at)
        at = interpolate(arc.reshape(-1, 1), metric_arc, at).reshape(count)
    interpolated, deep, steep = np.empty(count, np.bool_), log_depth[:0], np.ones(count if len(log_depth) > 0 else 0)
    for n in range(count):
        interpolated[n] = flags[nearest[n]]
    if len(log_depth) > 0:
        deep = interpolate(log_depth.reshape(-1, 1), arc, at).reshape(count)
        stretched, along = (
            local_stretch(arc, with_log_depth(points, log_depth), reach),
            metres if len(metres) > 0 else arc,
        )
        for n in range(count):
            for p in range(last + 1):
                if abs(along[p] - along[nearest[n]]) <= _NEAR * along[last]:
                    steep[n] = max(steep[n], stretched[p])
    for n in range(count):
        nearest[n] += first
    return places, interpolated, nearest, deep, steep


@compiled
def _from(along: Array, first: int, past: int) -> Array:
    """Return a piece of a measure along a curve, which begins with 0; ``(0,)`` where the measure is not known."""
    return along[first:past] - along[first] if len(along) > 0 else along
