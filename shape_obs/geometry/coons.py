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
from shape_obs.geometry.polyline import arc_length, even_points

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

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
_PARALLEL: Final = 0.1  # squared sine of the angle between two sides that meet in no corner


@compiled("(f8[:,::1], f8[::1], i8[::1], f8, f8)")
def coons_patch(rim: Array, turn: Array, corners: Indices, step: float, grain: float) -> tuple[Array, float]:
    """Return the Coons patch between four corners of a rim, and how much the rim turns between them.

    Args:
        rim: ``(400, 2)`` points evenly spaced around the outline.
        turn: ``(400,)`` radians by which it turns about each.
        corners: ``(4,)`` points, clockwise.
        step: Distance between two points.
        grain: What the outline was smoothed over.

    Returns:
        ``(625, 2)`` a lattice of 25 rows and columns, the first along the side from the first corner to the second; and
        by how many radians the rim turns at most, either way, away from the corners.
    """
    places = _corner_places(rim, corners, step, grain)
    skip = max(round(_ROUNDED / 2 * grain / step), 1)
    sides, kink = np.empty((4, FINE, 2)), 0.0
    for k in range(4):
        begin, end = corners[k], corners[(k + 1) % 4]
        _side(rim, begin, end, skip, places, k, sides[k])
        for i in range(TURN_REACH + 1, (end - begin) % RIM - TURN_REACH):
            kink = max(kink, abs(turn[(begin + i) % RIM]))
    out, last = np.empty((FINE * FINE, 2)), FINE - 1
    for row in range(FINE):
        v = row / last
        for d in range(2):
            left, right = sides[3, last - row, d], sides[1, row, d]
            # What top and bottom do not already bring to the left and to the right.
            left -= (1 - v) * sides[0, 0, d] + v * sides[2, last, d]
            right -= (1 - v) * sides[0, last, d] + v * sides[2, 0, d]
            for col in range(FINE):
                u = col / last
                out[row * FINE + col, d] = (
                    (1 - u) * left + u * right + (1 - v) * sides[0, col, d] + v * sides[2, last - col, d]
                )
    return out, float(kink)


@compiled
def _corner_places(rim: Array, corners: Indices, step: float, grain: float) -> Array:
    """Return ``(4, 2)`` where the lines through both sides meet, as near as the smoothed outline's corners allow."""
    first = max(math.ceil(_ROUNDED * grain / step), 1)
    count = max(_LINE, first)
    out = np.empty((4, 2))
    for k in range(4):
        corner = corners[k]
        bu, bv, back_u, back_v = _line(rim, corner, first, count, -1)
        au, av, ahead_u, ahead_v = _line(rim, corner, first, count, 1)
        cosine = back_u * ahead_u + back_v * ahead_v
        sine = 1 - cosine * cosine
        out[k, 0], out[k, 1] = rim[corner, 0], rim[corner, 1]
        if sine < _PARALLEL:
            continue
        along_back = (au - bu) * back_u + (av - bv) * back_v
        along_ahead = (au - bu) * ahead_u + (av - bv) * ahead_v
        s, t = (along_back - cosine * along_ahead) / sine, (cosine * along_back - along_ahead) / sine
        u = (bu + s * back_u + au + t * ahead_u) / 2 - rim[corner, 0]
        v = (bv + s * back_v + av + t * ahead_v) / 2 - rim[corner, 1]
        far = max(math.sqrt(u * u + v * v) / (_OUTSIDE * grain), 1.0)
        out[k, 0] += u / far
        out[k, 1] += v / far
    return out


@compiled
def _line(rim: Array, corner: int, first: int, count: int, way: int) -> tuple[float, float, float, float]:
    """Return the middle and the direction of ``count`` points, from the one ``first`` points away from a corner on."""
    u = v = slope_u = slope_v = 0.0
    for i in range(count):
        p = (corner + way * (first + i)) % RIM
        u += rim[p, 0] / count
        v += rim[p, 1] / count
        at = i - (count - 1) / 2
        slope_u += at * rim[p, 0]
        slope_v += at * rim[p, 1]
    reach = max(math.sqrt(slope_u * slope_u + slope_v * slope_v), 1e-9)
    return u, v, slope_u / reach, slope_v / reach


@compiled
def _side(rim: Array, begin: int, end: int, skip: int, places: Array, k: int, out: Array) -> None:
    """Fill ``(S, 2)`` places evenly spaced along the side from a corner to the next, both corners included."""
    inner = max((end - begin) % RIM - 2 * skip + 1, 0)
    line = np.empty((inner + 2, 2))
    for d in range(2):
        line[0, d], line[inner + 1, d] = places[k, d], places[(k + 1) % 4, d]
    for i in range(inner):
        p = (begin + skip + i) % RIM
        line[i + 1, 0], line[i + 1, 1] = rim[p, 0], rim[p, 1]
    even = even_points(line, arc_length(line), len(out), False)
    for i in range(len(out)):
        out[i, 0], out[i, 1] = even[i, 0], even[i, 1]
