"""Step: one frame of an outline in one compiled call, from what is seen to its curve and nodes.

An outline is measured, registered and completed. Every frame of it goes this way, the first one too, which begins where
the paper's rule puts its first point.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from shape_obs.camera import deprojected, projected
from shape_obs.compiled import compiled
from shape_obs.frame import DEPTH_TYPE, DepthImages
from shape_obs.geometry.outline import SAMPLED, material_outline
from shape_obs.geometry.polyline import arc_length, closed, nearest_vertex, starting_at
from shape_obs.tracking.complete_lattice import outline_depth
from shape_obs.tracking.complete_ring import complete_outline, hidden_pieces, sticks_out
from shape_obs.tracking.measure_ring import MIN_SAMPLES, fit_ring_in_mask, nodes_around, trace_border
from shape_obs.tracking.model import Model, RingConstants  # noqa: F401 - the last in signatures
from shape_obs.tracking.predict import BEFORE_TYPE, NO_BOX, Before, Box, advance, counted, predict
from shape_obs.tracking.register_ring import begin_outline, first_place, register_ring
from shape_obs.tracking.state import ShapeState, State  # noqa: F401 - the first in signatures

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]
#: A curve ``(P, D)``, clockwise as seen; the same in metres ``(P, 3)``, ``(0, 3)`` if that is not known, or the points
#: are in space; ``(P,)`` where it is not the object's own; how far the outline misses it, in distances of its samples.
Fitted = tuple[Array, Array, Flags, float]
#: A curve ``(P, D)``; the same in metres ``(P, 3)``, ``(0, 3)`` where its form is that of the points; its arc length
#: ``(P + 1,)``; nodes ``(K, D)``; what is known of it now, ``(K, D')``, ``(0, 2)`` if nothing is; how far its
#: turning can be believed, 0...1; whether too little of it is seen.
Followed = tuple[Array, Array, Array, Array, Array, float, bool]
#: A track after a frame: state, nodes, velocity and reference; the curve of ``Followed``, its metres and arc length;
#: whether too little of it is seen; how far the outline misses the fitted curve.
Stepped = tuple[State, Array, Array, Array, Array, Array, Array, bool, float]
#: What was followed; why there is nothing, or ``FOUND``; how many samples the outline has; the width of the largest
#: component, pixels.
RingStep = tuple[Stepped, int, int, float]

FOUND, NO_HOLE, NOT_HOLLOW, TOO_SMALL, TOO_THIN = range(5)  # why there is no outline, if there is none


@compiled(
    "(u1[:,::1], i8[:,::1], i8, i8, i8, " + DEPTH_TYPE + ", UniTuple(i8, 4), f8[::1], UniTuple(i8, 4), i8, i8, b1, "
    "f8[::1], " + BEFORE_TYPE + ", RingConstants[::1])"
)
def step_ring_in_mask(
    mask: Mask, runs: Indices, pieces: int, left: int, top: int, depth: DepthImages, edge: Box, lens: Array, box: Box,
    area: int, hole: int, band: bool, target: Array, before: Before, model: Model,
) -> RingStep:  # fmt: skip
    """Follow an outline into a mask, or find it there.

    Args:
        mask: As ``trace_components`` takes it, and the next four.
        runs: Of the mask.
        pieces: How many components there are.
        left: Image column.
        top: Image row.
        depth: As ``outline_depth`` takes it, and the next.
        edge: Of what is searched.
        lens: The projection, see ``Intrinsics.lens``; ``(0,)`` without one.
        box: Around what is in the mask.
        area: Of the mask, pixels.
        hole: Which hole of the largest component, the largest first; -1 for its outer outline.
        band: Whether the object is a closed band, which encloses a hole.
        target: ``(2,)`` pixel where the first point belongs in a first frame; ``(0,)`` for the top left.
        before: The track; without nodes in a first frame.
        model: ``(1,)`` the constants.

    Returns:
        See ``RingStep``.
    """
    traced, width, hollow = trace_border(mask, runs, pieces, left, top, hole)
    samples, space, cold, constants = -(-len(traced) // SAMPLED), np.empty((0, 3)), len(before[1]) == 0, model[0]
    why = NO_HOLE if hole >= 0 and samples == 0 else TOO_SMALL if samples < MIN_SAMPLES else FOUND
    if band and why != NO_HOLE and hollow < constants.min_hollow:
        why = NOT_HOLLOW
    elif why == FOUND and hole < 0 and width < constants.min_width * SAMPLED:
        why = TOO_THIN
    if why != FOUND:
        state, nodes, velocity, known, _ = before
        return (state, nodes, velocity, known, traced, space, np.zeros(1), True, np.inf), why, samples, width
    points, smooth = material_outline(traced, hole >= 0)
    nodes = _predicted(before, constants)
    count, start = len(nodes), smooth[0]
    if cold:
        spacing, most = constants.node_spacing * SAMPLED, constants.max_spacing * width
        count = nodes_around(arc_length(closed(smooth))[-1], spacing if hole >= 0 else min(spacing, most))
    else:
        start = nodes[0]
    curve, miss = fit_ring_in_mask(points, smooth, start, count, constants.sigma)
    if cold:
        arc = arc_length(closed(curve))
        curve = starting_at(curve, arc, first_place(curve, arc, target))
    cut = np.zeros(len(curve), np.bool_)
    if hole < 0:
        z, cut = outline_depth(depth, edge, mask, left, top, curve, width, constants)
        space = deprojected(curve, z, lens)
    fitted = curve, space, cut, miss
    found = _step_fitted(fitted, nodes, count, 1.0, width, lens, box, area, before, model)
    return found, FOUND, samples, width


@compiled("(f8[:,::1], i8, f8, f8, i8, " + BEFORE_TYPE + ", RingConstants[::1])")
def step_ring_in_cloud(
    points: Array, count: int, miss: float, resolution: float, area: int, before: Before, model: Model
) -> Stepped:
    """Follow an outline to a curve that was fitted to a cloud.

    Args:
        points: ``(P, 3)``, clockwise as seen; in a first frame they begin where its numbering does.
        count: How many nodes a track begins with.
        miss: How far the outline misses the curve, in distances of its samples.
        resolution: Of the cloud.
        area: How many points it has.
        before: The track.
        model: ``(1,)`` the constants.

    Returns:
        See ``Stepped``.
    """
    fitted, nodes = (points, np.empty((0, 3)), np.zeros(len(points), np.bool_), miss), _predicted(before, model[0])
    return _step_fitted(fitted, nodes, count, resolution, 0.0, np.zeros(0), NO_BOX, area, before, model)


@compiled
def _predicted(before: Before, model: Any) -> Array:
    """Return where the nodes are predicted."""
    known, nodes, velocity, _, now = before
    return predict(known[0], nodes, velocity, np.zeros(0), np.zeros(0), now, model)[0]


@compiled
def _step_fitted(
    fitted: Fitted, nodes: Array, count: int, resolution: float, width: float, lens: Array, box: Box, area: int,
    before: Before, model: Model,
) -> Stepped:  # fmt: skip
    """Follow an outline to a curve that was fitted in this frame, and advance its track.

    Args:
        fitted: See there.
        nodes: ``(K, D)`` predicted.
        count: How many nodes a track begins with.
        resolution: Of the points.
        width: Of the object, pixels; 0 in a cloud.
        lens: As ``step_ring_in_mask`` takes it, and all that follow.
        box: ``NO_BOX`` in a cloud.
        area: Of the mask or cloud.
        before: The track.
        model: ``(1,)`` the constants.
    """
    points, space, cut, miss = fitted
    known, last, _, reference, stamp = before
    state, constants, usual = known.copy(), model[0], model[0].velocity_share
    if len(nodes) == 0:
        turned, there, arc, found, places = begin_outline(points, space, 0.0, count)
        now, turning, unseen = places if len(space) > 0 else reference, usual, False
    else:
        seconds = counted(stamp - known[0].stamp, constants)
        turned, there, arc, found, now, turning, unseen = _follow_ring(
            points, space, cut, nodes, reference, resolution, lens, seconds, constants
        )
    velocity, _ = advance(
        known[0], state[0], found, last, np.zeros(0), np.zeros(0), stamp, arc[-1], width, box, area, turning / usual,
        constants,
    )  # fmt: skip
    return state, found, velocity, now, turned, there, arc, unseen, miss


@compiled
def _follow_ring(
    points: Array, space: Array, cut: Flags, nodes: Array, known: Array, resolution: float, lens: Array, lasted: float,
    model: Any,
) -> Followed:  # fmt: skip
    """Follow an outline to a curve that was fitted in this frame: register and complete it.

    It is numbered by its form in space, or in the image if no depth is known; where something is over it, by what is
    seen of it.

    Args:
        points: As in ``Fitted``, and the next two.
        space: In metres.
        cut: Where it is not the object's own.
        nodes: ``(K, D)`` predicted.
        known: ``(K, D')`` the nodes in the past; ``(0, 2)`` if they are not known.
        resolution: Of the points.
        lens: See ``step_ring_in_mask``.
        lasted: Seconds for which this frame counts.
        model: The constants, one ``RingModel``.

    Returns:
        See ``Followed``.
    """
    flat, covered, unknown = points.shape[1] == 2, bool(cut.any()), len(known) == 0
    lost, usual = flat and known.shape[1] == 3 and len(space) == 0, model.velocity_share
    reference = nodes if unknown or lost else known
    in_image, own = reference.shape[1] == 2, space if reference.shape[1] == 3 else space[:0]
    arc, whole, found, now, turning = arc_length(closed(points)), known, nodes, known, usual
    turned, there = points, own
    if in_image and (lost or not covered):
        turned, there, begun, found, now, turning = register_ring(points, own, reference, nodes, 1.0, lasted, model)
        if lost:  # by its place in the image, if all of it is seen
            return turned, there, begun, found, known, usual, covered
        if not unknown:
            cut, whole = hidden_pieces(points, arc, found, known, nodes, model)
        arc = begun
    if cut.any() and not unknown:
        completed, seen, begin = complete_outline(points, own, cut, whole, nodes, model)
        if seen == 0:
            return points, space, arc_length(closed(points)), nodes, known, usual, True
        pixels, completed = (completed, own) if in_image else (projected(completed, lens), completed)
        if in_image or sticks_out(pixels[seen:], points, model.inside):
            turned, there, arc, found, _ = begin_outline(pixels, completed, begin, len(nodes))
            return turned, there, arc, found, known, usual, False
    if not in_image:
        turned, there, arc, found, now, turning = register_ring(
            points, own, reference, nodes, resolution, lasted, model
        )
        now = known if covered else now  # what touches it may hide a little of it
    elif len(space) > 0:  # depth is new
        metres = arc_length(closed(space))[nearest_vertex(points, found[0])]
        turned, there, arc, found, now = begin_outline(points, space, metres, len(nodes))
        turning = usual
    return turned, there, arc, found, now, turning, False
