"""The Coons patch of a sheet: a lattice between four corners of its outline.

Reference:
    S. A. Coons, "Surfaces for Computer-Aided Design of Space Forms", MIT Project MAC TR-41, 1967: the bilinearly
    blended patch between four boundary curves.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.polyline import arc_length, closed, even_points

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

AROUND: Final = 400  # points around a sheet's outline
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
_PARALLEL: Final = 0.1  # squared sine of the angle between two sides that meet in no corner


class SheetOutline(NamedTuple):
    """The closed outline of a sheet, 400 points evenly spaced, clockwise as seen.

    Args:
        points: ``(400, 2)`` in an image, or unrolled into a plane.
        turn: ``(400,)`` radians by which the outline turns about each point, positive where it is convex.
        candidates: ``(Q,)`` the points where it turns most, in order, at most ten.
        step: Distance between two points.
        grain: What the outline was smoothed over: the steps it was traced in.
    """

    points: Array
    turn: Array
    candidates: Indices
    step: float
    grain: float


@compiled
def coons_patch(outline: Any, space: Array, corners: Indices) -> tuple[Array, float]:
    """Return the Coons patch between four corners of an outline, and how much the outline turns between them.

    Args:
        outline: A ``SheetOutline``.
        space: ``(400, D)`` its points where the patch lies: in metres, or as they are.
        corners: ``(4,)`` points, clockwise.

    Returns:
        ``(625, D)`` a lattice of 25 rows and columns, the first along the side from the first corner to the second; and
        by how many degrees the outline turns at most, either way, away from the corners.
    """
    places = _corner_places(space, corners, outline.step, outline.grain)
    skip = max(round(_ROUNDED / 2 * outline.grain / outline.step), 1)
    sides, kink = np.empty((4, FINE, space.shape[1])), 0.0
    for k in range(4):
        begin, end = corners[k], corners[(k + 1) % 4]
        _side(space, begin, end, skip, places, k, sides[k])
        for i in range(TURN_REACH + 1, (end - begin) % AROUND - TURN_REACH):
            kink = max(kink, abs(outline.turn[(begin + i) % AROUND]))
    return blend_sides(sides), math.degrees(kink)


@compiled
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
def _corner_places(outline: Array, corners: Indices, step: float, grain: float) -> Array:
    """Return ``(4, D)`` where the lines through both sides meet, as near as the smoothed outline's corners allow.

    In space they pass each other, and the corner lies in the middle between them.
    """
    first = max(math.ceil(_ROUNDED * grain / step), 1)
    count = max(_LINE, first)
    dimension = outline.shape[1]
    farthest = _OUTSIDE * grain * arc_length(closed(outline))[AROUND] / (AROUND * step)
    out = np.empty((4, dimension))
    for k in range(4):
        corner = corners[k]
        back, back_way = _line(outline, corner, first, count, -1)
        ahead, ahead_way = _line(outline, corner, first, count, 1)
        cosine = along_back = along_ahead = square = 0.0
        for d in range(dimension):
            out[k, d] = outline[corner, d]
            cosine += back_way[d] * ahead_way[d]
            along_back += (ahead[d] - back[d]) * back_way[d]
            along_ahead += (ahead[d] - back[d]) * ahead_way[d]
        sine = 1 - cosine * cosine
        if sine < _PARALLEL:
            continue
        s, t = (along_back - cosine * along_ahead) / sine, (cosine * along_back - along_ahead) / sine
        for d in range(dimension):
            back[d] = (back[d] + s * back_way[d] + ahead[d] + t * ahead_way[d]) / 2 - outline[corner, d]
            square += back[d] * back[d]
        far = max(math.sqrt(square) / farthest, 1.0)
        for d in range(dimension):
            out[k, d] += back[d] / far
    return out


@compiled
def _line(outline: Array, corner: int, first: int, count: int, way: int) -> tuple[Array, Array]:
    """Return the middle and the direction of ``count`` points, from the one ``first`` points away from a corner on."""
    middle, slope, square = np.zeros(outline.shape[1]), np.zeros(outline.shape[1]), 0.0
    for i in range(count):
        p = (corner + way * (first + i)) % AROUND
        at = i - (count - 1) / 2
        for d in range(outline.shape[1]):
            middle[d] += outline[p, d] / count
            slope[d] += at * outline[p, d]
    for d in range(outline.shape[1]):
        square += slope[d] * slope[d]
    reach = max(math.sqrt(square), 1e-12)
    for d in range(outline.shape[1]):
        slope[d] /= reach
    return middle, slope


@compiled
def _side(outline: Array, begin: int, end: int, skip: int, places: Array, k: int, out: Array) -> None:
    """Fill ``(S, D)`` places evenly spaced along the side from a corner to the next, both corners included."""
    inner = max((end - begin) % AROUND - 2 * skip + 1, 0)
    dimension = outline.shape[1]
    line = np.empty((inner + 2, dimension))
    for d in range(dimension):
        line[0, d], line[inner + 1, d] = places[k, d], places[(k + 1) % 4, d]
    for i in range(inner):
        p = (begin + skip + i) % AROUND
        for d in range(dimension):
            line[i + 1, d] = outline[p, d]
    even = even_points(line, arc_length(line), len(out), False)
    for i in range(len(out)):
        for d in range(dimension):
            out[i, d] = even[i, d]


@compiled
def corners_of(nodes: Array) -> Array:
    """Return ``(4, D)`` the corners of a lattice ``(625, D)``, clockwise."""
    corners = np.empty((4, nodes.shape[1]))
    for k in range(4):
        for d in range(nodes.shape[1]):
            corners[k, d] = nodes[(0, FINE - 1, FINE * FINE - 1, FINE * (FINE - 1))[k], d]
    return corners


@compiled
def turned(lattice: Any, quarters: int) -> Any:
    """Return a lattice ``(625, D)`` of numbers or flags that begins ``quarters`` corners further on, clockwise."""
    out = lattice.copy()
    for _ in range(quarters):
        before = out.copy()
        for p in range(len(out)):
            for d in range(out.shape[1]):
                out[p, d] = before[p % FINE * FINE + FINE - 1 - p // FINE, d]
    return out


@compiled
def border_of(lattice: Array) -> Array:
    """Return the border of a lattice of 25 rows and columns, ``(625, D)``, clockwise from its first corner."""
    out = np.empty((4 * SIDE, lattice.shape[1]))
    for p in range(4 * SIDE):
        for d in range(lattice.shape[1]):
            out[p, d] = lattice[_BORDER[p], d]
    return out


@compiled
def sides_of(border: Array) -> Array:
    """Return the sides ``(4, 25, D)`` of a border ``(96, D)``, each from a corner to the next, clockwise."""
    sides = np.empty((4, FINE, border.shape[1]))
    for p in range(len(border)):
        for d in range(border.shape[1]):
            sides[p // SIDE, p % SIDE, d] = border[p, d]
            if p % SIDE == 0:
                sides[p // SIDE - 1, SIDE, d] = border[p, d]
    return sides


@compiled
def side_lengths(border: Array) -> Array:
    """Return ``(4,)`` the lengths of the sides of a border ``(96, D)``."""
    lengths = np.zeros(4)
    for p in range(4 * SIDE):
        square = 0.0
        for d in range(border.shape[1]):
            square += (border[(p + 1) % (4 * SIDE), d] - border[p, d]) ** 2
        lengths[p // SIDE] += math.sqrt(square)
    return lengths
