"""Step: one frame of an outline in one compiled call, from what is seen to its curve and nodes.

An outline is measured, registered and completed. Every frame of it goes this way, the first one too, which begins where
the paper's rule puts its first point.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shape_obs.camera import deprojected, projected
from shape_obs.compiled import compiled
from shape_obs.frame import DEPTH_TYPE, DepthImages
from shape_obs.geometry.outline import SAMPLED, material_outline
from shape_obs.geometry.polyline import arc_length, closed, nearest_vertex, starting_at
from shape_obs.tracking.complete_lattice import Edges, outline_depth
from shape_obs.tracking.complete_ring import complete_outline, hidden_pieces, sticks_out
from shape_obs.tracking.measure_ring import MIN_SAMPLES, fit_ring_in_mask, nodes_around, trace_border
from shape_obs.tracking.model import Model, RingConstants  # noqa: F401 - the last in a signature
from shape_obs.tracking.register_ring import begin_outline, first_place, register_ring

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]
#: A curve ``(P, D)``; the same in metres ``(P, 3)``, ``(0, 3)`` where its form is that of the points; its arc length
#: ``(P + 1,)``; nodes ``(K, D)``; what is known of it now, ``(K, D')``, ``(0, 2)`` if nothing is; how far its
#: turning can be believed, 0...1; whether too little of it is seen.
Followed = tuple[Array, Array, Array, Array, Array, float, bool]
#: What was followed, all empty if there is no outline; why there is none, or ``FOUND``; how far the outline misses the
#: curve, in distances of its samples; how many samples there are; the width of the largest component, pixels.
RingStep = tuple[Followed, int, float, int, float]

FOUND, NO_HOLE, NOT_HOLLOW, TOO_SMALL, TOO_THIN = range(5)  # why there is no outline, if there is none


@compiled(
    "(u1[:,::1], i8[:,::1], i8, i8, i8, " + DEPTH_TYPE + ", UniTuple(i8, 4), f8[::1], i8, b1, f8[::1], "
    "f8[:,::1], f8[:,::1], f8, RingConstants[::1])"
)
def step_ring_in_mask(
    mask: Mask, runs: Indices, pieces: int, left: int, top: int, depth: DepthImages, edge: Edges, lens: Array,
    hole: int, band: bool, target: Array, nodes: Array, known: Array, lasted: float, model: Model,
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
        hole: Which hole of the largest component, the largest first; -1 for its outer outline.
        band: Whether the object is a closed band, which encloses a hole.
        target: ``(2,)`` pixel where the first point belongs in a first frame; ``(0,)`` for the top left.
        nodes: ``(K, 2)`` where the outline is predicted; ``(0, 2)`` in a first frame.
        known: ``(K, D)`` its nodes in the past, wherever it was, in pixels or metres; ``(0, 2)`` if they are not known.
        lasted: Seconds for which this frame counts.
        model: ``(1,)`` the constants.

    Returns:
        See ``RingStep``.
    """
    traced, width, hollow = trace_border(mask, runs, pieces, left, top, hole)
    samples, space, cold, constants = -(-len(traced) // SAMPLED), np.empty((0, 3)), len(nodes) == 0, model[0]
    why = NO_HOLE if hole >= 0 and samples == 0 else TOO_SMALL if samples < MIN_SAMPLES else FOUND
    if band and why != NO_HOLE and hollow < constants.min_hollow:
        why = NOT_HOLLOW
    elif why == FOUND and hole < 0 and width < constants.min_width * SAMPLED:
        why = TOO_THIN
    if why != FOUND:
        return (traced, space, np.zeros(1), nodes, known, 0.0, True), why, np.inf, samples, width
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
    if cold:
        curve, there, arc, nodes, places = begin_outline(curve, space, 0.0, count)
        known = places if len(space) > 0 else known
        return (curve, there, arc, nodes, known, constants.velocity_share, False), FOUND, miss, samples, width
    found = follow_ring(curve, space, cut, nodes, known, 1.0, lens, lasted, model)
    return found, FOUND, miss, samples, width


@compiled("(f8[:,::1], f8[:,::1], b1[::1], f8[:,::1], f8[:,::1], f8, f8[::1], f8, RingConstants[::1])")
def follow_ring(
    points: Array, space: Array, cut: Flags, nodes: Array, known: Array, resolution: float, lens: Array, lasted: float,
    model: Model,
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
        lens: See ``step_ring_in_mask``.
        lasted: Seconds for which this frame counts.
        model: ``(1,)`` the constants.

    Returns:
        See ``Followed``.
    """
    constants, flat, covered, unknown = model[0], points.shape[1] == 2, bool(cut.any()), len(known) == 0
    lost, usual = flat and known.shape[1] == 3 and len(space) == 0, constants.velocity_share
    reference = nodes if unknown or lost else known
    in_image, own = reference.shape[1] == 2, space if reference.shape[1] == 3 else space[:0]
    arc, whole, found, now, turning = arc_length(closed(points)), known, nodes, known, usual
    turned, there = points, own
    if in_image and (lost or not covered):
        turned, there, begun, found, now, turning = register_ring(points, own, reference, nodes, 1.0, lasted, constants)
        if lost:  # by its place in the image, if all of it is seen
            return turned, there, begun, found, known, usual, covered
        if not unknown:
            cut, whole = hidden_pieces(points, arc, found, known, nodes, constants)
        arc = begun
    if cut.any() and not unknown:
        completed, seen, begin = complete_outline(points, own, cut, whole, nodes, constants)
        if seen == 0:
            return points, space, arc_length(closed(points)), nodes, known, usual, True
        pixels, completed = (completed, own) if in_image else (projected(completed, lens), completed)
        if in_image or sticks_out(pixels[seen:], points, constants.inside):
            turned, there, arc, found, _ = begin_outline(pixels, completed, begin, len(nodes))
            return turned, there, arc, found, known, usual, False
    if not in_image:
        turned, there, arc, found, now, turning = register_ring(
            points, own, reference, nodes, resolution, lasted, constants
        )
        now = known if covered else now  # what touches it may hide a little of it
    elif len(space) > 0:  # depth is new
        metres = arc_length(closed(space))[nearest_vertex(points, found[0])]
        turned, there, arc, found, now = begin_outline(points, space, metres, len(nodes))
        turning = usual
    return turned, there, arc, found, now, turning, False
