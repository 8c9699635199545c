"""Step: one frame of a sheet in one compiled call, from its mask to its nodes.

Its outline is measured, in space with depth, and the corners are matched to those predicted. What is seen of the sheet
is compared with what is known of it; where something hides its border, that is put back.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.camera import projected
from shape_obs.compiled import compiled
from shape_obs.frame import DEPTH_TYPE, DepthImages
from shape_obs.geometry.coons import FINE, RIM, SIDE, blend_sides, border_of, coons_patch, side_lengths, sides_of
from shape_obs.geometry.lattice import assess_lattice, lattice_gauges
from shape_obs.geometry.outline import SAMPLED, material_outline
from shape_obs.geometry.polyline import arc_length, closed
from shape_obs.geometry.rotation import flattened
from shape_obs.image.connected_runs import near_mask
from shape_obs.image.outline_tracing import trace_largest
from shape_obs.image.over_under import depth_at
from shape_obs.initialization.corners import rim_of
from shape_obs.tracking.complete_lattice import Edges, complete_border, hide_folded, rim_depth
from shape_obs.tracking.measure_lattice import UNBENT, corners_of, find_corners, in_space, turns_within
from shape_obs.tracking.measure_ring import MIN_SAMPLES
from shape_obs.tracking.model import LatticeConstants, Model  # noqa: F401 - the first in a signature
from shape_obs.tracking.register_lattice import (
    assign_corners,
    compare_sheet,
    doubtful_places,
    learn_sheet,
    match_corners,
)
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
        reference: ``(625, D)`` the sheet as it is known now, in metres with depth.
        sides: ``(4,)`` the lengths of its sides, in the same unit.
        down: ``(25,)`` see ``lattice_gauges``.
        right: ``(25,)`` the same.
        width: Of the mask's largest piece, pixels.
    """

    fault: Fault
    quality: float
    nodes: Array
    hidden: Flags
    reference: Array
    sides: Array
    down: Array
    right: Array
    width: float


class _Frame(NamedTuple):
    """What is seen around a sheet, as ``step_sheet`` takes it."""

    depth: DepthImages
    mask: Mask
    left: int
    top: int
    lens: Array


class _Known(NamedTuple):
    """What is known of a sheet before a frame; all is empty without a track.

    Args:
        nodes: ``(625, 2)`` pixels, where it is predicted.
        lattice: ``(625, D)`` as it was, wherever it lay.
        sides: ``(4,)`` the lengths of its sides, in the unit of the lattice.
        tolerance: ``(4,)`` by which they may be off.
        gap: Between two points that are asked for, pixels.
        lasted: Seconds for which this frame counts.
    """

    nodes: Array
    lattice: Array
    sides: Array
    tolerance: Array
    gap: float
    lasted: float


#: Fault, quality, nodes, hidden, reference and sides of a ``SheetStep``.
_Placed = tuple[Fault, float, Array, Flags, Array, Array]


@compiled(
    "(u1[:,::1], i8[:,::1], i8, i8, i8, " + DEPTH_TYPE + ", UniTuple(i8, 4), f8[::1], f8[:,::1], f8[:,::1], f8[::1], "
    "f8, UniTuple(i8, 2), f8, LatticeConstants[::1])"
)
def step_sheet(
    mask: Mask, runs: Indices, pieces: int, left: int, top: int, depth: DepthImages, edge: Edges, lens: Array,
    nodes: Array, reference: Array, sides: Array, lasted: float, size: tuple[int, int], freedom: float, model: Model,
) -> SheetStep:  # fmt: skip
    """Follow a sheet into a mask, or find it there.

    Args:
        mask: As ``trace_components`` takes it, and the next four.
        runs: Of the mask.
        pieces: How many components there are.
        left: Image column.
        top: Image row.
        depth: As ``rim_depth`` takes it, and the next.
        edge: Of what is searched.
        lens: The projection, see ``Intrinsics.lens``; ``(0,)`` without one.
        nodes: ``(625, 2)`` pixels, where the sheet is predicted; ``(0, 2)`` without a track.
        reference: ``(625, D)`` as it was, wherever it lay, in metres if it was seen in space; ``(0, 2)`` if unknown.
        sides: ``(4,)`` the lengths of its sides in the same unit.
        lasted: Seconds for which this frame counts.
        size: Rows and columns of points that are asked for.
        freedom: How far a corner may move that the others do not, see ``validate_sheet``.
        model: ``(1,)`` the constants.
    """
    constants, frame, nothing = model[0], _Frame(depth, mask, left, top, lens), np.zeros(0)
    traced, width = trace_largest(mask, runs, pieces, left, top)
    placed = _refused(NO_CORNERS, 0, sides)
    if len(traced) <= SAMPLED * (MIN_SAMPLES - 1):
        return SheetStep(*placed, nothing, nothing, width)
    rim = rim_of(material_outline(traced, False)[1])
    limits = (
        constants.nearer, constants.at_edge, constants.depth_reach, constants.min_reach, constants.max_reach,
        constants.min_depth, constants.edge_reach,
    )  # fmt: skip
    z, cut = rim_depth(depth, edge, mask, left, top, rim.points, width, limits)
    space, covered = in_space(rim.points, z, lens), np.count_nonzero(cut) / RIM
    cold, clear, deep = len(nodes) == 0, covered == 0, len(space) > 0
    space = space if deep else rim.points
    lattice, lengths, tolerance = reference, sides, np.empty(4)
    if not cold and (len(reference) == 0 or reference.shape[1] > space.shape[1]):
        lattice, lengths = nodes, side_lengths(border_of(nodes))
    metric = 1 if not cold and lattice.shape[1] == 3 else 0
    scale = arc_length(closed(space))[RIM] / (RIM * rim.step) if metric else 1.0
    for k in range(4):
        tolerance[k] = max(constants.length_tolerance[metric] * lengths[k], constants.border_noise * scale)
    gap = min(lengths[0] / size[1], lengths[1] / size[0])
    known = _Known(nodes, lattice, lengths, tolerance, gap, lasted)
    for way in range(4):
        if cold:
            possible = way == _BEST
        elif way == _BUCKLED:
            possible = deep and covered < constants.barely_cut
        else:
            possible = clear or way == _COMPLETED
        if not possible:
            continue
        if way == _COMPLETED:
            kinks = np.zeros(RIM)
            if metric:
                inner = constants.inner * width
                kinks = turns_within(rim.points, space, depth, mask, left, top, width, lens, limits, inner)
            found = _completed(rim, space if metric else rim.points, cut, kinks, known, frame, covered, constants)
        else:
            found = _seen_as_whole(rim, space, known, frame, way == _BEST, way == _BUCKLED, freedom, model)
        if found[0][0] == NO_FAULT or cold or way == _NEAREST or not clear:
            placed = found
        if found[0][0] == NO_FAULT:
            break
    fault, quality, lattice, hidden, learnt, lengths = placed
    if len(reference) > 0 and reference.shape[1] > learnt.shape[1]:  # this frame has lost its depth
        learnt, lengths = reference, sides
    down = right = nothing
    if fault[0] == NO_FAULT:
        down, right = lattice_gauges(lattice.reshape(FINE, FINE, 2))
    return SheetStep(fault, quality, lattice, hidden, learnt, lengths, down, right, width)


@compiled
def _refused(code: int, number: int, sides: Array) -> _Placed:
    """Return that no sheet was found, and why."""
    nothing = np.empty((0, 2))
    return (code, number, 0.0, 0.0), 0.0, nothing, np.zeros(0, np.bool_), nothing, sides


@compiled
def _seen_as_whole(
    rim: Any, space: Array, known: Any, frame: Any, best: bool, buckled: bool, freedom: float, model: Model
) -> _Placed:
    """Lay the lattice between four corners that are all seen, and compare it with what is known of the sheet.

    Args:
        rim: A ``Rim``.
        space: ``(400, D)`` its points, in metres where there is depth.
        known: A ``_Known``.
        frame: A ``_Frame``.
        best: Whether the corners are those most like a sheet's, not those nearest to the predicted ones.
        buckled: Whether sides may be shorter, since nothing lies over them that could hide a part.
        freedom: How far a corner may move that the others do not.
        model: ``(1,)`` the constants.
    """
    tracked = len(known.nodes) > 0
    metric = tracked and known.lattice.shape[1] == 3
    corners, number, moved = find_corners(rim, rim.points, known.nodes, best), 0, 0.0
    if len(corners) == 0:
        return _refused(NO_CORNERS if tracked else TOO_FEW_CORNERS, len(rim.candidates), known.sides)
    if tracked:
        found, places = corners.copy(), np.empty((4, 2))
        for k in range(4):
            places[k, 0], places[k, 1] = rim.points[found[k], 0], rim.points[found[k], 1]
        quarters, number, moved = match_corners(corners_of(known.nodes), places)
        for k in range(4):
            corners[k] = found[(k + quarters) % 4]
    patch, kink = coons_patch(rim, space, corners)
    lattice = projected(patch, frame.lens) if patch.shape[1] == 3 else patch
    if len(lattice) == 0:
        return _refused(OUT_OF_SIGHT, 0, known.sides)
    hidden, off = _hidden_nodes(lattice, known, tracked and not metric, frame, model[0])
    code, side = NO_FAULT, 0
    if tracked:
        border = border_of(patch if metric else lattice)
        known_border = border_of(known.lattice)
        code, side = compare_sheet(border, known_border, known.sides, known.tolerance, metric, buckled, model[0])
    measures = UNBENT
    if not metric:
        flat = flattened(patch) if patch.shape[1] == 3 else patch
        measures = assess_lattice(flat.reshape(FINE, FINE, 2))
    if metric and not buckled:  # the lengths of the sides say more
        number, moved = 0, 0.0
    fault, quality = judge_sheet(off, measures, kink, number, moved, freedom, model)
    if code != NO_FAULT:
        fault = code, side, 0.0, 0.0
    learnt, sides = patch, known.sides
    if not tracked or known.lattice.shape[1] < patch.shape[1]:
        sides = side_lengths(border_of(patch))
    elif not (metric and buckled):
        learnt, sides = learn_sheet(known.lattice, patch, known.sides, known.lasted, model[0])
    return fault, quality, lattice, hidden, learnt, sides


@compiled
def _completed(
    rim: Any, space: Array, cut: Flags, kinks: Array, known: Any, frame: Any, covered: float, model: Any
) -> _Placed:
    """Lay the lattice between sides of which a part is hidden and put back.

    Args:
        rim: A ``Rim``.
        space: ``(400, D)`` its points in the unit in which the sheet is known.
        cut: ``(400,)`` where something lies over it, see ``rim_depth``.
        kinks: ``(400,)`` see ``turns_within``.
        known: A ``_Known``.
        frame: A ``_Frame``.
        covered: The share of the rim next to which something nearer is seen.
        model: The constants, one ``LatticeModel``.
    """
    metric, sides, corners = space.shape[1] == 3, known.sides, np.empty(4, np.int64)
    arc, places, arcs = arc_length(closed(space)), np.empty((len(rim.candidates), 2)), np.empty(len(rim.candidates))
    which, count, spread = np.empty_like(rim.candidates), 0, model.corner_spread[1 if metric else 0]
    for q in rim.candidates:
        if not cut[q]:
            places[count, 0], places[count, 1] = rim.points[q, 0], rim.points[q, 1]
            arcs[count], which[count], count = arc[q], q, count + 1
    found, cost = assign_corners(
        corners_of(known.nodes), places[:count], arcs[:count], arc[RIM], sides, known.tolerance, spread, model
    )
    if not math.isfinite(cost):
        return _refused(TOO_LITTLE, 0, sides)
    for k in range(4):
        corners[k] = which[found[k]] if found[k] >= 0 else -1
    before = border_of(known.lattice)
    predicted = border_of(known.nodes) if metric else before
    border, seen, folded = complete_border(
        predicted, before, rim.points, space, corners, cut, kinks, sides, known.tolerance, model
    )
    if len(border) == 0:
        return _refused(TOO_LITTLE, 0, sides)
    patch = blend_sides(sides_of(border))
    lattice = projected(patch, frame.lens) if metric else patch
    if len(lattice) == 0:
        return _refused(OUT_OF_SIGHT, 0, sides)
    hidden, _ = _hidden_nodes(lattice, known, not metric, frame, model)
    fault = NO_FAULT, 0, 0.0, 0.0
    if len(folded) > 0:
        hide_folded(folded, sides, hidden)
    elif metric and covered < model.barely_cut:
        through = 0
        for p in range(len(patch)):
            through += hidden[p] and depth_at(frame.depth, lattice[p, 0], lattice[p, 1]) > patch[p, 2] + model.behind
        if through > model.max_seen_through * len(patch):
            fault = NOTHING_OVER, 0, 0.0, 0.0
    if not metric:
        patch, sides = known.lattice, _rescaled(border, seen, known, model)
    return fault, math.sqrt(np.count_nonzero(seen) / len(seen)), lattice, hidden, patch, sides


@compiled
def _hidden_nodes(lattice: Array, known: Any, compared: bool, frame: Any, model: Any) -> tuple[Flags, float]:
    """Return which nodes of a lattice in pixels are hidden ``(625,)``, and which share of them lies off the mask.

    They lie off the mask or, if they are compared with what is known of the sheet, elsewhere than its form has them.
    """
    off, inside = 0, near_mask(frame.mask, frame.left, frame.top, lattice, 1)
    hidden = doubtful_places(known.lattice, lattice, known.gap, model) if compared else np.zeros(len(lattice), np.bool_)
    for p in range(len(lattice)):
        off += not inside[p]
        hidden[p] = hidden[p] or not inside[p]
    return hidden, off / len(lattice)


@compiled
def _rescaled(border: Array, seen: Flags, known: Any, model: Any) -> Array:
    """Return the lengths of all sides in an image, which grow and shrink as those do that are seen from end to end."""
    lengths, ratios, count = side_lengths(border), np.empty(4), 0
    for k in range(4):
        whole = True
        for i in range(FINE):
            whole = whole and seen[(SIDE * k + i) % len(seen)]
        if whole:
            ratios[count] = lengths[k] / known.sides[k]
            count += 1
    if count == 0:
        return known.sides
    most, learnt = model.max_stretch[1] * known.lasted, np.empty(4)
    for k in range(4):
        learnt[k] = known.sides[k] * min(max(np.median(ratios[:count]), 1 - most), 1 + most)
    return learnt
