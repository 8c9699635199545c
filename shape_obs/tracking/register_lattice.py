"""Match the corners of a sheet to those of the last frame, and choose the visible ones.

A hand over a corner leaves the outline with another one, some way inside. The three others are laid over where they
were expected by a similarity transform (S. Umeyama, "Least-Squares Estimation of Transformation Parameters Between Two
Point Patterns", 1991), and the fourth has to follow. The sides between visible corners keep their known lengths.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.coons import AROUND, FINE, SIDE, border_of, corners_of, side_lengths
from shape_obs.geometry.polyline import arc_length, closed
from shape_obs.geometry.rotation import moved_onto
from shape_obs.tracking.model import gain_of
from shape_obs.tracking.validation import ELSEWHERE, LONGER, NO_FAULT, SHORTER

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
Complexes = npt.NDArray[np.complex128]

_NEAREST: Final = 5  # places among which each corner is looked for
_AROUND: Final = 1.5  # outlines: corners in order go around once, in another order twice
_SOME: Final = 4  # every so many points of a lattice give the median distance
_CHORD: Final = 3  # points of a border to either side, over which it is seen to turn


@compiled
def match_corners(expected: Array, corners: Array) -> tuple[int, int, float]:
    """Return how a sheet's corners are numbered, and which one lies farthest from where the other three put it.

    Args:
        expected: ``(4, D)`` predicted corners, clockwise.
        corners: ``(4, D)`` found.

    Returns:
        By how many quarters the found lattice is to be turned, so that its corners lie nearest to the predicted
        ones; then which of them strays most, and by which share of half a diagonal.
    """
    dimension = corners.shape[1]
    quarters, least = 0, np.inf
    for turn in range(4):
        square = 0.0
        for k in range(4):
            for d in range(dimension):
                square += (corners[(k + turn) % 4, d] - expected[k, d]) ** 2
        if square < least:
            quarters, least = turn, square
    found, middle = np.empty((4, dimension)), np.zeros(dimension)
    for k in range(4):
        for d in range(dimension):
            found[k, d] = corners[(k + quarters) % 4, d]
            middle[d] += found[k, d] / 4
    worst, most, reach = 0, -1.0, 1e-18
    for k in range(4):
        others, off, square = np.ones(4, np.bool_), 0.0, 0.0
        others[k] = False
        placed = moved_onto(expected, expected, found, others, True)
        for d in range(dimension):
            off += (placed[k, d] - found[k, d]) ** 2
            square += (found[k, d] - middle[d]) ** 2
        if off > most:
            worst, most = k, off
        reach = max(reach, square)
    return quarters, worst, math.sqrt(most / reach)


@compiled("(f8[:,::1], f8[::1])")
def first_corner(seen: Array, target: Array) -> int:
    """Return how many corners further on, clockwise, the paper's rule puts the first corner of a lattice.

    Args:
        seen: ``(625, D)`` as numbering sees it, see ``Observed.seen``.
        target: ``(D,)`` where the first corner belongs; ``(0,)`` makes rows run right and columns down.
    """
    if len(target) > 0:
        corners, nearest, least = corners_of(seen), 0, np.inf
        for k in range(4):
            square = 0.0
            for d in range(len(target)):
                square += (corners[k, d] - target[d]) ** 2
            nearest, least = (k, square) if square < least else (nearest, least)
        return nearest
    right, down, last = np.zeros(2), np.zeros(2), FINE - 1
    for i in range(FINE):
        for d in range(2):
            right[d] += seen[i * FINE + last, d] - seen[i * FINE, d]
            down[d] += seen[last * FINE + i, d] - seen[i, d]
    wide, high = math.hypot(right[0], right[1]), math.hypot(down[0], down[1])
    level = right[0] / max(wide, 1e-9) + down[1] / max(high, 1e-9)
    upright = down[0] / max(high, 1e-9) - right[1] / max(wide, 1e-9)
    turns, best = (level, upright, -level, -upright), 0
    for k in range(1, 4):
        best = k if turns[k] > turns[best] else best
    return best


@compiled
def visible_corners(
    outline: Any, space: Array, cut: Mask, expected: Array, sides: Array, tolerance: Array, model: Any
) -> Indices:
    """Return which points of an outline are the corners of a sheet, ``(4,)``, -1 for a hidden one, or for all.

    Args:
        outline: A ``SheetOutline``.
        space: ``(400, D)`` its points in the unit of the sides.
        cut: ``(400,)`` whether something lies over it there.
        expected: As ``assign_corners`` takes it, and the next two.
        sides: Lengths.
        tolerance: The same.
        model: The constants, one ``LatticeModel``.
    """
    arc, size = arc_length(closed(space)), len(outline.candidates)
    places, arcs = np.empty((size, 2)), np.empty(size)
    which, count, spread = np.empty_like(outline.candidates), 0, model.corner_spread[space.shape[1] - 2]
    for q in outline.candidates:
        if not cut[q]:
            places[count, 0], places[count, 1] = outline.points[q, 0], outline.points[q, 1]
            arcs[count], which[count], count = arc[q], q, count + 1
    found = assign_corners(expected, places[:count], arcs[:count], arc[AROUND], sides, tolerance, spread, model)
    for k in range(4):
        found[k] = which[found[k]] if found[k] >= 0 else -1
    return found


@compiled
def assign_corners(
    expected: Array, places: Array, arcs: Array, whole: float, sides: Array, tolerance: Array, spread: float, model: Any
) -> Indices:
    """Return which of the places where an outline turns are the corners of a sheet; -1 for one that is hidden.

    Args:
        expected: ``(4, 2)`` pixels, predicted, clockwise.
        places: ``(Q, 2)`` pixels, clockwise around the outline.
        arcs: ``(Q,)`` their arc lengths along it, in the unit of the sides.
        whole: The outline's length.
        sides: ``(4,)`` the sheet's known lengths, from each corner to the next.
        tolerance: ``(4,)`` by which a length may be off.
        spread: Standard deviation of a corner from where the others put it, half diagonals.
        model: The constants, one ``LatticeModel``.

    Returns:
        ``(4,)`` indices, at least two of them places; all -1 if no choice is possible.
    """
    count, centre, reach = len(places), complex(0, 0), 0.0
    at, to = np.empty(4, np.complex128), np.empty(max(count, 1), np.complex128)
    for k in range(4):
        at[k] = complex(expected[k, 0], expected[k, 1])
        centre += at[k] / 4
    for k in range(4):
        reach = max(reach, abs(at[k] - centre))
    for q in range(count):
        to[q] = complex(places[q, 0], places[q, 1])
    near = np.full((4, _NEAREST), -1, np.int64)
    for k in range(4):
        far = np.full(_NEAREST, model.corner_reach * reach)
        for q in range(count):
            away, to_put = abs(to[q] - at[k]), q
            for i in range(_NEAREST):  # insert it in order
                if away < far[i]:
                    away, far[i] = far[i], away
                    to_put, near[k, i] = near[k, i], to_put
    best, least, chosen = np.full(4, -1, np.int64), np.inf, np.empty(4, np.int64)
    for number in range((_NEAREST + 1) ** 4):
        rest, visible, possible = number, 0, True
        for k in range(4):
            i = rest % (_NEAREST + 1) - 1
            chosen[k] = near[k, i] if i >= 0 else -1
            possible = possible and (i < 0 or chosen[k] >= 0)
            rest //= _NEAREST + 1
            visible += chosen[k] >= 0
        if not possible or visible < 2:
            continue
        cost = _cost_of_corners(chosen, visible, at, to, arcs, whole, sides, tolerance, reach, spread, model)
        if cost < least:
            least = cost
            for k in range(4):
                best[k] = chosen[k]
    return best


@compiled
def _cost_of_corners(
    chosen: Indices, visible: int, at: Complexes, to: Complexes, arcs: Array, whole: float, sides: Array,
    tolerance: Array, reach: float, spread: float, model: Any,
) -> float:  # fmt: skip
    """Return what a choice of corners costs, nats, infinity if they are not in order; see ``assign_corners``."""
    before = after = product = complex(0, 0)
    around, square, cost, last = 0.0, 1e-18, model.cost_of_hiding * (4 - visible), -1
    for k in range(4):
        if chosen[k] >= 0:
            before, after, last = before + at[k] / visible, after + to[chosen[k]] / visible, k
    for k in range(4):
        if chosen[k] < 0:
            continue
        product += (at[k] - before).conjugate() * (to[chosen[k]] - after)
        square += abs(at[k] - before) ** 2
        gap = (arcs[chosen[k]] - arcs[chosen[last]]) % whole
        around += gap
        if gap <= 0:
            return np.inf
        if (last + 1) % 4 == k:
            off = (gap - sides[last]) / tolerance[last]
            cost += min(off**2 / 2, model.cost_of_detour if off > 0 else np.inf)
        last = k
    product /= square
    if around > _AROUND * whole or product == 0:
        return np.inf
    for k in range(4):
        if chosen[k] >= 0:
            cost += (abs(to[chosen[k]] - after - product * (at[k] - before)) / (spread * reach)) ** 2 / 2
    cost += (abs(after - before) / (model.shift_spread * reach)) ** 2 / 2
    return float(cost + (math.log(abs(product)) / model.scale_spread) ** 2 / 2)


@compiled
def compare_sheet(
    border: Array, known: Array, sides: Array, tolerance: Array, metric: bool, buckled: bool, model: Any
) -> tuple[int, int]:
    """Return what of a sheet's border does not fit to what is known of it: a code, and the side.

    Args:
        border: ``(96, D)`` as it lies, in the unit of the next three.
        known: ``(96, D)`` as it was, wherever it lay.
        sides: ``(4,)`` known lengths.
        tolerance: ``(4,)`` by how much they may be off.
        metric: Whether the unit is a metre, not a pixel.
        buckled: Whether sides may be shorter, since nothing lies over them that could hide a part.
        model: The constants, one ``LatticeModel``.
    """
    if not metric:
        turned, side_cut, corner_cut = False, math.cos(model.cut_turn[0]), math.cos(model.cut_turn[1])
        for p in range(4 * SIDE):
            near = abs((p + SIDE // 2) % SIDE - SIDE // 2) <= _CHORD
            more = _turn(border, p) * _turn(known, p).conjugate()
            turned = turned or more.real <= (corner_cut if near else side_cut) * abs(more)
        if not turned:
            return NO_FAULT, 0
    lengths = side_lengths(border)
    zoom = 1.0 if metric else zoom_of(lengths, sides, model.max_zoom)
    for k in range(4):
        lengths[k] = max(lengths[k] / zoom, sides[k]) if buckled else lengths[k] / zoom
    code, side = compare_sides(lengths, sides, tolerance)
    if code == NO_FAULT and not metric:
        aligned, far = moved_onto(known, known, border, np.ones(len(known), np.bool_), True), 0.0
        for p in range(4 * SIDE):
            far = max(far, (border[p, 0] - aligned[p, 0]) ** 2 + (border[p, 1] - aligned[p, 1]) ** 2)
        if math.sqrt(far) > model.dent[1] + model.dent[0] * sides.mean():
            return ELSEWHERE, 0
    return code, side


@compiled
def compare_sides(lengths: Array, sides: Array, tolerance: Array) -> tuple[int, int]:
    """Return the code and the number of the side whose length is off by most, if that is more than its tolerance.

    Args:
        lengths: ``(4,)``.
        sides: ``(4,)`` known.
        tolerance: ``(4,)`` by how much they may be off.
    """
    side, most = 0, 0.0
    for k in range(4):
        off = (lengths[k] - sides[k]) / tolerance[k]
        if abs(off) > abs(most):
            side, most = k, off
    if abs(most) <= 1:
        return NO_FAULT, 0
    return (SHORTER if most < 0 else LONGER), side


@compiled
def zoom_of(lengths: Array, sides: Array, most: float) -> float:
    """Return by how much all sides have become longer, or ``most``; what hides a part shortens two or three of them."""
    longest = second = 0.0
    for k in range(4):
        longer = lengths[k] / sides[k]
        longest, second = max(longest, longer), max(second, min(longest, longer))
    return min(max(second, 1 - most), 1 + most)


@compiled
def _turn(border: Array, p: int) -> complex:
    """Return the turn of a border ``(96, 2)`` about its p-th point, as a complex number of any length."""
    after, before = (p + _CHORD) % (4 * SIDE), (p - _CHORD) % (4 * SIDE)
    ahead = complex(border[after, 0] - border[p, 0], border[after, 1] - border[p, 1])
    return ahead * complex(border[p, 0] - border[before, 0], border[before, 1] - border[p, 1])


@compiled
def learn_sheet(known: Array, patch: Array, sides: Array, lasted: float, model: Any) -> tuple[Array, Array]:
    """Return what is known of a sheet after a frame in which all of it was seen: its lattice, and its sides ``(4,)``.

    Args:
        known: ``(625, D)`` as it was, wherever it lay: metres or pixels.
        patch: ``(625, D)`` as it lies.
        sides: ``(4,)`` lengths.
        lasted: Seconds for which this frame counts.
        model: The constants, one ``LatticeModel``.
    """
    metric, lengths = known.shape[1] == 3, side_lengths(border_of(patch))
    zoom = 1.0 if metric else zoom_of(lengths, sides, model.max_zoom)
    learnt = learn_sides(lengths, sides * zoom, model.max_stretch[1 if metric else 0] * lasted)
    if metric:
        return patch, learnt
    aligned = moved_onto(known, known, patch, np.ones(len(known), np.bool_), True)
    far, most = _apart(patch, aligned), model.max_stretch[1] * lasted * learnt.mean()
    limit = max(model.outlier * np.median(far[::_SOME].copy()), model.form_noise)
    gain = gain_of(lasted, model.form_memory)
    for p in range(len(patch)):
        share = gain * ((limit / far[p]) ** 4 if far[p] > limit else 1.0)
        for d in range(2):
            aligned[p, d] += min(max(share * (patch[p, d] - aligned[p, d]), -most), most)
    return aligned, learnt


@compiled
def learn_sides(lengths: Array, sides: Array, most: float) -> Array:
    """Return the lengths ``(4,)`` of sides after they were seen, which change by a share ``most`` of them at most."""
    learnt = np.empty(4)
    for k in range(4):
        learnt[k] = sides[k] + min(max(lengths[k] - sides[k], -most * sides[k]), most * sides[k])
    return learnt


@compiled
def rescaled(border: Array, seen: Mask, sides: Array, most: float) -> Array:
    """Return the lengths of all sides in an image, which grow and shrink as those do that are seen from end to end.

    Args:
        border: ``(96, 2)`` as it lies.
        seen: ``(96,)`` whether the outline shows it.
        sides: ``(4,)`` known lengths.
        most: By which share of it a length may change.
    """
    lengths, ratios, count, learnt = side_lengths(border), np.empty(4), 0, sides.copy()
    for k in range(4):
        whole = True
        for i in range(SIDE + 1):
            whole = whole and seen[(SIDE * k + i) % len(seen)]
        if whole:
            ratios[count] = lengths[k] / sides[k]
            count += 1
    for k in range(4 if count > 0 else 0):
        learnt[k] *= min(max(np.median(ratios[:count]), 1 - most), 1 + most)
    return learnt


@compiled
def doubtful_places(known: Array, patch: Array, gap: float, model: Any) -> npt.NDArray[np.bool_]:
    """Return which points of a lattice are not where the known form has them, without depth, ``(625,)``.

    Something may lie over a border there that hides too little to be noticed by the border alone.

    Args:
        known: ``(625, 2)`` pixels, as it was, wherever it lay.
        patch: ``(625, 2)`` as it lies.
        gap: Between two points that are asked for, pixels.
        model: The constants, one ``LatticeModel``.
    """
    share, pixels = model.hidden_place[0], model.hidden_place[1]
    near, out = np.ones(len(patch), np.bool_), np.zeros(len(patch), np.bool_)
    for last in (False, True):
        far = _apart(patch, moved_onto(known, known, patch, near, True))
        if not last and far.max() <= max(share * gap, pixels):
            break
        own = model.outlier * np.median(far[::_SOME].copy())
        limit = max(share * gap, pixels, own) if last else max(own, pixels)
        for p in range(len(patch)):
            near[p], out[p] = far[p] <= limit, far[p] > limit
    return out


@compiled
def _apart(points: Array, others: Array) -> Array:
    """Return ``(P,)`` the distances of ``(P, 2)`` points from as many others."""
    far = np.empty(len(points))
    for p in range(len(points)):
        x, y = points[p, 0] - others[p, 0], points[p, 1] - others[p, 1]
        far[p] = math.sqrt(x * x + y * y)  # several times as fast as ``hypot``
    return far
