"""Step: one frame of a rope in one compiled call, from what is seen to its state.

A rope is measured, registered, completed and judged. Every frame of it goes this way, the first one too, which starts
from an initial axis, with nothing known of the rope.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.frame import DEPTH_TYPE, DepthImages
from shape_obs.geometry.curve import first_coordinates, with_log_depth
from shape_obs.geometry.polyline import arc_length, even_points, interpolate
from shape_obs.geometry.topology import from_tip_to_tip
from shape_obs.tracking.complete_chain import complete_chain
from shape_obs.tracking.judge_chain import judge_chain
from shape_obs.tracking.measure_chain import Measured, fit_chain_in_mask
from shape_obs.tracking.model import ChainConstants, Model  # noqa: F401 - the first in signatures
from shape_obs.tracking.occluders import UNKNOWN
from shape_obs.tracking.predict import NO_BOX, Box, advance, counted, predict
from shape_obs.tracking.register_chain import Expected, register_chain
from shape_obs.tracking.state import RopeState, State  # noqa: F401 - the first in a signature

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]
#: A track after a frame, see ``Track``: state, nodes, velocity, log-depth and how fast it changes. And the whole curve:
#: points ``(P, D)``, flags, arc length, metres, pixels and log-depth, ``(P,)``, the last three ``(0,)`` where they are
#: not known.
Stepped = tuple[State, Array, Array, Array, Array, Array, Flags, Array, Array, Array, Array]
#: A track before a frame, the same of it, and the time now, seconds; whether it was lost for long; how far its nodes
#: can have moved.
Before = tuple[State, Array, Array, Array, Array, float, bool, float]
#: Where a rope is predicted: nodes ``(K, D)``, their log-depth, and what else is expected of it.
Predicted = tuple[Array, Array, Expected]

# The types of ``Before``.
_BEFORE: Final = "Tuple((RopeState[::1], f8[:,::1], f8[:,::1], f8[::1], f8[::1], f8, b1, f8))"
_FEWEST: Final = 6  # nodes of a visible piece
_MAX_CELL: Final = 24  # pixels: the edge of a cell of a very wide rope
_MAX_CELLS: Final = 4096  # about; more change nothing and cost time


@compiled(
    "(i8[:,::1], u1[:,::1], UniTuple(i8, 4), UniTuple(i8, 4), UniTuple(i8, 4), i8, " + DEPTH_TYPE + ", f8[::1], "
    "f8[:,::1], f8, f8, b1, " + _BEFORE + ", ChainConstants[::1])"
)
def step_chain_in_mask(
    runs: Indices, mask: Mask, window: Box, box: Box, edge: Box, area: int, depth: DepthImages, lens: Array,
    axis: Array, width: float, off: float, in_metres: bool, before: Before, model: Model,
) -> Stepped:  # fmt: skip
    """Follow a rope into a mask.

    Args:
        runs: ``(R, 3)`` of the mask; at least one.
        mask: ``(h, w)`` uint8, C-contiguous.
        window: Left, top, width and height of the mask in the image, pixels.
        box: The same of what is in it.
        edge: The same of the part of the image that is searched.
        area: Of the mask, pixels.
        depth: The frame's, see ``frame.depth_images``; both empty without depth or a camera.
        lens: The projection, see ``Intrinsics.lens``; ``(0,)`` without one.
        axis: ``(K, 2)`` nodes of an initial axis; ``(0, 2)`` starts from where the rope is predicted.
        width: Of the rope, pixels.
        off: The share of the curve that may be bridged or hidden.
        in_metres: Whether the rope's points lie at equal steps in space.
        before: The track; without nodes at a cold start.
        model: ``(1,)`` the constants.

    Returns:
        See ``Stepped``.
    """
    predicted = _predict(before, width, 1.0, model[0])
    start, deep, sigmas = axis, lens[:0], _as_array(model[0].sigmas_initial)
    if len(axis) == 0:
        start, deep = visible_nodes(predicted[0], predicted[1] if len(lens) > 0 else deep, before[0])
        # What comes to light, or under a hand, changes the area first.
        steady = abs(area - before[0][0].area) <= model[0].steady * before[0][0].area
        sigmas = _as_array(model[0].sigmas_steady) if steady else _as_array(model[0].sigmas_changed)
    cell = max(int(min(width / 3, _MAX_CELL)), int(math.sqrt(area // _MAX_CELLS)), 1)  # thin ropes keep it
    measured = fit_chain_in_mask(runs, mask, window[:2], start, deep, sigmas, cell, width, depth, lens, edge, model[0])
    return _step_measured(measured, 0.0, area, box, len(start), before, predicted, off, in_metres, model)


@compiled("(f8[:,::1], b1[::1], f8, f8, f8, i8, i8, f8, b1, " + _BEFORE + ", ChainConstants[::1])")
def step_chain_in_cloud(
    points: Array, flags: Flags, spread: float, width: float, resolution: float, area: int, count: int, off: float,
    in_metres: bool, before: Before, model: Model,
) -> Stepped:  # fmt: skip
    """Follow a rope to a curve that was fitted to a cloud.

    Args:
        points: ``(P, 3)``.
        flags: ``(P,)`` where it does not lie on what is seen.
        spread: Mean square distance of what is seen from the curve.
        width: Of what is seen.
        resolution: Of the cloud.
        area: How many points it has.
        count: How many nodes a track begins with.
        off: As ``step_chain_in_mask`` takes it, and all that follow.
        in_metres: Whether points lie at equal steps in space.
        before: The track.
        model: ``(1,)`` the constants.

    Returns:
        See ``Stepped``.
    """
    predicted, nothing = _predict(before, 0.0, resolution, model[0]), np.zeros(0)
    unknown = (UNKNOWN, UNKNOWN), np.empty((0, 2))
    measured = points, arc_length(points), flags, nothing, nothing, spread, 0.0, *unknown
    return _step_measured(measured, width, area, NO_BOX, count, before, predicted, off, in_metres, model)


@compiled
def _as_array(values: Any) -> Array:
    """Return several values of a constant as an array."""
    out = np.empty(len(values))
    for k in range(len(values)):
        out[k] = values[k]
    return out


@compiled
def _predict(before: Before, width: float, resolution: float, model: Any) -> Predicted:
    """Predict a rope of a width in the image."""
    known, nodes, velocity, log_depth, depth_rate, now, stale, reach = before
    ahead, deep, motion = predict(known[0], nodes, velocity, log_depth, depth_rate, now, model)
    if len(nodes) == 0:
        return ahead, deep, (width, resolution, 0.0, 0.0, np.inf, 0.0, np.inf)
    seconds = now - known[0].stamp
    lost = 1.0 if stale else 0.0
    return ahead, deep, (width, resolution, lost, motion, seconds, counted(seconds, model), reach)


@compiled
def _step_measured(
    measured: Measured, width: float, area: int, box: Box, count: int, before: Before,
    predicted: Predicted, off: float, in_metres: bool, model: Model,
) -> Stepped:  # fmt: skip
    """Register, complete and judge a rope that was measured in this frame, and advance its track.

    Args:
        measured: See there.
        width: Of what is seen, in a cloud; 0 in a mask.
        area: Of what is seen, pixels or points.
        box: Around the mask; ``NO_BOX`` in a cloud.
        count: How many nodes a track begins with.
        before: The track.
        predicted: See there.
        off: As ``step_chain_in_mask`` takes it, and all that follow.
        in_metres: Whether points lie at equal steps in space.
        model: ``(1,)`` the constants.
    """
    points, arc, flags, metres, log_depth, spread, spurious, ends, shapes = measured
    nodes, node_log_depth, expected = predicted
    known, last, _, deep_before, _, stamp, stale, _ = before
    state, points, arc, flags, metres, log_depth = register_chain(
        points, arc, flags, metres, log_depth, ends, shapes, known, expected, nodes, node_log_depth, last, model[0]
    )
    was, now, pixels, cold = known[0], state[0], arc[:0], len(nodes) == 0
    if not now.plain:
        points, arc, flags, metres, pixels, log_depth = complete_chain(
            points, arc, flags, metres, log_depth, known, state, expected[0] if cold else was.width, expected[5],
            nodes, node_log_depth, model[0],
        )  # fmt: skip
    stations = metres if len(metres) > 0 else pixels if len(pixels) > 0 else arc
    _show(now, stations)
    found = even_points(points, stations, count if cold else len(nodes), True)
    deep, now.steep = log_depth, 1.0
    if len(log_depth) > 0:
        deep = even_points(log_depth.reshape(-1, 1), stations, len(found), True).reshape(len(found))
        now.steep = arc_length(with_log_depth(points, log_depth))[-1] / max(arc[-1], 1e-9)
    begins = cold or (stale and max(now.hidden[0], now.hidden[1]) <= now.tolerance)
    judge_chain(
        was, now, points, arc, flags, metres, log_depth, spread, width, expected[0],
        float(area) if box[2] > 0 else 0.0, off, spurious, begins, in_metres and not cold, model[0],
    )  # fmt: skip
    velocity, depth_rate = advance(
        was, now, found, last, deep, deep_before, stamp, arc[-1], now.seen_width, box, 0 if flags.any() else area, 1.0,
        model[0],
    )  # fmt: skip
    return state, found, velocity, deep, depth_rate, points, flags, arc, metres, pixels, log_depth


@compiled("(f8[:,::1], f8[::1], RopeState[::1])")
def visible_nodes(nodes: Array, log_depth: Array, known: State) -> tuple[Array, Array]:
    """Return the predicted nodes ``(K, D)`` of the visible piece of a rope, about as far apart, and their log-depth."""
    if not known[0].hides:
        return nodes, log_depth
    rope, share = from_tip_to_tip(with_log_depth(nodes, log_depth) if len(log_depth) > 0 else nodes)
    head, tail, size = known[0].hidden[0], known[0].hidden[1], nodes.shape[1]
    count = max(int(np.rint(len(nodes) * (1 - head - tail))), _FEWEST)
    at = np.empty(count)
    for k in range(count):
        at[k] = head + (k + 0.5) / count * (1 - tail - head)
    found = interpolate(rope, share, at)
    if len(log_depth) == 0:
        return found, log_depth
    deep = np.empty(count)
    for k in range(count):
        deep[k] = found[k, size]
    return first_coordinates(found, size), deep


@compiled
def _show(now: Any, stations: Array) -> None:
    """Note the piece of a curve over which points are spread: without what may be hidden by noise alone.

    Of an end that something hides, two thirds of what may be noise elsewhere.

    Args:
        now: What is known of the rope.
        stations: ``(P,)`` how far along it the points of its curve lie.
    """
    now.shown[0], now.shown[1] = 0, len(stations)
    if not now.hides:
        return
    for end in range(2):
        hidden, least = now.hidden[end], now.tolerance * (2 / 3 if now.occluded[end] else 1)
        if hidden < least:
            at = 1 - hidden + 1e-9 if end else hidden - 1e-9
            now.shown[end] = np.searchsorted(stations, at * stations[-1])
