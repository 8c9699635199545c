"""Step: one frame of a rope in one compiled call, from what is seen to its state.

A rope is measured, registered, completed and judged. Every frame of it goes this way, the first one too, which starts
from an initial axis, with nothing known of the rope.
"""

from __future__ import annotations

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
from shape_obs.tracking.measure_chain import fit_chain_in_mask
from shape_obs.tracking.model import ChainConstants, Model  # noqa: F401 - the first in signatures
from shape_obs.tracking.register_chain import Ends, Expected, register_chain
from shape_obs.tracking.state import RopeState, State  # noqa: F401 - the first in a signature

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]
#: State ``(1,)``; nodes ``(K, D)`` and their log-depth; the whole curve: points ``(P, D)``, flags, arc length, metres,
#: pixels and log-depth, ``(P,)``, the last three ``(0,)`` where they are not known.
Stepped = tuple[State, Array, Array, Array, Flags, Array, Array, Array, Array]

_FEWEST: Final = 6  # nodes of a visible piece


@compiled(
    "(i8[:,::1], u1[:,::1], UniTuple(i8, 2), UniTuple(i8, 4), " + DEPTH_TYPE + ", f8[::1], f8[:,::1], f8[::1], f8, i8, "
    "i8, RopeState[::1], UniTuple(f8, 8), f8[:,::1], f8[::1], f8[:,::1], f8, b1, ChainConstants[::1])"
)
def step_chain_in_mask(
    runs: Indices, mask: Mask, at: tuple[int, int], edge: tuple[int, int, int, int], depth: DepthImages, lens: Array,
    axis: Array, sigmas: Array, pull: float, cell: int, area: int, known: State, expected: Expected, nodes: Array,
    log_depth: Array, before: Array, off: float, in_metres: bool, model: Model,
) -> Stepped:  # fmt: skip
    """Follow a rope into a mask.

    Args:
        runs: ``(R, 3)`` of the mask; at least one.
        mask: ``(h, w)`` uint8, C-contiguous.
        at: Image column and row of its first pixel.
        edge: Left, top, width and height of the part of the image that is searched, pixels.
        depth: The frame's, see ``frame.depth_images``; both empty without depth or a camera.
        lens: The projection, see ``Intrinsics.lens``; ``(0,)`` without one.
        axis: ``(K, 2)`` nodes of an initial axis; ``(0, 2)`` starts from where the rope is predicted.
        sigmas: Width of the map's neighbourhood in each epoch, node units.
        pull: How far averaging pulls the nodes, see ``topology.shrinkage``.
        cell: Edge of the squares in which pixels are gathered.
        area: Of the mask, pixels.
        known: ``(1,)`` what is known of the rope.
        expected: See ``Expected``.
        nodes: ``(K, 2)`` where the rope is predicted, as the middles of equal pieces; ``(0, 2)`` at a cold start.
        log_depth: ``(K,)`` of the nodes; ``(0,)`` if it is not known.
        before: ``(K, 2)`` where the nodes were.
        off: The share of the curve that may be bridged or hidden.
        in_metres: Whether the rope's points lie at equal steps in space.
        model: ``(1,)`` the constants.

    Returns:
        See ``Stepped``.
    """
    start, deep = axis, log_depth[:0]
    if len(axis) == 0:
        start, deep = visible_nodes(nodes, log_depth if len(lens) > 0 else deep, known)
    curve, arc, flags, metres, deep, spread, spurious, ends, shapes = fit_chain_in_mask(
        runs, mask, at, start, deep, sigmas, pull, cell, expected[0], depth, lens, edge, model[0]
    )
    spread += min(cell, expected[0]) ** 2 / 12
    return step_measured_chain(
        curve, arc, flags, metres, deep, ends, shapes, spread, 0.0, area, len(start), known, expected, nodes, log_depth,
        before, off, spurious, in_metres, model,
    )  # fmt: skip


@compiled(
    "(f8[:,::1], f8[::1], b1[::1], f8[::1], f8[::1], UniTuple(i8, 2), f8[:,::1], f8, f8, i8, i8, RopeState[::1], "
    "UniTuple(f8, 8), f8[:,::1], f8[::1], f8[:,::1], f8, f8, b1, ChainConstants[::1])"
)
def step_measured_chain(
    points: Array, arc: Array, flags: Flags, metres: Array, log_depth: Array, ends: Ends, shapes: Array, spread: float,
    width: float, area: int, count: int, known: State, expected: Expected, nodes: Array, node_log_depth: Array,
    before: Array, off: float, spurious: float, in_metres: bool, model: Model,
) -> Stepped:  # fmt: skip
    """Follow a rope to a curve that was fitted in this frame: register, complete and judge it.

    Args:
        points: ``(P, D)``.
        arc: ``(P,)`` arc length.
        flags: ``(P,)`` where it does not lie on what is seen.
        metres: ``(P,)`` arc length in space; ``(0,)`` if it is not known, or the points are in space.
        log_depth: ``(P,)`` see ``FittedCurve``; ``(0,)`` without.
        ends: What is known about both tips, see ``tip_evidence``.
        shapes: ``(2, 2)`` what they look like, see ``tip_shape``; ``(0, 2)`` if that is not known.
        spread: Mean square distance of what is seen from the curve.
        width: Of what is seen, in a cloud; 0 in a mask.
        area: Of the mask, pixels; 0 for a cloud.
        count: How many nodes a track begins with.
        known: As ``step_chain_in_mask`` takes it, and all that follow.
        expected: See ``Expected``.
        nodes: Predicted.
        node_log_depth: Theirs.
        before: Where they were.
        off: The share that may be bridged or hidden.
        spurious: The share that cannot be the rope, see ``fit_chain_in_mask``.
        in_metres: Whether points lie at equal steps in space.
        model: ``(1,)`` the constants.

    Returns:
        See ``Stepped``.
    """
    state, points, arc, flags, metres, log_depth = register_chain(
        points, arc, flags, metres, log_depth, ends, shapes, known, expected, nodes, node_log_depth, before,
        model[0],
    )  # fmt: skip
    was, now, pixels = known[0], state[0], arc[:0]
    if not now.plain:
        points, arc, flags, metres, pixels, log_depth = complete_chain(
            points, arc, flags, metres, log_depth, known, state, expected[7], expected[5], nodes, node_log_depth,
            model[0],
        )  # fmt: skip
    stations = metres if len(metres) > 0 else pixels if len(pixels) > 0 else arc
    _show(now, stations)
    found = even_points(points, stations, len(nodes) if len(nodes) > 0 else count, True)
    deep, now.steep = log_depth, 1.0
    if len(log_depth) > 0:
        deep = even_points(log_depth.reshape(-1, 1), stations, len(found), True).reshape(len(found))
        now.steep = arc_length(with_log_depth(points, log_depth))[-1] / max(arc[-1], 1e-9)
    cold = len(nodes) == 0
    begins = cold or (expected[2] > 0 and max(now.hidden[0], now.hidden[1]) <= now.tolerance)
    judge_chain(
        was, now, points, arc, flags, metres, log_depth, spread, width, expected[0], float(area), off, spurious, begins,
        in_metres and not cold, model[0],
    )  # fmt: skip
    return state, found, deep, points, flags, arc, metres, pixels, log_depth


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
