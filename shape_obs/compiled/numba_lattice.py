"""Lattices on Numba: spacing, sampling, judging."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from shape_obs.compiled.interface_outline import Array, Indices
from shape_obs.compiled.numba_outline import REORDERED
from shape_obs.compiled.numba_sheet import outer_corners


@njit(cache=True, nogil=True, fastmath=REORDERED)
def gauges(lattice: Array) -> tuple[Array, Array]:
    """See ``SheetKernels.gauges``."""
    rows, cols, dimension = lattice.shape
    down, right = np.zeros(rows), np.zeros(cols)
    for r in range(rows - 1):
        whole = 0.0
        for c in range(cols):
            square = 0.0
            for d in range(dimension):
                square += (lattice[r + 1, c, d] - lattice[r, c, d]) ** 2
            whole += math.sqrt(square)
        down[r + 1] = whole / cols
    for r in range(rows):
        for c in range(cols - 1):
            square = 0.0
            for d in range(dimension):
                square += (lattice[r, c + 1, d] - lattice[r, c, d]) ** 2
            right[c + 1] += math.sqrt(square) / rows
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
def strayed(nodes: Array, lattice: Array) -> tuple[int, int, float]:
    """See ``SheetKernels.strayed``."""
    expected, corners = outer_corners(nodes), np.empty((4, 2))
    for d in range(2):
        corners[0, d], corners[1, d] = lattice[0, 0, d], lattice[0, -1, d]
        corners[2, d], corners[3, d] = lattice[-1, -1, d], lattice[-1, 0, d]
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
        ahead, back = (
            _at(lattice, k, max(count // 8, 1)) - corner,
            _at(lattice, (k + 3) % 4, other - 1 - max(other // 8, 1)) - corner,
        )
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
