"""The Coons patch of a sheet: a lattice between four corners of its outline.

Reference:
    S. A. Coons, "Surfaces for Computer-Aided Design of Space Forms", MIT Project MAC TR-41, 1967: the bilinearly
    blended patch between four boundary curves.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.polyline import arc_length, closed, even_points

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

RIM: Final = 400  # points around a sheet's outline
TURN_REACH: Final = 16  # points on either side: the scale at which a turn is a corner, 4 % of the perimeter
FINE: Final = 25  # rows and columns of a patch: between them it is taken to be bilinear, 0.1 px off
# The smoothing of the outline has rounded its corners: so many of the outline's own steps to either side are left
# out, and a corner is looked for no farther off.
_ROUNDED: Final = 4.0
_OUTSIDE: Final = 2.5
# Points of the lines that are intersected at a corner: longer ones would cut across bent sides, shorter ones follow the
# noise. 0.4 px off at the median of drawn sheets; the strongest turn itself is 1.4 px off.
_LINE: Final = 6
SIDE: Final = FINE - 1  # points of a border from a corner to the next, which is not counted
_INDEX: Final = np.arange(FINE * FINE).reshape(FINE, FINE)
_BORDER: Final = np.concatenate([_INDEX[0, :-1], _INDEX[:-1, -1], _INDEX[-1, :0:-1], _INDEX[:0:-1, 0]])
_LIES_OVER: Final = 0.3  # of the outline where a corner is hidden: next to so much of it something nearer is seen
_BULGE: Final = 0.3  # of the length of a fold: the outline lies off it by less
_STRAIGHT: Final = 3  # points of a side that give the direction in which it goes on
_PARALLEL: Final = 0.1  # squared sine of the angle between two sides that meet in no corner


@compiled("(f8[:,::1], f8[::1], i8[::1], f8, f8)")
def coons_patch(rim: Array, turn: Array, corners: Indices, step: float, grain: float) -> tuple[Array, float]:
    """Return the Coons patch between four corners of a rim, and how much the rim turns between them.

    Args:
        rim: ``(400, D)`` points around the outline, in pixels or in metres, evenly spaced in the image or the map.
        turn: ``(400,)`` radians by which it turns about each.
        corners: ``(4,)`` points, clockwise.
        step: Distance between two points in the image or the map.
        grain: What the outline was smoothed over, in the unit of ``step``.

    Returns:
        ``(625, D)`` a lattice of 25 rows and columns, the first along the side from the first corner to the second; and
        by how many radians the rim turns at most, either way, away from the corners.
    """
    places = _corner_places(rim, corners, step, grain)
    skip = max(round(_ROUNDED / 2 * grain / step), 1)
    sides, kink = np.empty((4, FINE, rim.shape[1])), 0.0
    for k in range(4):
        begin, end = corners[k], corners[(k + 1) % 4]
        _side(rim, begin, end, skip, places, k, sides[k])
        for i in range(TURN_REACH + 1, (end - begin) % RIM - TURN_REACH):
            kink = max(kink, abs(turn[(begin + i) % RIM]))
    return blend_sides(sides), float(kink)


@compiled("(f8[:,:,::1],)")
def blend_sides(sides: Array) -> Array:
    """Return the Coons patch ``(625, D)`` of four sides ``(4, 25, D)``, each from a corner to the next, clockwise."""
    last = FINE - 1
    out = np.empty((FINE * FINE, sides.shape[2]))
    for row in range(FINE):
        v = row / last
        for d in range(sides.shape[2]):
            left, right = sides[3, last - row, d], sides[1, row, d]
            # What top and bottom do not already bring to the left and to the right.
            left -= (1 - v) * sides[0, 0, d] + v * sides[2, last, d]
            right -= (1 - v) * sides[0, last, d] + v * sides[2, 0, d]
            for col in range(FINE):
                u = col / last
                out[row * FINE + col, d] = (
                    (1 - u) * left + u * right + (1 - v) * sides[0, col, d] + v * sides[2, last - col, d]
                )
    return out


@compiled
def _corner_places(rim: Array, corners: Indices, step: float, grain: float) -> Array:
    """Return ``(4, D)`` where the lines through both sides meet, as near as the smoothed outline's corners allow.

    In space they pass each other, and the corner lies in the middle between them.
    """
    first = max(math.ceil(_ROUNDED * grain / step), 1)
    count = max(_LINE, first)
    dimension = rim.shape[1]
    farthest = _OUTSIDE * grain * arc_length(closed(rim))[RIM] / (RIM * step)
    out = np.empty((4, dimension))
    for k in range(4):
        corner = corners[k]
        back, back_way = _line(rim, corner, first, count, -1)
        ahead, ahead_way = _line(rim, corner, first, count, 1)
        cosine = along_back = along_ahead = square = 0.0
        for d in range(dimension):
            out[k, d] = rim[corner, d]
            cosine += back_way[d] * ahead_way[d]
            along_back += (ahead[d] - back[d]) * back_way[d]
            along_ahead += (ahead[d] - back[d]) * ahead_way[d]
        sine = 1 - cosine * cosine
        if sine < _PARALLEL:
            continue
        s, t = (along_back - cosine * along_ahead) / sine, (cosine * along_back - along_ahead) / sine
        for d in range(dimension):
            back[d] = (back[d] + s * back_way[d] + ahead[d] + t * ahead_way[d]) / 2 - rim[corner, d]
            square += back[d] * back[d]
        far = max(math.sqrt(square) / farthest, 1.0)
        for d in range(dimension):
            out[k, d] += back[d] / far
    return out


@compiled
def _line(rim: Array, corner: int, first: int, count: int, way: int) -> tuple[Array, Array]:
    """Return the middle and the direction of ``count`` points, from the one ``first`` points away from a corner on."""
    middle, slope, square = np.zeros(rim.shape[1]), np.zeros(rim.shape[1]), 0.0
    for i in range(count):
        p = (corner + way * (first + i)) % RIM
        at = i - (count - 1) / 2
        for d in range(rim.shape[1]):
            middle[d] += rim[p, d] / count
            slope[d] += at * rim[p, d]
    for d in range(rim.shape[1]):
        square += slope[d] * slope[d]
    reach = max(math.sqrt(square), 1e-12)
    for d in range(rim.shape[1]):
        slope[d] /= reach
    return middle, slope


@compiled
def _side(rim: Array, begin: int, end: int, skip: int, places: Array, k: int, out: Array) -> None:
    """Fill ``(S, D)`` places evenly spaced along the side from a corner to the next, both corners included."""
    inner = max((end - begin) % RIM - 2 * skip + 1, 0)
    dimension = rim.shape[1]
    line = np.empty((inner + 2, dimension))
    for d in range(dimension):
        line[0, d], line[inner + 1, d] = places[k, d], places[(k + 1) % 4, d]
    for i in range(inner):
        p = (begin + skip + i) % RIM
        for d in range(dimension):
            line[i + 1, d] = rim[p, d]
    even = even_points(line, arc_length(line), len(out), False)
    for i in range(len(out)):
        for d in range(dimension):
            out[i, d] = even[i, d]


@compiled("(f8[:,::1],)")
def border_of(lattice: Array) -> Array:
    """Return the border of a lattice of 25 rows and columns, ``(625, D)``, clockwise from its first corner."""
    out = np.empty((4 * SIDE, lattice.shape[1]))
    for p in range(4 * SIDE):
        for d in range(lattice.shape[1]):
            out[p, d] = lattice[_BORDER[p], d]
    return out


@compiled("(f8[:,::1],)")
def side_lengths(border: Array) -> Array:
    """Return ``(4,)`` the lengths of the sides of a border ``(96, D)``."""
    lengths = np.zeros(4)
    for p in range(4 * SIDE):
        square = 0.0
        for d in range(border.shape[1]):
            square += (border[(p + 1) % (4 * SIDE), d] - border[p, d]) ** 2
        lengths[p // SIDE] += math.sqrt(square)
    return lengths


def stretched(border: Array, hidden: list[int], sides: Array) -> Array:
    """Return a border with its hidden corners out where the known lengths of the sides put them."""
    border, share = border.copy(), np.arange(SIDE, 0, -1)[:, None] / SIDE
    for k in hidden:
        at, shift = SIDE * k, np.zeros(border.shape[1])
        for way, side in ((1, k), (-1, (k - 1) % 4)):
            points = border[(at + way * np.arange(SIDE + 1)) % (4 * SIDE)]
            length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
            begin = points[0] - points[SIDE // 4]
            shift += (sides[side] - length) * begin / max(float(np.linalg.norm(begin)), 1e-9)
        for way in (1, -1):
            border[(at + way * np.arange(1, SIDE)) % (4 * SIDE)] += share[1:] * shift
        border[at] += shift
    return border


def beneath_fold(folded: tuple[tuple[int, int], ...], sides: Array) -> npt.NDArray[np.bool_]:
    """Return which points of a lattice ``(625,)`` belong to a folded corner, or lie under it.

    The sheet is folded along the chord between the visible ends of its border: what lies there is the mirror image.

    Args:
        folded: First and last point of each hidden piece of the border, see ``border_of``.
        sides: ``(4,)`` lengths.
    """
    lattice = _flat_lattice(sides)
    outer = _BORDER
    hidden = np.zeros(len(lattice), bool)
    for first, last in folded:
        a, b = lattice[outer[first % len(outer)]], lattice[outer[last % len(outer)]]
        apex = lattice[outer[round((first + last) / 2 / SIDE) * SIDE % len(outer)]]
        for tip in (apex, apex - 2 * _off_line(apex[None], a, b)[0]):
            sides_of = [_turn(lattice, p, q) for p, q in ((a, b), (b, tip), (tip, a))]
            inside = np.all([way >= 0 for way in sides_of], axis=0) | np.all([way <= 0 for way in sides_of], axis=0)
            hidden |= inside
    return hidden


def flat_border(sides: Array) -> Array:
    """Return ``(96, 2)`` the border of a rectangle with the mean lengths of ``(4,)`` sides, from its first corner."""
    return border_of(np.ascontiguousarray(_flat_lattice(sides)))


def _flat_lattice(sides: Array) -> Array:
    width, height = (sides[0] + sides[2]) / 2, (sides[1] + sides[3]) / 2
    v, u = np.divmod(np.arange(FINE * FINE), FINE)
    return np.stack([u * width, v * height], axis=1) / (FINE - 1)


def _off_line(points: Array, a: Array, b: Array) -> Array:
    """Return ``(P, 2)`` from the line through two points to each of some others."""
    way = (b - a) / max(float(np.linalg.norm(b - a)), 1e-12)
    away = points - a
    return away - (away @ way)[:, None] * way


def _turn(points: Array, a: Array, b: Array) -> Array:
    """Return ``(P,)`` twice the area of the triangles of two points and each of some others, with its sign."""
    return (b[0] - a[0]) * (points[:, 1] - a[1]) - (b[1] - a[1]) * (points[:, 0] - a[0])


def folded_piece(
    points: Array, seen: Mask, k: int, space: Array, cut: Mask, sides: Array, slack: Array
) -> tuple[int, int] | None:
    """Return the last point seen before a folded corner and the first one behind it; None if it is not folded.

    Nothing lies over a folded corner. The outline runs straight along the fold, and both ends of it lie as far from
    each other as in the flat sheet; those of a side that has buckled come nearer.
    """
    away = np.arange(1, 2 * SIDE)
    before, behind = seen[(SIDE * k - away) % len(seen)], seen[(SIDE * k + away) % len(seen)]
    if not (before.any() and behind.any()):
        return None
    first, last = SIDE * k - 1 - int(np.argmax(before)), SIDE * k + 1 + int(np.argmax(behind))
    begin, end = (int(np.argmin(((space - points[p % len(points)]) ** 2).sum(axis=1))) for p in (first, last))
    between = (begin + np.arange((end - begin) % len(cut) + 1)) % len(cut)
    flat = flat_border(sides)
    material = float(np.linalg.norm(flat[last % len(flat)] - flat[first % len(flat)]))
    chord, away = space[end] - space[begin], space[between] - space[begin]
    length = max(float(np.linalg.norm(chord)), 1e-9)
    bulge = np.linalg.norm(away - (away @ chord)[:, None] / length**2 * chord, axis=1).max()
    straight = bulge < _BULGE * length and abs(length - material) < slack.max()
    return (first, last) if straight and cut[between].mean() <= _LIES_OVER else None


def unfold(points: Array, first: int, last: int, corner: int, sides: Array) -> None:
    """Lay a folded corner flat: its sides go on straight, as long as they are known to be."""
    count, places = len(points), []
    for at, way, side in ((first, -1, corner // SIDE - 1), (last, 1, corner // SIDE)):
        ahead = points[at % count] - points[(at + way * _STRAIGHT) % count]
        length = abs(corner - at) / SIDE * sides[side]
        places.append(points[at % count] + length / max(float(np.linalg.norm(ahead)), 1e-9) * ahead)
    apex = (places[0] + places[1]) / 2
    for at in (first, last):
        share = np.arange(1, abs(corner - at) + 1)[:, None] / abs(corner - at)
        index = (at + np.sign(corner - at) * np.arange(1, abs(corner - at) + 1)) % count
        points[index] = points[at % count] + share * (apex - points[at % count])
