"""Sheets on Numba: the same as ``numpy_sheet``, loop by loop."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from shape_obs.compiled.interface_outline import (
    CANDIDATES,
    FINE,
    LEAST_TURN,
    LINE,
    NEAR,
    OUTSIDE,
    PARALLEL,
    REACH_OF_TURN,
    RIM,
    ROUNDED,
    Array,
    Indices,
)
from shape_obs.compiled.numba_outline import closed_arc, even

_STEEP = 0.3  # the angle of a smaller tangent is a series of a few terms, to 1e-9


@njit(cache=True, nogil=True)
def _turns(points: Array) -> Array:
    """(400,) radians by which a rim turns about each of its points."""
    u, v = np.empty(RIM + 2 * REACH_OF_TURN), np.empty(RIM + 2 * REACH_OF_TURN)
    for p in range(len(u)):
        at = (p - REACH_OF_TURN) % RIM
        u[p], v[p] = points[at, 0], points[at, 1]
    sine, cosine, turn = np.empty(RIM), np.empty(RIM), np.empty(RIM)
    for p in range(RIM):
        x, y = u[p + 2 * REACH_OF_TURN] - u[p + REACH_OF_TURN], v[p + 2 * REACH_OF_TURN] - v[p + REACH_OF_TURN]
        back_x, back_y = u[p + REACH_OF_TURN] - u[p], v[p + REACH_OF_TURN] - v[p]
        sine[p], cosine[p] = back_x * y - back_y * x, back_x * x + back_y * y
        tangent = sine[p] / cosine[p] if cosine[p] > 0 else 0.0
        square = tangent * tangent
        tail = 1 / 9 - square * (1 / 11 - square * (1 / 13 - square * (1 / 15 - square / 17)))
        turn[p] = tangent * (1 - square * (1 / 3 - square * (1 / 5 - square * (1 / 7 - square * tail))))
    for p in range(RIM):
        if abs(sine[p]) > _STEEP * cosine[p]:
            turn[p] = math.atan2(sine[p], cosine[p])  # which is slow
    return turn


@njit(cache=True, nogil=True)
def _candidates(turn: Array) -> Indices:
    """(Q,) the points where a rim turns most, in order."""
    peaks, count = np.empty(RIM, np.int64), 0
    for p in range(RIM):
        if turn[p] > LEAST_TURN:
            highest = True
            for i in range(1, REACH_OF_TURN + 1):
                if turn[(p + i) % RIM] > turn[p] or turn[(p - i) % RIM] > turn[p]:
                    highest = False
                    break
            if highest:
                peaks[count] = p
                count += 1
    while count > CANDIDATES:
        least = 0
        for q in range(1, count):
            if turn[peaks[q]] <= turn[peaks[least]]:
                least = q
        for q in range(least, count - 1):
            peaks[q] = peaks[q + 1]
        count -= 1
    return peaks[:count].copy()


@njit(cache=True, nogil=True)
def rim(outline: Array) -> tuple[Array, Array, Indices, float, float]:
    """See ``SheetKernels.rim``."""
    arc = closed_arc(outline)
    points = even(outline, arc, 0.0, RIM)
    turn = _turns(points)
    step = closed_arc(points)[RIM] / RIM
    return points, turn, _candidates(turn), step, arc[-1] / len(outline)


@njit(cache=True, nogil=True)
def corners_near(rim: Array, candidates: Indices, step: float, expected: Array) -> Indices:
    """See ``SheetKernels.corners_near``."""
    dimension = rim.shape[1]
    found = np.empty(4, np.int64)
    for k in range(4):
        least = np.inf
        for p in range(RIM):
            square = 0.0
            for d in range(dimension):
                square += (rim[p, d] - expected[k, d]) ** 2
            if square < least:
                least = square
                found[k] = p
        near, corner = np.inf, -1
        for q in range(len(candidates)):
            square = 0.0
            for d in range(dimension):
                square += (rim[candidates[q], d] - expected[k, d]) ** 2
            if square < near:
                near, corner = square, candidates[q]
        if corner >= 0 and math.sqrt(near) < max(NEAR * step, 2 * math.sqrt(least)):
            found[k] = corner
    around = 0
    for k in range(4):
        gap = (found[(k + 1) % 4] - found[k]) % RIM
        if gap <= 1:
            return found[:0]
        around += gap
    return found if around == RIM else found[:0]


@njit(cache=True, nogil=True)
def _line(rim: Array, corner: int, first: int, count: int, way: int) -> tuple[float, float, float, float]:
    """The middle and the direction of ``count`` points from the one ``first`` beside a corner on."""
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


@njit(cache=True, nogil=True)
def _places(rim: Array, corners: Indices, step: float, grain: float) -> Array:
    """(4,2) where the lines through both sides meet, as near as the corners of the smoothed outline allow."""
    first = max(math.ceil(ROUNDED * grain / step), 1)
    count = max(LINE, first)
    out = np.empty((4, 2))
    for k in range(4):
        corner = corners[k]
        bu, bv, back_u, back_v = _line(rim, corner, first, count, -1)
        au, av, ahead_u, ahead_v = _line(rim, corner, first, count, 1)
        cosine = back_u * ahead_u + back_v * ahead_v
        sine = 1 - cosine * cosine
        out[k, 0], out[k, 1] = rim[corner, 0], rim[corner, 1]
        if sine < PARALLEL:
            continue
        along_back = (au - bu) * back_u + (av - bv) * back_v
        along_ahead = (au - bu) * ahead_u + (av - bv) * ahead_v
        s, t = (along_back - cosine * along_ahead) / sine, (cosine * along_back - along_ahead) / sine
        u = (bu + s * back_u + au + t * ahead_u) / 2 - rim[corner, 0]
        v = (bv + s * back_v + av + t * ahead_v) / 2 - rim[corner, 1]
        far = max(math.sqrt(u * u + v * v) / (OUTSIDE * grain), 1.0)
        out[k, 0] += u / far
        out[k, 1] += v / far
    return out


@njit(cache=True, nogil=True)
def _side(rim: Array, begin: int, end: int, skip: int, places: Array, k: int, out: Array) -> None:
    """Fill in (S,2) places evenly spaced along the side from a corner to the next, the corners' own among them."""
    inner = max((end - begin) % RIM - 2 * skip + 1, 0)
    line, arc = np.empty((inner + 2, 2)), np.zeros(inner + 2)
    for d in range(2):
        line[0, d], line[inner + 1, d] = places[k, d], places[(k + 1) % 4, d]
    for i in range(inner):
        p = (begin + skip + i) % RIM
        line[i + 1, 0], line[i + 1, 1] = rim[p, 0], rim[p, 1]
    for i in range(inner + 1):
        u, v = line[i + 1, 0] - line[i, 0], line[i + 1, 1] - line[i, 1]
        arc[i + 1] = arc[i] + math.sqrt(u * u + v * v)
    count, before = len(out), 0
    for i in range(count):
        at = arc[-1] * i / (count - 1)
        while before < inner and arc[before + 1] <= at:
            before += 1
        gap = arc[before + 1] - arc[before]
        share = min((at - arc[before]) / gap, 1.0) if gap > 0 else 0.0
        for d in range(2):
            out[i, d] = line[before, d] + share * (line[before + 1, d] - line[before, d])


@njit(cache=True, nogil=True)
def laid(rim: Array, turn: Array, corners: Indices, step: float, grain: float) -> tuple[Array, float]:
    """See ``SheetKernels.laid``."""
    places = _places(rim, corners, step, grain)
    skip = max(round(ROUNDED / 2 * grain / step), 1)
    sides, kink = np.empty((4, FINE, 2)), 0.0
    for k in range(4):
        begin, end = corners[k], corners[(k + 1) % 4]
        _side(rim, begin, end, skip, places, k, sides[k])
        for i in range(REACH_OF_TURN + 1, (end - begin) % RIM - REACH_OF_TURN):
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


@njit(cache=True, nogil=True)
def outer_corners(nodes: Array) -> Array:
    """See ``SheetKernels.outer_corners``."""
    rows, cols, dimension = nodes.shape
    out = np.empty((4, dimension))
    for k in range(4):
        r, c = rows - 1 if k >= 2 else 0, cols - 1 if k in (1, 2) else 0
        beneath, beside = r - 1 if r else 1, c - 1 if c else 1
        for d in range(dimension):
            out[k, d] = 2 * nodes[r, c, d] - (nodes[r, beside, d] + nodes[beneath, c, d]) / 2
    return out


@njit(cache=True, nogil=True)
def tracked(
    rim: Array, turn: Array, candidates: Indices, step: float, grain: float, nodes: Array
) -> tuple[Array, float]:
    """See ``SheetKernels.tracked``."""
    corners = corners_near(rim, candidates, step, outer_corners(nodes))
    if len(corners):
        return laid(rim, turn, corners, step, grain)
    return np.empty((0, 2)), 0.0
