"""A rope in a mask: fitted and matched to what is known of it in one compiled call; points and nodes along it."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.configurations.chain_in_mask import Drawn, fit_chain_in_mask
from shape_obs.frame import DEPTH_TYPE, DepthImages
from shape_obs.geometry.curve import local_stretch, nearest_along, with_relief
from shape_obs.geometry.polyline import MAX_SHIFT, arc_length, equal_chords, even_points, interpolate
from shape_obs.tracking.rope_match import Expected, match_to_rope
from shape_obs.tracking.state import RopeState, State  # noqa: F401 - the first in a signature

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]

_NEAR: Final = 0.04  # of its length: so near to a piece that is seen end-on points are off


@compiled(
    "(i8[:,::1], f8[:,::1], f8[::1], f8[::1], f8, i8, UniTuple(i8, 4), RopeState[::1], UniTuple(f8, 5), f8[:,::1], "
    "f8[::1], u1[:,::1], UniTuple(i8, 2), " + DEPTH_TYPE + ", f8[::1])"
)
def follow_chain_in_mask(
    runs: Indices, start: Array, relief: Array, sigmas: Array, pull: float, cell: int,
    edge: tuple[int, int, int, int], known: State, expected: Expected, nodes: Array, node_relief: Array,
    mask: Mask, at: tuple[int, int], depth: DepthImages, lens: Array,
) -> tuple[Drawn, tuple[State, Array]]:  # fmt: skip
    """Fit the curve of a rope in a mask, and find out which piece of the rope it is.

    Returns:
        What ``fit_chain_in_mask`` and ``match_to_rope`` return, where the arguments are described too.
    """
    drawn = fit_chain_in_mask(runs, mask, at, start, relief, sigmas, pull, cell, expected[0], depth, lens, edge)
    curve, arc, off, metres, deep, _, ends, shapes = drawn
    match = match_to_rope(curve, arc, off, metres, deep, ends, shapes, known, expected, nodes, node_relief, False)
    return drawn, match


@compiled("(f8[:,::1], f8[::1], f8[:,::1], f8[::1], f8[::1], f8[::1], f8[::1], b1[::1], i8, b1, b1, f8)")
def points_along(
    points: Array, arc: Array, metric: Array, metric_arc: Array, metres: Array, pixels: Array, relief: Array,
    flags: Flags, count: int, tips: bool, in_metres: bool, reach: float,
) -> tuple[Array, Flags, Indices, Array, Array]:  # fmt: skip
    """Spread points along a curve: with equal steps of a measure along it, else with equal chords.

    Args:
        points: ``(P, D)``.
        arc: ``(P,)`` its arc length.
        metric: ``(P, D')`` the same curve in the space in which chords are to be equal.
        metric_arc: ``(P,)`` arc length there.
        metres: ``(P,)`` arc length in metres; ``(0,)`` if it is not known.
        pixels: ``(P,)`` arc length in the image of a curve with hidden pieces; ``(0,)`` for equal chords.
        relief: ``(P,)`` see ``FittedCurve.relief``, or ``(0,)``.
        flags: ``(P,)`` what is interpolated.
        count: How many points, N.
        tips: Whether the first and the last lie at the ends; else all lie at the centres of N equal pieces.
        in_metres: Whether the steps are equal in metres, if these are known.
        reach: To either side of a place, within which it is measured how steep the curve is, in units of ``arc``.

    Returns:
        ``(N, D)`` the points; ``(N,)`` whether they are interpolated; ``(N,)`` which of the curve's points is nearest
        along it; ``(N,)`` their relief; ``(N,)`` how much longer the curve is near there in space than in the image.
    """
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
    interpolated, deep, steep = np.empty(count, np.bool_), np.empty(count), np.ones(count)
    for n in range(count):
        interpolated[n] = flags[nearest[n]]
    if len(relief) > 0:
        deep = interpolate(relief.reshape(-1, 1), arc, at).reshape(count)
        stretched, along = local_stretch(arc, with_relief(points, relief), reach), metres if len(metres) > 0 else arc
        for n in range(count):
            for p in range(last + 1):
                if abs(along[p] - along[nearest[n]]) <= _NEAR * along[last]:
                    steep[n] = max(steep[n], stretched[p])
    return places, interpolated, nearest, deep, steep


@compiled("(f8[:,::1], f8[::1], f8[::1], f8[::1], f8[::1], i8)")
def nodes_along(
    points: Array, arc: Array, metres: Array, pixels: Array, relief: Array, count: int
) -> tuple[Array, Array, float]:
    """Return the middles of equal pieces of a curve, their relief, and how long it is in space over the image.

    Args:
        points: ``(P, D)``.
        arc: ``(P,)`` its arc length.
        metres: ``(P,)`` the measure in which the pieces are equal, if it is known, else ``(0,)``.
        pixels: ``(P,)`` the measure otherwise; ``(0,)`` for ``arc``.
        relief: ``(P,)`` see ``FittedCurve.relief``; ``(0,)`` without, then its nodes' is empty and the ratio 1.
        count: How many pieces.
    """
    along = metres if len(metres) > 0 else pixels if len(pixels) > 0 else arc
    nodes = even_points(points, along, count, True)
    if len(relief) == 0:
        return nodes, relief, 1.0
    longer = arc_length(with_relief(points, relief))[-1]
    deep = even_points(relief.reshape(-1, 1), along, count, True).reshape(count)
    return nodes, deep, longer / max(arc[-1], 1e-9)
