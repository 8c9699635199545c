"""Step: one frame of a sheet in one compiled call, from its mask to its nodes.

Its outline is measured, in space with depth, and the corners are matched to those predicted. What is seen of the sheet
is compared with what is known of it; where something hides its border, that is put back.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.camera import deprojected, projected
from shape_obs.compiled import compiled
from shape_obs.geometry.coons import (
    AROUND,
    FINE,
    blend_sides,
    border_of,
    coons_patch,
    corners_of,
    side_lengths,
    sides_of,
    turned,
)
from shape_obs.geometry.lattice import assess_lattice, lattice_gauges
from shape_obs.geometry.outline import SAMPLED, material_outline
from shape_obs.geometry.polyline import arc_length, closed
from shape_obs.geometry.rotation import flattened
from shape_obs.image.connected_runs import near_mask
from shape_obs.image.over_under import depth_at
from shape_obs.initialization.corners import sheet_outline
from shape_obs.tracking.complete_lattice import complete_border, hide_folded, outline_depth
from shape_obs.tracking.isometry import Measures, flatness, isometry
from shape_obs.tracking.measure_lattice import UNBENT, numbered_corners, turns_within
from shape_obs.tracking.measure_ring import MIN_SAMPLES, trace_border
from shape_obs.tracking.model import LatticeConstants, Model  # noqa: F401 - the first in signatures
from shape_obs.tracking.predict import BEFORE_TYPE, NO_NODES, Before, advance, counted, predict
from shape_obs.tracking.register_lattice import (
    compare_sheet,
    compare_sides,
    doubtful_places,
    first_corner,
    learn_sheet,
    learn_sides,
    match_corners,
    rescaled,
    visible_corners,
)
from shape_obs.tracking.scene import MASK_TYPE, NO_BOX, InMask
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
Flags = npt.NDArray[np.bool_]

_NEAREST, _COMPLETED, _BEST, _BUCKLED = range(4)  # the placements that are tried, in this order


#: A sheet that was found in a cloud: ``(625, 3)`` its lattice, metres; ``(625,)`` whether the cloud carries a node;
#: what numbering sees of them, ``(625, D)``, see ``Observed.seen``; by how many degrees its outline turns between two
#: corners; see ``assess_lattice``; the resolution.
InCloud = tuple[Array, Flags, Array, float, tuple[float, float, float, float], float]
#: What was found: what is wrong with it, see ``sheet_fault``; its quality, 0...1; ``(625, D)`` nodes, pixels or metres;
#: ``(625,)`` what of it is hidden; ``(625, D')`` the sheet as it is known now, in metres with depth, ``(0, 2)`` in a
#: cloud; ``(4,)`` lengths of its sides.
Found = tuple[Fault, float, Array, Flags, Array, Array]

_CLOUD_TYPE: Final = "Tuple((f8[:,::1], b1[::1], f8[:,::1], f8, UniTuple(f8, 4), f8))"
NO_CLOUD: Final[InCloud] = NO_NODES, np.zeros(0, bool), NO_NODES, 0.0, UNBENT, 1.0


class SheetStep(NamedTuple):
    """A sheet in a frame.

    Args:
        fault: What is wrong with it, see ``sheet_fault``.
        quality: 0...1.
        state: ``(1,)`` of its track.
        nodes: ``(625, D)`` pixels or metres.
        velocity: ``(625, D)`` of the nodes.
        reference: ``(625, D')`` the sheet as it is known now, in metres with depth; ``(0, 2)`` in a cloud.
        hidden: ``(625,)`` nodes that are not seen, or uncertain.
        down: ``(25,)`` see ``lattice_gauges``.
        right: ``(25,)`` the same.
        off: ``(625,)`` see ``Isometry``; ``(0,)`` if nothing shows it.
        folded: See ``Measures``.
        flat: How far it may be believed that it is spread out, 0...1; 0 if it is not.
        width: Of the mask's largest piece, pixels; 0 in a cloud.
    """

    fault: Fault
    quality: float
    state: State
    nodes: Array
    velocity: Array
    reference: Array
    hidden: Flags
    down: Array
    right: Array
    off: Array
    folded: Measures
    flat: float
    width: float


@compiled(
    f"({MASK_TYPE}, {_CLOUD_TYPE}, UniTuple(i8, 2), f8, f8[::1], {BEFORE_TYPE.format('ShapeState')}, "
    "LatticeConstants[::1])"
)
def step_sheet(
    image: InMask, cloud: InCloud, size: tuple[int, int], freedom: float, target: Array, before: Before,
    model: Model,
) -> SheetStep:  # fmt: skip
    """Follow a sheet into a frame, or find it there: predict, measure, register and complete it.

    Args:
        image: The mask, or that of a cloud; ``NO_MASK`` without one.
        cloud: The cloud; ``NO_CLOUD`` if there is none.
        size: Rows and columns of points that are asked for.
        freedom: How far a corner may move that the others do not, see ``judge_sheet``.
        target: Where the first corner belongs in a first frame, see ``first_corner``.
        before: The track; without nodes in a first frame.
        model: ``(1,)`` the constants.
    """
    mask, _, _, window, box, _, depth, lens = image
    constants, nothing, width = model[0], lens[:0], 0.0
    was, last, speed, _, _, _, stamp, _, _ = before
    seconds = stamp - was[0].stamp
    nodes, _, _ = predict(last, speed, nothing, nothing, seconds, was[0].interval, constants.velocity_share)

    if len(cloud[0]) > 0:
        fault, quality, nodes, hidden, known, sides = _find_in_cloud(cloud, nodes, freedom, before, model)
        seen, box = cloud[2], NO_BOX
    else:
        found, width = _find_in_mask(image, size, freedom, nodes, before, model)
        fault, quality, nodes, hidden, known, sides = found
        seen = nodes
    state, down, right, flat = was.copy(), nothing, nothing, 1.0
    off, folded = nothing, (0.0, 0.0, 0.0, 0.0)
    if fault[0] != NO_FAULT:
        return SheetStep(fault, quality, state, nodes, nodes, known, hidden, down, right, off, folded, flat, width)
    quarters = first_corner(seen, target) if len(last) == 0 else 0
    if quarters > 0:
        nodes, hidden = turned(nodes, quarters), turned(hidden.reshape(len(hidden), 1), quarters).reshape(len(hidden))
        known = turned(known, quarters)
    down, right = lattice_gauges(nodes.reshape(FINE, FINE, nodes.shape[1]))

    off, gap, folded = isometry(nodes, hidden, depth, mask, window[:2], lens, size[0], size[1], constants)
    flat = flatness(folded, constants)
    for p in range(len(off)):
        hidden[p] = hidden[p] or off[p] > constants.uncertain * gap
    for k in range(4):  # what is folded teaches no lengths
        state[0].sides[k] = was[0].sides[k] if flat == 0 else sides[(k + quarters) % 4]
    velocity, _ = advance(
        was[0], state[0], nodes, last, nothing, nothing, stamp, down[-1] + right[-1], width, box, 1.0, constants
    )
    return SheetStep(
        fault, quality * flat, state, nodes, velocity, known, hidden, down, right, off, folded, flat, width
    )


@compiled
def _find_in_mask(
    image: InMask, size: tuple[int, int], freedom: float, nodes: Array, before: Before, model: Model
) -> tuple[Found, float]:
    """Return what was found of a sheet in a mask, and the width of the mask's largest piece, pixels.

    Args:
        image: The mask.
        size: Rows and columns of points that are asked for.
        freedom: See ``step_sheet``.
        nodes: ``(625, 2)`` where the sheet is predicted; ``(0, 2)`` in a first frame.
        before: The track.
        model: ``(1,)`` the constants.
    """
    mask, runs, pieces, (left, top, _, _), _, edge, depth, lens = image
    constants, nothing, blank = model[0], lens[:0], np.empty((0, 2))
    was, _, _, _, _, reference, stamp, _, _ = before
    lasted, sides = counted(stamp - was[0].stamp, constants), np.empty(4)
    for k in range(4):
        sides[k] = was[0].sides[k]
    traced, width, _ = trace_border(mask, runs, pieces, left, top, -1)
    fault, quality, pixels, hidden, learnt, lengths = (NO_CORNERS, 0, 0.0, 0.0), 0.0, blank, nothing > 0, blank, sides
    if len(traced) <= SAMPLED * (MIN_SAMPLES - 1):
        return (fault, quality, pixels, hidden, learnt, lengths), width
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
    return (fault, quality, pixels, hidden, learnt, lengths), width


@compiled
def _find_in_cloud(cloud: InCloud, nodes: Array, freedom: float, before: Before, model: Model) -> Found:
    """Return what was found of a sheet in a cloud, numbered as its track is; for the arguments see ``step_sheet``.

    Args:
        cloud: The cloud.
        nodes: ``(625, 3)`` where the sheet is predicted; ``(0, 3)`` in a first frame.
        freedom: See there.
        before: The track.
        model: ``(1,)`` the constants.
    """
    (lattice, carried, _, kink, measures, resolution), constants = cloud, model[0]
    was, _, _, _, _, reference, stamp, _, _ = before
    code, side, lengths, hidden = NO_FAULT, 0, side_lengths(border_of(lattice)), ~carried
    fault, quality = judge_sheet(np.count_nonzero(hidden) / len(hidden), measures, kink, 0, 0.0, freedom, model)
    if len(nodes) > 0:
        quarters, _, _ = match_corners(corners_of(nodes), corners_of(lattice))
        found, sides, tolerance = np.empty(4), was[0].sides.copy(), np.empty(4)
        lattice = turned(lattice, quarters)
        hidden = turned(hidden.reshape(len(hidden), 1), quarters).reshape(len(hidden))
        for k in range(4):
            found[k] = lengths[(k + quarters) % 4]
            tolerance[k] = max(constants.length_tolerance[1] * sides[k], constants.border_noise * resolution)
            # What hides a part of it makes no side longer: it was not all in sight before.
            sides[k] = found[k] if found[k] > sides[k] + tolerance[k] else sides[k]
        code, side = compare_sides(found, sides, tolerance)
        lengths = learn_sides(found, sides, constants.max_stretch[1] * counted(stamp - was[0].stamp, constants))
    return fault if code == NO_FAULT else (code, side, 0.0, 0.0), quality, lattice, hidden, reference[:0], lengths
