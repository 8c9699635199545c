"""Sheets on Numba: the same as ``numpy_sheet``, loop by loop."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from shape_obs.kernels.interface_outline import (
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
from shape_obs.kernels.numba_outline import REORDERED, closed_arc, even

_STEEP = 0.3  # tangents below it are those of a few terms of a series, to 1e-9


@njit(cache=True, nogil=True)
def _angle(sine: float, cosine: float) -> float:
    """``atan2``, which is slow, without it where the angle is small, as along most of an outline."""
    if abs(sine) > _STEEP * cosine:
        return math.atan2(sine, cosine)
    x = sine / cosine if cosine > 0 else 0.0
    y = x * x
    tail = 1 / 9 - y * (1 / 11 - y * (1 / 13 - y * (1 / 15 - y / 17)))
    return x * (1 - y * (1 / 3 - y * (1 / 5 - y * (1 / 7 - y * tail))))


@njit(cache=True, nogil=True)
def rim(outline: Array) -> tuple[Array, Array, Indices, float, float]:
    """See ``SheetKernels.rim``."""
    arc = closed_arc(outline)
    points = even(outline, arc, 0.0, RIM)
    turn, step = np.empty(RIM), 0.0
    for p in range(RIM):
        ahead, behind = (p + REACH_OF_TURN) % RIM, (p - REACH_OF_TURN) % RIM
        x, y = points[ahead, 0] - points[p, 0], points[ahead, 1] - points[p, 1]
        u, v = points[p, 0] - points[behind, 0], points[p, 1] - points[behind, 1]
        turn[p] = _angle(u * y - v * x, u * x + v * y)
        after = p + 1 if p < RIM - 1 else 0
        step += math.sqrt((points[after, 0] - points[p, 0]) ** 2 + (points[after, 1] - points[p, 1]) ** 2)
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
        peaks[least : count - 1] = peaks[least + 1 : count].copy()
        count -= 1
    return points, turn, peaks[:count].copy(), step / RIM, arc[-1] / len(outline)


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
    first = max(int(math.ceil(ROUNDED * grain / step)), 1)
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
    line[0], line[inner + 1] = places[k], places[(k + 1) % 4]
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
    skip = max(int(round(ROUNDED / 2 * grain / step)), 1)
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
    return out, kink


@njit(cache=True, nogil=True)
def tracked(
    rim: Array, turn: Array, candidates: Indices, step: float, grain: float, nodes: Array
) -> tuple[Array, float]:
    """See ``SheetKernels.tracked``."""
    corners = corners_near(rim, candidates, step, outer_corners(nodes))
    if len(corners):
        return laid(rim, turn, corners, step, grain)
    return np.empty((0, 2)), 0.0


@njit(cache=True, nogil=True, fastmath=REORDERED)
def gauges(lattice: Array) -> tuple[Array, Array]:
    """See ``SheetKernels.gauges``."""
    rows, cols, dimension = lattice.shape
    down, right = np.zeros(rows), np.zeros(cols)
    for r in range(rows):
        for c in range(cols):
            below = beside = 0.0
            for d in range(dimension):
                if r < rows - 1:
                    below += (lattice[r + 1, c, d] - lattice[r, c, d]) ** 2
                if c < cols - 1:
                    beside += (lattice[r, c + 1, d] - lattice[r, c, d]) ** 2
            if r < rows - 1:
                down[r + 1] += math.sqrt(below) / cols
            if c < cols - 1:
                right[c + 1] += math.sqrt(beside) / rows
    for r in range(1, rows):
        down[r] += down[r - 1]
    for c in range(1, cols):
        right[c] += right[c - 1]
    return down, right


@njit(cache=True, nogil=True)
def _spread(gauge: Array, count: int, centers: bool) -> tuple[Indices, Array]:
    """Which rows come before ``count`` places with equal gaps, and by how much the next one counts."""
    before, share = np.empty(count, np.int64), np.empty(count)
    row, last = 0, len(gauge) - 1
    for i in range(count):
        at = gauge[last] * ((i + 0.5) / count if centers else i / (count - 1))
        while row < last - 1 and gauge[row + 1] <= at:
            row += 1
        gap = gauge[row + 1] - gauge[row]
        before[i], share[i] = row, min((at - gauge[row]) / gap, 1.0) if gap > 0 else 0.0
    return before, share


@njit(cache=True, nogil=True)
def sampled(lattice: Array, down: Array, right: Array, rows: int, cols: int, centers: bool) -> Array:
    """See ``SheetKernels.sampled``."""
    row, below = _spread(down, rows, centers)
    col, beside = _spread(right, cols, centers)
    out = np.empty((rows * cols, lattice.shape[2]))
    for r in range(rows):
        for c in range(cols):
            i, j, v, u = row[r], col[c], below[r], beside[c]
            for d in range(lattice.shape[2]):
                upper = (1 - u) * lattice[i, j, d] + u * lattice[i, j + 1, d]
                lower = (1 - u) * lattice[i + 1, j, d] + u * lattice[i + 1, j + 1, d]
                out[r * cols + c, d] = (1 - v) * upper + v * lower
    return out


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
def strayed(nodes: Array, lattice: Array) -> tuple[int, int, float]:
    """See ``SheetKernels.strayed``."""
    expected, corners = outer_corners(nodes), np.empty((4, 2))
    corners[0], corners[1], corners[2], corners[3] = lattice[0, 0], lattice[0, -1], lattice[-1, -1], lattice[-1, 0]
    quarters, least = 0, np.inf
    for turn in range(4):
        square = 0.0
        for k in range(4):
            for d in range(2):
                square += (corners[(k + turn) % 4, d] - expected[k, d]) ** 2
        if square < least:
            quarters, least = turn, square
    past, here = np.empty(4, np.complex128), np.empty(4, np.complex128)
    for k in range(4):
        past[k] = complex(expected[k, 0], expected[k, 1])
        here[k] = complex(corners[(k + quarters) % 4, 0], corners[(k + quarters) % 4, 1])
    middle, reach = here.sum() / 4, 1e-9
    for k in range(4):
        reach = max(reach, abs(here[k] - middle))
    worst, most = 0, -1.0
    for k in range(4):
        before, after = (past.sum() - past[k]) / 3, (here.sum() - here[k]) / 3
        product, spread = 0j, 0.0
        for j in range(4):
            if j != k:
                source = past[j] - before
                product += source.conjugate() * (here[j] - after)
                spread += source.real**2 + source.imag**2
        astray = abs((past[k] - before) * (product / max(spread, 1e-18)) + after - here[k])
        if astray > most:
            worst, most = k, astray
    return quarters, worst, most / reach


@njit(cache=True, nogil=True)
def _at(lattice: Array, k: int, i: int) -> complex:
    """The point ``i`` steps from corner ``k`` on along the border, clockwise."""
    rows, cols = lattice.shape[0], lattice.shape[1]
    if k == 0:
        row, col = 0, i
    elif k == 1:
        row, col = i, cols - 1
    elif k == 2:
        row, col = rows - 1, cols - 1 - i
    else:
        row, col = rows - 1 - i, 0
    return complex(lattice[row, col, 0], lattice[row, col, 1])


@njit(cache=True, nogil=True)
def assessed(lattice: Array) -> tuple[float, float, float, float]:
    """See ``SheetKernels.assessed``."""
    rows, cols = lattice.shape[0], lattice.shape[1]
    angle, winding = 90.0, 0.0
    for k in range(4):
        count, other = (rows, cols) if k % 2 else (cols, rows)
        corner, length = _at(lattice, k, 0), 0.0
        ahead, back = _at(lattice, k, count // 8) - corner, _at(lattice, (k + 3) % 4, other - 1 - other // 8) - corner
        between = ahead * back.conjugate()
        here = math.degrees(abs(math.atan2(between.imag, between.real)))
        if abs(here - 90) > abs(angle - 90):
            angle = here
        last = corner
        for i in range(1, count):
            place = _at(lattice, k, i)
            length += abs(place - last)
            last = place
        winding = max(winding, length / max(abs(last - corner), 1e-9) - 1)
    area = np.empty((rows - 1, cols - 1))
    whole = square = 0.0
    below = above = False
    for r in range(rows - 1):
        for c in range(cols - 1):
            x, y = lattice[r + 1, c + 1, 0] - lattice[r, c, 0], lattice[r + 1, c + 1, 1] - lattice[r, c, 1]
            u, v = lattice[r + 1, c, 0] - lattice[r, c + 1, 0], lattice[r + 1, c, 1] - lattice[r, c + 1, 1]
            area[r, c] = (x * v - y * u) / 2
            below, above = below or area[r, c] < 0, above or area[r, c] > 0
            whole += abs(area[r, c])
    folds = 0.0
    if below and above:
        apart_down = apart_right = 0
        for r in range(rows - 1):
            for c in range(cols - 1):
                apart_down += r > 0 and area[r, c] * area[r - 1, c] < 0
                apart_right += c > 0 and area[r, c] * area[r, c - 1] < 0
        folds = max(apart_down / max((rows - 2) * (cols - 1), 1), apart_right / max((rows - 1) * (cols - 2), 1))
    mean = whole / area.size
    for r in range(rows - 1):
        for c in range(cols - 1):
            square += (abs(area[r, c]) - mean) ** 2
    return angle, folds, winding, math.sqrt(square / area.size) / max(mean, 1e-18)
