"""Put back the hidden part of a sheet's border.

What is seen of the border is found by its length along the outline from the visible corners; the known border is laid
over it (S. Umeyama, "Least-Squares Estimation of Transformation Parameters Between Two Point Patterns", 1991) and goes
on where it is hidden. With depth, an outline next to which something nearer is seen is that of what hides the object.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.frame import DepthImages
from shape_obs.geometry.coons import AROUND, FINE, SIDE, TURN_REACH
from shape_obs.geometry.polyline import arc_length, closed, interpolate
from shape_obs.geometry.rotation import moved_onto
from shape_obs.image.connected_runs import nearest_pixel
from shape_obs.image.over_under import depth_at
from shape_obs.initialization.corners import nearest_of
from shape_obs.point_cloud.local_depth import bridged, median_depth
from shape_obs.tracking.scene import Box

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

_OUTSIDE: Final = 1.5  # pixels from an outline to the first place beyond it, whose pixel is not the object's own
_LIES_OVER: Final = 0.3  # of the outline where a corner is hidden: next to so much of it something nearer is seen
_BULGE: Final = 0.5  # of the height of a corner over its fold: the outline lies off the fold by less
_STRAIGHT: Final = 3  # points of a side that give the direction in which it goes on
_WINDOWS: Final = 96  # places along an outline at which depth is read, at least; half as many more at most


@compiled
def complete_border(
    expected: Array, known: Array, outline: Array, space: Array, corners: Indices, cut: Mask, kinks: Array,
    sides: Array, tolerance: Array, model: Any,
) -> tuple[Array, Mask, Indices]:  # fmt: skip
    """Return the whole border of a sheet of which a part is seen.

    Args:
        expected: ``(96, 2)`` pixels, the border where it is predicted, 24 points to a side.
        known: ``(96, D)`` the border as it was, wherever it lay.
        outline: ``(400, 2)`` pixels, the outline.
        space: ``(400, D)`` the same, in metres where it is known.
        corners: ``(4,)`` points of the outline; -1 for a hidden one, or for all if none can be matched.
        cut: ``(400,)`` whether something lies over what is behind this point.
        kinks: ``(400,)`` radians by which it turns within the sheet.
        sides: ``(4,)`` the known lengths.
        tolerance: ``(4,)`` by which a length may be off.
        model: The constants, one ``LatticeModel``.

    Returns:
        ``(96, D)``, or ``(0, D)`` if too little is seen; ``(96,)`` whether the outline shows it; ``(Q, 2)`` the first
        and the last point of each piece around a corner that is hidden though nothing lies over it: it is folded.
    """
    trimmed, metric, folded = int(model.trimmed), space.shape[1] == 3, np.empty((4, 2), np.int64)
    found, seen = _followed(expected if metric else known, outline, space, corners, cut, kinks, sides, tolerance, model)
    if np.count_nonzero(seen) < model.min_seen * len(seen):
        return found[:0], seen, folded[:0]
    pattern = _stretched(known, corners, sides)
    points = moved_onto(pattern, pattern, found, seen, not metric)
    misfit, sharp, count, square = np.empty((4 * SIDE + 1, space.shape[1])), np.empty(4 * SIDE + 1), 0, 0.0
    for p in range(4 * SIDE):
        if seen[p] and abs((p + SIDE // 2) % SIDE - SIDE // 2) > trimmed:  # corners are rounded
            sharp[count] = p
            for d in range(space.shape[1]):
                misfit[count, d] = found[p, d] - points[p, d]
                square += misfit[count, d] ** 2
            count += 1
    if count == 0 or math.sqrt(square / count) > model.max_misfit * sides.mean():
        return found[:0], seen, folded[:0]
    at, sharp[count] = np.empty(4 * SIDE), sharp[0] + 4 * SIDE
    for p in range(4 * SIDE):
        at[p] = (p - sharp[0]) % (4 * SIDE) + sharp[0]
    for d in range(space.shape[1]):
        misfit[count, d] = misfit[0, d]
    between, count = interpolate(misfit[: count + 1], sharp[: count + 1], at), 0
    for p in range(4 * SIDE):
        for d in range(space.shape[1]):
            points[p, d] += between[p, d]
    for k in range(4):
        if corners[k] < 0 and metric and _is_folded(points, seen, k, space, cut, sides, tolerance, folded[count]):
            _unfold(points, folded[count, 0], folded[count, 1], k, sides)
            count += 1
    return points, seen, folded[:count]


@compiled
def _followed(
    expected: Array, outline: Array, space: Array, corners: Indices, cut: Mask, kinks: Array, sides: Array,
    tolerance: Array, model: Any,
) -> tuple[Array, Mask]:  # fmt: skip
    """Return where the border is by its length along the outline ``(96, D)``, from each visible corner, and if it is.

    See ``complete_border``.
    """
    metric, around, there, at = space.shape[1] == 3, closed(outline), closed(space), np.empty(FINE)
    arc, places, visible, covered = arc_length(there), np.zeros_like(expected), np.zeros(4 * SIDE, np.bool_), cut.copy()
    for q in range(AROUND):
        near = False  # a corner, where the outline turns too
        for k in range(4):
            near = near or (
                corners[k] >= 0 and abs((q - corners[k] + AROUND // 2) % AROUND - AROUND // 2) <= TURN_REACH
            )
        covered[q] = cut[q] or (not near and kinks[q] > model.fold_turn)
    for k in range(4):
        if corners[k] >= 0:
            visible[SIDE * k] = True
            places[SIDE * k, 0], places[SIDE * k, 1] = outline[corners[k], 0], outline[corners[k], 1]
    placed = moved_onto(expected, expected, places, visible, True)
    found, seen = np.zeros((4 * SIDE, space.shape[1])), np.zeros(4 * SIDE, np.bool_)
    for number in range(8):
        k, way = number // 2, 1 - number % 2 * 2
        side, other = (k, (k + 1) % 4) if way > 0 else ((k - 1) % 4, (k - 1) % 4)
        if corners[k] < 0:
            continue
        length, start = sides[side], arc[corners[k]]
        if corners[other] >= 0:
            between = way * (arc[corners[other]] - start) % arc[AROUND]
            length = between if abs(between - length) < model.own_length * tolerance[side] else length
        for i in range(FINE):
            at[i] = (start + way * length * i / SIDE) % arc[AROUND]
        pixels, points, stop = interpolate(around, arc, at), interpolate(there, arc, at), FINE
        for i in range(FINE):
            p = (SIDE * k + way * i) % (4 * SIDE)
            u, v = placed[p, 0] - placed[SIDE * k, 0], placed[p, 1] - placed[SIDE * k, 1]
            x, y = pixels[i, 0] - pixels[0, 0] - u, pixels[i, 1] - pixels[0, 1] - v
            most = model.border_noise + model.border_bend[1 if metric else 0] * math.sqrt(u * u + v * v)
            q = min(max(np.searchsorted(arc, at[i], side="right"), 1), AROUND) - 1
            if math.sqrt(x * x + y * y) > most or covered[q]:
                stop = max(i - int(model.trimmed), 0)
                break
        for i in range(stop):
            p = (SIDE * k + way * i) % (4 * SIDE)
            seen[p] = True
            for d in range(space.shape[1]):
                found[p, d] = points[i, d]
    return found, seen


@compiled
def _stretched(border: Array, corners: Indices, sides: Array) -> Array:
    """Return a border with its hidden corners out where the known lengths of the sides put them."""
    border = border.copy()
    for k in range(4):
        shift = np.zeros(border.shape[1])
        for way in (1, -1):
            length = 0.0
            for i in range(SIDE):
                p, q = (SIDE * k + way * i) % len(border), (SIDE * k + way * (i + 1)) % len(border)
                length += _distance(border[p], border[q])
            begin, inner = border[SIDE * k], border[(SIDE * k + way * (SIDE // 4)) % len(border)]
            longer = sides[k if way > 0 else (k - 1) % 4] - length
            for d in range(len(shift)):
                shift[d] += longer * (begin[d] - inner[d]) / max(_distance(begin, inner), 1e-9)
        for i in range(1 - SIDE if corners[k] < 0 else SIDE, SIDE):
            for d in range(len(shift)):
                border[(SIDE * k + i) % len(border), d] += (1 - abs(i) / SIDE) * shift[d]
    return border


@compiled
def _distance(a: Array, b: Array) -> float:
    """Return the distance of two points ``(D,)``."""
    square = 0.0
    for d in range(len(a)):
        square += (a[d] - b[d]) ** 2
    return math.sqrt(square)


@compiled
def _flat_place(p: int, sides: Array) -> complex:
    """Return where the p-th point of a border lies while the sheet is a flat rectangle with the mean side lengths."""
    k, share = p // SIDE % 4, p % SIDE / SIDE
    wide, high = (sides[0] + sides[2]) / 2, (sides[1] + sides[3]) / 2
    across = (share, 1.0, 1 - share, 0.0)[k]
    return complex(across * wide, (0.0, share, 1.0, 1 - share)[k] * high)


@compiled
def _is_folded(
    points: Array, seen: Mask, k: int, space: Array, cut: Mask, sides: Array, tolerance: Array, piece: Indices
) -> bool:
    """Return whether a hidden corner is folded; fill the last point seen before it and the first one behind it.

    Nothing lies over a folded corner. The outline runs straight along the fold, and both ends of it lie as far from
    each other as in the flat sheet; those of a side that has buckled come nearer.
    """
    for end in range(2):
        way, p = (-1, 1)[end], SIDE * k + (-1, 1)[end]
        while not seen[p % len(seen)]:
            p += way
            if abs(p - SIDE * k) >= 2 * SIDE:
                return False
        piece[end] = p
    begin, _ = nearest_of(space, range(len(space)), points[piece[0] % len(points)])
    end, _ = nearest_of(space, range(len(space)), points[piece[1] % len(points)])
    length, inner, covered, bulge = max(_distance(space[begin], space[end]), 1e-9), (end - begin) % AROUND, 0, 0.0
    for i in range(inner + 1):
        q, along = (begin + i) % AROUND, 0.0
        covered += cut[q]
        for d in range(3):
            along += (space[q, d] - space[begin, d]) * (space[end, d] - space[begin, d]) / length
        bulge = max(bulge, _distance(space[q], space[begin]) ** 2 - along**2)
    flat, corner = _flat_place(piece[0], sides), _flat_place(SIDE * k, sides)
    fold = _flat_place(piece[1], sides) - flat
    height = abs(((corner - flat) * fold.conjugate()).imag) / max(abs(fold), 1e-9)
    straight = math.sqrt(bulge) < _BULGE * height and abs(length - abs(fold)) < tolerance.max()
    return straight and covered <= _LIES_OVER * (inner + 1)


@compiled
def _unfold(points: Array, first: int, last: int, k: int, sides: Array) -> None:
    """Lay a folded corner flat: its sides go on straight, as long as they are known to be."""
    apex, count = np.zeros(3), len(points)
    for at, way, side in ((first, -1, (k - 1) % 4), (last, 1, k)):
        edge, inner = points[at % count], points[(at + way * _STRAIGHT) % count]
        reach = abs(SIDE * k - at) / SIDE * sides[side] / max(_distance(edge, inner), 1e-9)
        for d in range(3):
            apex[d] += (edge[d] + reach * (edge[d] - inner[d])) / 2
    for at, way in ((first, 1), (last, -1)):
        steps, edge = abs(SIDE * k - at), points[at % count].copy()
        for i in range(1, steps + 1):
            for d in range(3):
                points[(at + way * i) % count, d] = edge[d] + i / steps * (apex[d] - edge[d])


@compiled
def hide_folded(folded: Indices, sides: Array, hidden: Mask) -> None:
    """Mark which points of a lattice ``(625,)`` belong to folded corners, or lie under them.

    The sheet is folded along the chord between the visible ends of its border: what lies there is the mirror image.

    Args:
        folded: ``(Q, 2)`` see ``complete_border``.
        sides: ``(4,)`` lengths.
        hidden: ``(625,)`` is changed.
    """
    wide, high = (sides[0] + sides[2]) / 2, (sides[1] + sides[3]) / 2
    for q in range(len(folded)):
        a, b = _flat_place(folded[q, 0], sides), _flat_place(folded[q, 1], sides)
        tip = _flat_place(round((folded[q, 0] + folded[q, 1]) / 2 / SIDE) * SIDE, sides)
        beyond = ((tip - a) / (b - a)).imag
        for p in range(len(hidden)):
            place = complex(p % FINE / SIDE * wide, p // FINE / SIDE * high)
            along = (place - a) / (b - a)
            if along.imag * beyond < 0:  # where it would lie if it were folded over
                place = a + along.conjugate() * (b - a)
            hidden[p] = hidden[p] or (0 <= place.real <= wide and 0 <= place.imag <= high)


@compiled
def outline_depth(
    depth: DepthImages, edge: Box, mask: npt.NDArray[np.uint8], left: int, top: int, outline: Array, width: float,
    model: Any,
) -> tuple[Array, Mask]:  # fmt: skip
    """Return the depth along an outline, and where the object may go on beyond it.

    Args:
        depth: The frame's, see ``frame.depth_images``; both empty without depth or a camera.
        edge: Left, top, width, height of what is searched: an outline that reaches its edge may be cut there.
        mask: ``(h, w)`` uint8, C-contiguous.
        left: Image column of its first pixel.
        top: Image row of its first pixel.
        outline: ``(P, 2)`` pixels, clockwise as seen.
        width: Of the object, pixels: depth is read within a share of it.
        model: The constants, one ``RingModel`` or ``LatticeModel``.

    Returns:
        ``(P,)`` metres, all NaN if less than half of the outline has depth; ``(P,)`` whether the outline is that of
        something nearer that lies over the object, or of what is searched.
    """
    every = max(len(outline) // _WINDOWS, 1)
    count = -(-len(outline) // every)
    reach = int(min(max(round(width * model.depth_reach), model.min_reach), model.max_reach))
    z, cut, flags = np.full(len(outline), np.nan), np.zeros(len(outline), np.bool_), np.zeros(count, np.bool_)
    some, under = np.empty((count, 2)), np.zeros(count)
    for k in range(count):
        u, v = outline[k * every, 0], outline[k * every, 1]
        inside = edge[0] + model.at_edge < u < edge[0] + edge[2] - 1 - model.at_edge
        flags[k] = not (inside and edge[1] + model.at_edge < v < edge[1] + edge[3] - 1 - model.at_edge)
        some[k, 0], some[k, 1] = u, v
    if len(depth[0]) > 0 or len(depth[1]) > 0:
        under, _ = median_depth(depth, mask, left, top, some, reach, model.min_depth, True)
    if bridged(under):
        for k in range(count):
            before, after = some[k - 1], some[(k + 1) % count]
            flags[k] = flags[k] or _is_covered(
                depth, mask, left, top, some[k], before, after, under[k], model.nearer, int(model.edge_reach)
            )
            near, far = 1 / under[k], 1 / under[(k + 1) % count]
            between = min(every, len(outline) - k * every)
            for i in range(between):
                z[k * every + i] = 1 / (near + (far - near) * i / between)
    for k in range(count):
        if flags[k] and (flags[k - 1] or flags[(k + 1) % count]):  # a single one is noise
            for i in range(-every // 2, every // 2 + 1):
                cut[(k * every + i) % len(outline)] = True
    return z, cut


@compiled
def _is_covered(
    depth: DepthImages, mask: npt.NDArray[np.uint8], left: int, top: int, at: Array, before: Array, after: Array,
    z: float, nearer: float, steps: int,
) -> bool:  # fmt: skip
    """Return whether the first depth that is seen outside of an outline is nearer than the object, at depth z.

    So many steps of a pixel are looked at from a point outwards, across the line between its two neighbours.
    """
    u, v = after[0] - before[0], after[1] - before[1]
    reach = max((u * u + v * v) ** 0.5, 1e-9)
    for step in range(steps):
        x, y = (step + _OUTSIDE) * (v / reach), -(step + _OUTSIDE) * (u / reach)
        column, row = nearest_pixel(at[0] + x) - left, nearest_pixel(at[1] + y) - top
        inside = 0 <= row < mask.shape[0] and 0 <= column < mask.shape[1] and mask[row, column] != 0
        metres = 0.0 if inside else depth_at(depth, at[0] + x, at[1] + y)
        if metres == 0:
            continue
        across = depth_at(depth, at[0] - x, at[1] - y)  # the object's own, so far inside: a tilted table goes on so
        if across > 0 and 2 / z > 1 / across:
            z = min(z, 1 / (2 / z - 1 / across))
        if abs(metres - z) > nearer:
            return metres < z
    return False
