"""Step: one frame of a sheet in one compiled call, from its mask to its nodes.

Its outline is measured, in space with depth, and the corners are matched to those predicted. What is seen of the sheet
is compared with what is known of it; where something hides its border, that is put back.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.camera import deprojected, projected
from shape_obs.compiled import compiled
from shape_obs.frame import DEPTH_TYPE, DepthImages
from shape_obs.geometry.coons import AROUND, FINE, blend_sides, border_of, coons_patch, side_lengths, sides_of
from shape_obs.geometry.lattice import assess_lattice, lattice_gauges
from shape_obs.geometry.outline import SAMPLED, material_outline
from shape_obs.geometry.polyline import arc_length, closed
from shape_obs.geometry.rotation import flattened
from shape_obs.image.connected_runs import near_mask
from shape_obs.image.over_under import depth_at
from shape_obs.initialization.corners import sheet_outline
from shape_obs.tracking.complete_lattice import complete_border, hide_folded, outline_depth
from shape_obs.tracking.measure_lattice import UNBENT, corners_of, numbered_corners, turns_within
from shape_obs.tracking.measure_ring import MIN_SAMPLES, trace_border
from shape_obs.tracking.model import LatticeConstants, Model  # noqa: F401 - the first in signatures
from shape_obs.tracking.predict import BEFORE_TYPE, Box, ShapeBefore, advance, counted, predict
from shape_obs.tracking.register_lattice import (
    compare_sheet,
    compare_sides,
    doubtful_places,
    learn_sheet,
    learn_sides,
    match_corners,
    rescaled,
    visible_corners,
)
from shape_obs.tracking.state import ShapeState, State  # noqa: F401 - the first in signatures
from shape_obs.tracking.validation import (
    NO_CORNERS,
    NO_FAULT,
    NOTHING_OVER,
    OUT_OF_SIGHT,
    TOO_FEW_CORNERS,
    TOO_LITTLE,
    Fault,
    judge_sheet,
)

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]

_NEAREST, _COMPLETED, _BEST, _BUCKLED = range(4)  # the placements that are tried, in this order


class SheetStep(NamedTuple):
    """A sheet in a frame.

    Args:
        fault: What is wrong with it, see ``sheet_fault``.
        quality: 0...1.
        nodes: ``(625, 2)`` pixels.
        hidden: ``(625,)``.
        state: ``(1,)`` of its track.
        reference: ``(625, D)`` the sheet as it is known now, in metres with depth.
        down: ``(25,)`` see ``lattice_gauges``.
        right: ``(25,)`` the same.
        width: Of the mask's largest piece, pixels.
    """

    fault: Fault
    quality: float
    nodes: Array
    hidden: Flags
    state: State
    reference: Array
    down: Array
    right: Array
    width: float


@compiled(
    f"(u1[:,::1], i8[:,::1], i8, i8, i8, {DEPTH_TYPE}, UniTuple(i8, 4), f8[::1], UniTuple(i8, 2), f8, {BEFORE_TYPE}, "
    "LatticeConstants[::1])"
)
def step_sheet(
    mask: Mask, runs: Indices, pieces: int, left: int, top: int, depth: DepthImages, edge: Box, lens: Array,
    size: tuple[int, int], freedom: float, before: ShapeBefore, model: Model,
) -> SheetStep:  # fmt: skip
    """Follow a sheet into a mask, or find it there.

    Args:
        mask: As ``trace_components`` takes it, and the next four.
        runs: Of the mask.
        pieces: How many components there are.
        left: Image column.
        top: Image row.
        depth: As ``outline_depth`` takes it, and the next.
        edge: Of what is searched.
        lens: The projection, see ``Intrinsics.lens``; ``(0,)`` without one.
        size: Rows and columns of points that are asked for.
        freedom: How far a corner may move that the others do not, see ``judge_sheet``.
        before: The track; without nodes in a first frame.
        model: ``(1,)`` the constants.
    """
    constants, nothing, blank = model[0], np.zeros(0), np.empty((0, 2))
    was, last, speed, reference, stamp = before
    seconds = stamp - was[0].stamp
    nodes, _, _ = predict(last, speed, nothing, nothing, seconds, was[0].interval, constants.velocity_share)
    lasted, sides, state = counted(seconds, constants), np.empty(4), was.copy()
    for k in range(4):
        sides[k] = was[0].sides[k]
    traced, width, _ = trace_border(mask, runs, pieces, left, top, -1)
    fault, quality, pixels, hidden, learnt, lengths = (NO_CORNERS, 0, 0.0, 0.0), 0.0, blank, nothing > 0, blank, sides
    if len(traced) <= SAMPLED * (MIN_SAMPLES - 1):
        return SheetStep(fault, quality, pixels, hidden, state, learnt, nothing, nothing, width)
    outline = sheet_outline(material_outline(traced, False)[1])
    z, cut = outline_depth(depth, edge, mask, left, top, outline.points, width, constants)
    space = deprojected(outline.points, z, lens)
    cold, clear, deep = len(nodes) == 0, not cut.any(), len(space) > 0
    space = space if deep else outline.points
    known, usual, tolerance = reference, sides, np.empty(4)
    if not cold and (len(reference) == 0 or reference.shape[1] > space.shape[1]):
        known, usual = nodes, side_lengths(border_of(nodes))
    metric = not cold and known.shape[1] == 3
    scale = arc_length(closed(space))[AROUND] / (AROUND * outline.step) if metric else 1.0
    for k in range(4):
        share = constants.length_tolerance[1 if metric else 0]
        tolerance[k] = max(share * usual[k], constants.border_noise * scale)
    for way in range(4):
        if cold:
            possible = way == _BEST
        elif way == _BUCKLED:
            possible = deep
        else:
            possible = clear or way == _COMPLETED
        if not possible:
            continue
        code, number, moved, kink, kinks = NO_FAULT, 0, 0.0, 0.0, np.zeros(AROUND)
        there = space if metric or way != _COMPLETED else outline.points
        patch, border, seen, folded = there[:0], there[:0], cut[:0], np.empty((0, 2), np.int64)
        if way == _COMPLETED:
            if metric:
                kinks = turns_within(outline.points, space, depth, mask, left, top, width, lens, constants)
            corners = visible_corners(outline, there, cut, corners_of(nodes), usual, tolerance, constants)
            border, seen, folded = complete_border(
                border_of(nodes),
                border_of(known),
                outline.points,
                there,
                corners,
                cut,
                kinks,
                usual,
                tolerance,
                constants,
            )
            if len(border) > 0:
                patch = blend_sides(sides_of(border))
        else:
            corners, number, moved = numbered_corners(outline, nodes, way == _BEST)
            if len(corners) > 0:
                patch, kink = coons_patch(outline, there, corners)
        places = projected(patch, lens) if patch.shape[1] == 3 else patch
        if len(places) == 0:
            code, number = TOO_FEW_CORNERS if cold else NO_CORNERS, len(outline.candidates)
            code = OUT_OF_SIGHT if len(patch) > 0 else TOO_LITTLE if way == _COMPLETED else code
            if cold or way == _NEAREST or not clear:
                fault = code, number, 0.0, 0.0
            continue
        off, inside = 0, near_mask(mask, left, top, places, 1)
        unseen, now, sides_now = np.zeros(len(places), np.bool_), patch, usual
        if not cold and not metric:
            unseen = doubtful_places(known, places, min(usual[0] / size[1], usual[1] / size[0]), constants)
        for p in range(len(places)):
            off += not inside[p]
            unseen[p] = unseen[p] or not inside[p]
        if way == _COMPLETED:
            verdict, value = (NO_FAULT, 0, 0.0, 0.0), math.sqrt(np.count_nonzero(seen) / len(seen))
            if len(folded) > 0:
                hide_folded(folded, usual, unseen)
            elif metric:
                through = 0
                for p in range(len(patch)):
                    behind = depth_at(depth, places[p, 0], places[p, 1]) if not inside[p] else 0.0
                    through += behind > patch[p, 2] + constants.nearer
                if through > constants.max_seen_through * len(patch):
                    code = NOTHING_OVER
            if not metric:
                now, sides_now = known, rescaled(border, seen, usual, constants.max_stretch[1] * lasted)
        else:
            measures = UNBENT
            if not metric:
                flat = flattened(patch) if patch.shape[1] == 3 else patch
                measures = assess_lattice(flat.reshape(FINE, FINE, 2))
            elif way != _BUCKLED:  # the lengths of the sides say more
                number, moved = 0, 0.0
            verdict, value = judge_sheet(off / len(places), measures, kink, number, moved, freedom, model)
            if not cold:
                outer = border_of(patch if metric else places)
                code, number = compare_sheet(
                    outer, border_of(known), usual, tolerance, metric, way == _BUCKLED, constants
                )
            if cold or known.shape[1] < patch.shape[1]:
                sides_now = side_lengths(border_of(patch))
            elif not (metric and way == _BUCKLED):
                now, sides_now = learn_sheet(known, patch, usual, lasted, constants)
        if code != NO_FAULT:
            verdict = code, number, 0.0, 0.0
        if verdict[0] == NO_FAULT or cold or way == _NEAREST or not clear:
            fault, quality, pixels, hidden, learnt, lengths = verdict, value, places, unseen, now, sides_now
        if verdict[0] == NO_FAULT:
            break
    if len(reference) > 0 and reference.shape[1] > learnt.shape[1]:  # this frame has lost its depth
        learnt, lengths = reference, sides
    for k in range(4):
        state[0].sides[k] = lengths[k]
    down = right = nothing
    if fault[0] == NO_FAULT:
        down, right = lattice_gauges(pixels.reshape(FINE, FINE, 2))
    return SheetStep(fault, quality, pixels, hidden, state, learnt, down, right, width)


@compiled("(f8[:,::1], f8, f8[:,::1], " + BEFORE_TYPE + ", LatticeConstants[::1])")
def register_in_cloud(
    lattice: Array, resolution: float, nodes: Array, before: ShapeBefore, model: Model
) -> tuple[int, State, int, int]:
    """Compare a sheet that was found in a cloud with its track.

    Args:
        lattice: ``(625, 3)`` metres.
        resolution: Of the cloud, metres.
        nodes: ``(625, 3)`` where the sheet is predicted.
        before: The track; without nodes in a first frame.
        model: ``(1,)`` the constants.

    Returns:
        By how many quarters the lattice is to be turned so that it is numbered as the track is; the state ``(1,)`` of
        the track with the lengths of the sides; a code and a side, see ``compare_sheet``.
    """
    (was, last, _, _, stamp), constants, quarters = before, model[0], 0
    state, code, side, lengths = was.copy(), NO_FAULT, 0, side_lengths(border_of(lattice))
    if len(last) > 0:
        quarters, _, _ = match_corners(corners_of(nodes), corners_of(lattice))
        found, sides, tolerance, most = np.empty(4), was[0].sides.copy(), np.empty(4), constants.max_stretch[1]
        for k in range(4):
            found[k] = lengths[(k + quarters) % 4]
            tolerance[k] = max(constants.length_tolerance[1] * sides[k], constants.border_noise * resolution)
            # What hides a part of it makes no side longer: it was not all in sight before.
            sides[k] = found[k] if found[k] > sides[k] + tolerance[k] else sides[k]
        code, side = compare_sides(found, sides, tolerance)
        lengths = learn_sides(found, sides, most * counted(stamp - was[0].stamp, constants))
    for k in range(4):
        state[0].sides[k] = lengths[k]
    return quarters, state, code, side


@compiled("(ShapeState[::1], f8[:,::1], f8, f8, UniTuple(i8, 4), " + BEFORE_TYPE + ", LatticeConstants[::1])")
def advance_sheet(
    state: State, nodes: Array, size: float, width: float, box: Box, before: ShapeBefore, model: Model
) -> Array:
    """Write into the state of a sheet how it has moved, and return the velocity of its nodes.

    Args:
        state: ``(1,)`` after this frame; written to.
        nodes: ``(625, D)`` where they were found.
        size: Of the lattice.
        width: Of the sheet; 0 if it is not known.
        box: Around its mask; ``NO_BOX`` in a cloud.
        before: The track; without nodes in a first frame.
        model: ``(1,)`` the constants.
    """
    known, last, _, _, stamp = before
    nothing = np.zeros(0)
    return advance(known[0], state[0], nodes, last, nothing, nothing, stamp, size, width, box, 1.0, model[0])[0]
