"""Step: one frame of an outline in one compiled call, from what is seen to its state.

An outline is predicted, measured, registered and completed, and its track advances. Every frame of it goes this way,
the first one too, which begins where the paper's rule puts its first point.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import deprojected, projected
from shape_obs.compiled import compiled
from shape_obs.geometry.outline import SAMPLED, material_outline
from shape_obs.geometry.polyline import arc_length, closed, nearest_vertex, starting_at
from shape_obs.tracking.complete_lattice import outline_depth
from shape_obs.tracking.complete_ring import complete_outline, hidden_pieces, sticks_out
from shape_obs.tracking.measure_ring import MIN_SAMPLES, fit_ring_in_mask, nodes_around, trace_border
from shape_obs.tracking.model import Model, RingConstants  # noqa: F401 - the last in signatures
from shape_obs.tracking.predict import BEFORE_TYPE, Before, advance, counted, predict
from shape_obs.tracking.register_ring import begin_outline, first_place, register_ring
from shape_obs.tracking.scene import MASK_TYPE, InMask
from shape_obs.tracking.state import ShapeState, State  # noqa: F401 - the first in signatures

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
#: A curve ``(P, D)``; the same in metres ``(P, 3)``, ``(0, 3)`` where its form is that of the points; its arc length
#: ``(P + 1,)``; nodes ``(K, D)``; what is known of it now, ``(K, D')``, ``(0, 2)`` if nothing is; how far its
#: turning can be believed, 0...1; whether too little of it is seen.
Followed = tuple[Array, Array, Array, Array, Array, float, bool]
#: A track after a frame: state, nodes, velocity and reference; the curve of ``Followed``, its metres and arc length;
#: whether too little of it is seen; how far the outline misses the fitted curve, in distances of its samples.
Stepped = tuple[State, Array, Array, Array, Array, Array, Array, bool, float]
#: What was followed; why there is nothing, or ``FOUND``; how many samples the outline has; the width of the largest
#: component, pixels.
RingStep = tuple[Stepped, int, int, float]
#: A curve that was fitted to a cloud, ``(P, 3)``, clockwise as seen, in a first frame from where its numbering begins;
#: how many nodes a track begins with; how far the outline misses it, in distances of its samples; the resolution.
InCloud = tuple[Array, int, float, float]

_CLOUD_TYPE: Final = "Tuple((f8[:,::1], i8, f8, f8))"
NO_CLOUD: Final[InCloud] = np.zeros((0, 2)), 0, 0.0, 1.0  # the resolution of a mask is a pixel

FOUND, NO_HOLE, NOT_HOLLOW, TOO_SMALL, TOO_THIN = range(5)  # why there is no outline, if there is none


@compiled(f"({MASK_TYPE}, {_CLOUD_TYPE}, i8, b1, f8[::1], {BEFORE_TYPE.format('ShapeState')}, RingConstants[::1])")
def step_ring(
    image: InMask, cloud: InCloud, hole: int, band: bool, target: Array, before: Before, model: Model
) -> RingStep:
    """Follow an outline into a frame, or find it there: predict, measure, register and complete it.

    Args:
        image: The mask; ``NO_MASK`` if there is a cloud.
        cloud: The cloud; ``NO_CLOUD`` if there is a mask.
        hole: Which hole of the largest component, the largest first; -1 for its outer outline.
        band: Whether the object is a closed band, which encloses a hole.
        target: ``(2,)`` pixel where the first point belongs in a first frame; ``(0,)`` for the top left.
        before: The track; without nodes in a first frame.
        model: ``(1,)`` the constants.
    """
    mask, runs, pieces, (left, top, _, _), box, edge, depth, lens = image
    curve, count, miss, resolution = cloud
    known, last, speed, _, _, reference, stamp, _, _ = before
    constants, cold, nothing, space, width, samples = model[0], len(last) == 0, lens[:0], np.empty((0, 3)), 0.0, 0

    seconds, usual = stamp - known[0].stamp, constants.velocity_share
    nodes, _, _ = predict(last, speed, nothing, nothing, seconds, known[0].interval, usual)

    cut = np.zeros(len(curve), np.bool_)
    if len(curve) == 0:
        traced, width, hollow = trace_border(mask, runs, pieces, left, top, hole)
        samples = -(-len(traced) // SAMPLED)
        why = NO_HOLE if hole >= 0 and samples == 0 else TOO_SMALL if samples < MIN_SAMPLES else FOUND
        if band and why != NO_HOLE and hollow < constants.min_hollow:
            why = NOT_HOLLOW
        elif why == FOUND and hole < 0 and width < constants.min_width * SAMPLED:
            why = TOO_THIN
        if why != FOUND:
            return (known, last, speed, reference, traced, space, np.zeros(1), True, np.inf), why, samples, width
        points, smooth = material_outline(traced, hole >= 0)
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

    state = known.copy()
    if cold:
        turned, there, arc, found, places = begin_outline(curve, space, 0.0, count)
        now, turning, unseen = places if len(space) > 0 else reference, usual, False
    else:
        turned, there, arc, found, now, turning, unseen = _follow_ring(
            curve, space, cut, nodes, reference, resolution, lens, counted(seconds, constants), constants
        )
    velocity, _ = advance(
        known[0], state[0], found, last, nothing, nothing, stamp, arc[-1], width, box, turning / usual, constants
    )
    return (state, found, velocity, now, turned, there, arc, unseen, miss), FOUND, samples, width


@compiled
def _follow_ring(
    points: Array, space: Array, cut: Flags, nodes: Array, known: Array, resolution: float, lens: Array, lasted: float,
    model: Any,
) -> Followed:  # fmt: skip
    """Follow an outline to a curve that was fitted in this frame: register and complete it.

    It is numbered by its form in space, or in the image if no depth is known; where something is over it, by what is
    seen of it.

    Args:
        points: ``(P, D)``, clockwise as seen.
        space: ``(P, 3)`` the same in metres; ``(0, 3)`` if that is not known, or the points are in space.
        cut: ``(P,)`` where it is not the object's own.
        nodes: ``(K, D)`` predicted.
        known: ``(K, D')`` the nodes in the past; ``(0, 2)`` if they are not known.
        resolution: Of the points.
        lens: The projection.
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
