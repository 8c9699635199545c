"""Sheets on NumPy: the corners of a rim, the patch between them, lattices. Points of the plane are complex numbers."""

from __future__ import annotations

import cmath
import math
from functools import lru_cache

import numpy as np
from scipy.ndimage import maximum_filter1d

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
from shape_obs.compiled.numpy_curve import arc_length
from shape_obs.compiled.numpy_plane import Complex, lengths, plane, points_of

# Where the sides begin and end among the corners: the top and the bottom from the left, the others from the top.
_BEGINS, _ENDS = np.array([[0], [3], [4], [1]]), np.array([[1], [2], [3], [2]])
_RIM_AT = np.arange(RIM)


def rim(outline: Array) -> tuple[Array, Array, Indices, float, float]:
    """See ``SheetKernels.rim``."""
    closed = np.concatenate([outline, outline[:1]])
    arc = arc_length(closed)
    z = np.interp(_RIM_AT * (arc[-1] / RIM), arc, plane(closed))
    around = np.concatenate([z[-REACH_OF_TURN:], z, z[:REACH_OF_TURN]])
    chord = around[REACH_OF_TURN:] - around[:-REACH_OF_TURN]  # from each point to the one that many further on
    turn = chord[REACH_OF_TURN:] * chord[:-REACH_OF_TURN].conj()
    turn = np.arctan2(turn.imag, turn.real)
    highest = maximum_filter1d(turn, 2 * REACH_OF_TURN + 1, mode="wrap")
    peaks = np.flatnonzero((turn >= highest) & (turn > LEAST_TURN))
    if len(peaks) > CANDIDATES:
        peaks = np.sort(peaks[np.argsort(-turn[peaks], kind="stable")][:CANDIDATES])
    step = float(
        np.abs(around[REACH_OF_TURN : 1 - REACH_OF_TURN] - around[REACH_OF_TURN - 1 : -REACH_OF_TURN])[1:].sum()
    )
    return points_of(z), turn, peaks, step / RIM, float(arc[-1]) / len(outline)


def corners_near(rim: Array, candidates: Indices, step: float, expected: Array) -> Indices:
    """See ``SheetKernels.corners_near``."""
    away = lengths(rim - expected[:, None])
    found = np.argmin(away, axis=1)
    if len(candidates):
        nearest = away[[0, 1, 2, 3], found]
        there = away[:, candidates]
        at = np.argmin(there, axis=1)
        near = there[[0, 1, 2, 3], at] < np.maximum(NEAR * step, 2 * nearest)
        found = np.where(near, candidates[at], found)
    first, second, third, fourth = found.tolist()
    gaps = ((second - first) % RIM, (third - second) % RIM, (fourth - third) % RIM, (first - fourth) % RIM)
    return found if sum(gaps) == RIM and min(gaps) > 1 else found[:0]


def laid(rim: Array, turn: Array, corners: Indices, step: float, grain: float) -> tuple[Array, float]:
    """See ``SheetKernels.laid``."""
    z, at = plane(rim), corners.tolist()
    begin = at[0]
    around, turned = np.concatenate([z[begin:], z[:begin]]), np.concatenate([turn[begin:], turn[:begin]])
    at = [(corner - begin) % RIM for corner in at]
    places = _places(around, at, step, grain)
    at.append(RIM)
    skip = max(round(ROUNDED / 2 * grain / step), 1)
    pieces, straight, first = [], [], [0]
    for k in range(4):
        inner = around[at[k] + skip : max(at[k + 1] - skip + 1, at[k] + skip)]
        pieces += [places[k : k + 1], inner]
        first.append(first[-1] + 1 + len(inner))
        straight.append(turned[at[k] + REACH_OF_TURN + 1 : at[k + 1] - REACH_OF_TURN])
    border = np.concatenate([*pieces, places[:1]])
    arc = np.zeros(len(border))
    np.cumsum(np.abs(border[1:] - border[:-1]), out=arc[1:])
    begins, ends = arc[np.array(first)[_BEGINS]], arc[np.array(first)[_ENDS]]
    sides = np.interp(begins + (ends - begins) * _across(FINE)[1].real, arc, border)
    return points_of(coons(sides, FINE).ravel()), float(np.abs(np.concatenate(straight)).max(initial=0.0))


def tracked(
    rim: Array, turn: Array, candidates: Indices, step: float, grain: float, nodes: Array
) -> tuple[Array, float]:
    """See ``SheetKernels.tracked``."""
    corners = corners_near(rim, candidates, step, outer_corners(nodes))
    return laid(rim, turn, corners, step, grain) if len(corners) else (np.zeros((0, 2)), 0.0)


def gauges(lattice: Array) -> tuple[Array, Array]:
    """See ``SheetKernels.gauges``."""
    rows, cols = lattice.shape[:2]
    down, right = np.zeros(rows), np.zeros(cols)
    np.cumsum(lengths(lattice[1:] - lattice[:-1]).sum(axis=1) / cols, out=down[1:])
    np.cumsum(lengths(lattice[:, 1:] - lattice[:, :-1]).sum(axis=0) / rows, out=right[1:])
    return down, right


def sampled(lattice: Array, down: Array, right: Array, rows: int, cols: int, centers: bool) -> Array:
    """See ``SheetKernels.sampled``."""
    v, u = _weights(down, rows, centers), _weights(right, cols, centers)
    across = np.matmul(v, lattice.reshape(len(down), -1)).reshape(rows, len(right), -1)
    return np.matmul(u, across).reshape(rows * cols, -1)


def outer_corners(nodes: Array) -> Array:
    """See ``SheetKernels.outer_corners``."""
    rows, cols, dimension = nodes.shape
    near = nodes.reshape(rows * cols, dimension)[_near_corners(rows, cols)]
    return 2 * near[:4] - (near[4:8] + near[8:]) / 2


def strayed(nodes: Array, lattice: Array) -> tuple[int, int, float]:
    """See ``SheetKernels.strayed``."""
    past: list[complex] = plane(outer_corners(nodes)).tolist()
    z = plane(lattice)
    found = [complex(z[0, 0]), complex(z[0, -1]), complex(z[-1, -1]), complex(z[-1, 0])]
    apart = [sum(abs(found[(k + turn) % 4] - past[k]) ** 2 for k in range(4)) for turn in range(4)]
    quarters = apart.index(min(apart))
    here = found[quarters:] + found[:quarters]
    middle = sum(here) / 4
    reach = max(*(abs(corner - middle) for corner in here), 1e-9)
    astray = []
    for k in range(4):
        before, after = (sum(past) - past[k]) / 3, (sum(here) - here[k]) / 3
        product, spread = 0j, 1e-18
        for j in range(4):
            if j != k:
                source = past[j] - before
                product += source.conjugate() * (here[j] - after)
                spread += abs(source) ** 2
        astray.append(abs((past[k] - before) * product / spread + after - here[k]))
    worst = astray.index(max(astray))
    return quarters, worst, astray[worst] / reach


def assessed(lattice: Array) -> tuple[float, float, float, float]:
    """See ``SheetKernels.assessed``."""
    z = plane(lattice)
    level, upright = z[[0, -1]], z[:, [0, -1]]
    lengths = [*np.abs(level[:, 1:] - level[:, :-1]).sum(axis=1), *np.abs(upright[1:] - upright[:-1]).sum(axis=0)]
    (a, b), (d, c) = level[:, [0, -1]].tolist()
    chords = [abs(b - a), abs(c - d), abs(d - a), abs(c - b)]
    winding = max(length / max(chord, 1e-9) - 1 for length, chord in zip(lengths, chords, strict=True))
    right, below = max(z.shape[1] // 8, 1), max(z.shape[0] // 8, 1)
    beside, beneath = level[:, [right, -1 - right]].tolist(), upright[[below, -1 - below]].tolist()
    angle = 90.0
    for row, column, corner in ((0, 0, a), (0, 1, b), (1, 1, c), (1, 0, d)):
        between = (beside[row][column] - corner) * (beneath[row][column] - corner).conjugate()
        here = abs(math.degrees(cmath.phase(between)))
        if abs(here - 90) > abs(angle - 90):
            angle = here
    across, down = z[1:, 1:] - z[:-1, :-1], z[1:, :-1] - z[:-1, 1:]
    area = (across.conj() * down).imag.ravel() / 2
    folds = 0.0
    if area.min() < 0 < area.max():
        cells = area.reshape(across.shape)
        folds = max(float(np.mean(a * b < 0)) for a, b in ((cells[1:], cells[:-1]), (cells[:, 1:], cells[:, :-1])))
    area = np.abs(area)
    mean = float(area.sum()) / area.size
    uneven = float(np.sqrt(max(float(area @ area) / area.size - mean * mean, 0.0))) / max(mean, 1e-18)
    return angle, folds, winding, uneven


def _places(around: Complex, corners: list[int], step: float, grain: float) -> Complex:
    """(4,) where the lines through both sides meet, as near as the corners of the smoothed outline allow.

    Args:
        around: (400,) the rim from its first corner on.
        corners: Their places on it.
        step: Distance between two points.
        grain: What the outline was smoothed over.
    """
    first = max(math.ceil(ROUNDED * grain / step), 1)
    count = max(LINE, first)
    away = first + _index(count).astype(np.intp)
    lines = around[(np.array(corners)[:, None, None] + np.stack([-away, away])) % RIM]  # (4,2,L)
    middles = (lines.sum(axis=2) / count).tolist()
    slopes = (lines @ (_index(count) - (count - 1) / 2)).tolist()
    places = []
    for corner, (before, after), (back, ahead) in zip(around[corners].tolist(), middles, slopes, strict=True):
        back, ahead = back / max(abs(back), 1e-9), ahead / max(abs(ahead), 1e-9)
        cosine = (back.conjugate() * ahead).real
        sine = 1 - cosine**2
        shift = 0j
        if sine >= PARALLEL:
            apart = after - before
            along_back, along_ahead = (apart * back.conjugate()).real, (apart * ahead.conjugate()).real
            s, t = (along_back - cosine * along_ahead) / sine, (cosine * along_back - along_ahead) / sine
            shift = (before + s * back + after + t * ahead) / 2 - corner
        places.append(corner + shift / max(abs(shift) / (OUTSIDE * grain), 1))
    return np.array(places)


def coons(sides: Complex, count: int) -> Complex:
    """The bilinearly blended patch of four sides (S. A. Coons, "Surfaces for Computer-Aided Design of Space Forms").

    Args:
        sides: (4,S) the top and the bottom side from left to right, the left and the right one from top to bottom.
        count: S.

    Returns:
        (S,S) rows from top to bottom, the sides among them.
    """
    across, level, upright = _across(count), sides[:2], sides[2:]
    # Top and bottom, without what left and right bring to their ends already.
    rest = level - level[:, [0, -1]] @ across
    return upright.T @ across + across.T @ rest


def _weights(gauge: Array, count: int, centers: bool) -> Array:
    """(count,C) by how much each of C rows counts in ``count`` places with equal gaps."""
    place = np.interp(_shares(count, centers) * gauge[-1], gauge, _index(len(gauge)))
    return np.maximum(1 - np.abs(place[:, None] - _index(len(gauge))), 0.0)


@lru_cache(maxsize=16)
def _across(count: int) -> Complex:
    """(2,count) how much the left and the right side count at each place across; of a type for complex products."""
    return np.stack([np.linspace(1, 0, count), np.linspace(0, 1, count)]).astype(np.complex128)


@lru_cache(maxsize=16)
def _near_corners(rows: int, cols: int) -> Indices:
    """(12,) the corners of a lattice, their neighbours in the same row, and those in the same column."""
    at = np.arange(rows * cols).reshape(rows, cols)
    beside, beneath = at[[0, 0, -1, -1], [1, -2, -2, 1]], at[[1, 1, -2, -2], [0, -1, -1, 0]]
    return np.concatenate([at[[0, 0, -1, -1], [0, -1, -1, 0]], beside, beneath])


@lru_cache(maxsize=16)
def _index(count: int) -> Array:
    return np.arange(float(count))


@lru_cache(maxsize=16)
def _shares(count: int, centers: bool) -> Array:
    return (np.arange(count) + 0.5) / count if centers else np.linspace(0, 1, count)
