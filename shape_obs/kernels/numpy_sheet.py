"""Sheets on NumPy: the corners of a rim, the patch between them, lattices. Points of the plane are complex numbers."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter1d

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
from shape_obs.kernels.numpy_outline import Complex, closed_arc, lengths, plane, points_of

_T = np.arange(FINE) / (FINE - 1)
_ACROSS = np.stack([1 - _T, _T])  # how much the left and the right side count at each place across
_RIM_AT = np.arange(RIM)
_TURNED = (np.arange(4)[:, None] + np.arange(4)) % 4
_OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


def rim(outline: Array) -> tuple[Array, Array, Indices, float, float]:
    """See ``SheetKernels.rim``."""
    closed = np.concatenate([outline, outline[:1]])
    arc = closed_arc(closed)
    z = np.interp(_RIM_AT * (arc[-1] / RIM), arc, plane(closed))
    around = np.concatenate([z[-REACH_OF_TURN:], z, z[:REACH_OF_TURN]])
    chord = around[REACH_OF_TURN:] - around[:-REACH_OF_TURN]  # from each point to the one that many further on
    turn = np.angle(chord[REACH_OF_TURN:] * chord[:-REACH_OF_TURN].conj())
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
    z = plane(rim)
    begin = int(corners[0])
    at = [*((corners - begin) % RIM).tolist(), RIM]
    around = np.concatenate([z[begin:], z[:begin]])
    places = _places(around, at[:4], step, grain)
    skip = max(round(ROUNDED / 2 * grain / step), 1)
    pieces, first = [], [0]
    for k in range(4):
        inner = around[at[k] + skip : max(at[k + 1] - skip + 1, at[k] + skip)]
        pieces += [places[k : k + 1], inner]
        first.append(first[-1] + 1 + len(inner))
    border = np.concatenate([*pieces, places[:1]])
    arc = np.zeros(len(border))
    np.cumsum(np.abs(border[1:] - border[:-1]), out=arc[1:])
    ends = arc[first]
    sides = np.interp(ends[:4, None] + (ends[1:] - ends[:4])[:, None] * _T, arc, border)
    turned = np.concatenate([turn[begin:], turn[:begin]])
    straight = [turned[at[k] + REACH_OF_TURN + 1 : at[k + 1] - REACH_OF_TURN] for k in range(4)]
    kink = float(np.abs(np.concatenate(straight)).max(initial=0.0))
    return points_of(_coons(sides).ravel()), kink


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


def strayed(nodes: Array, corners: Array) -> tuple[int, int, float]:
    """See ``SheetKernels.strayed``."""
    past, here = plane(outer_corners(nodes)), plane(corners)
    away = here[_TURNED] - past
    quarters = int(np.argmin((away.real**2 + away.imag**2).sum(axis=1)))
    here = here[_TURNED[quarters]]
    reach = max(float(np.abs(here - here.sum() / 4).max()), 1e-9)
    both = np.stack([past, here])
    # The middles of the three others, and from there the three.
    middles = (both.sum(axis=1)[:, None] - both) / 3
    source, target = both[:, _OTHERS] - middles[:, :, None]
    spread = np.maximum((source.real**2 + source.imag**2).sum(axis=1), 1e-18)
    motion = (source.conj() * target).sum(axis=1) / spread
    away, here = both - middles
    astray = np.abs(away * motion - here)
    worst = int(np.argmax(astray))
    return quarters, worst, float(astray[worst]) / reach


def assessed(lattice: Array) -> tuple[float, float, float, float]:
    """See ``SheetKernels.assessed``."""
    z = plane(lattice)
    sides = (z[0], z[:, -1], z[-1, ::-1], z[::-1, 0])
    angle, winding = 90.0, 0.0
    for before, side in zip((sides[3], *sides[:3]), sides, strict=True):
        back, ahead = before[-1 - len(before) // 8] - side[0], side[len(side) // 8] - side[0]
        here = abs(float(np.degrees(np.angle(ahead * back.conjugate()))))
        if abs(here - 90) > abs(angle - 90):
            angle = here
        along = float(np.abs(side[1:] - side[:-1]).sum())
        winding = max(winding, along / max(float(abs(side[-1] - side[0])), 1e-9) - 1)
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
    first = max(int(np.ceil(ROUNDED * grain / step)), 1)
    away = first + np.arange(max(LINE, first))
    here = np.array(corners)
    lines = around[(here + np.stack([-away, away])[:, :, None]) % RIM]  # (2,L,4)
    middles = lines.sum(axis=1) / len(away)
    slopes = np.tensordot(np.arange(len(away)) - (len(away) - 1) / 2, lines, axes=(0, 1))
    slopes = slopes / np.maximum(np.abs(slopes), 1e-9)
    (before, after), (back, ahead) = middles, slopes
    apart = after - before
    both = back.conj() * ahead
    cosine = both.real
    sine = 1 - cosine**2
    over = np.maximum(sine, PARALLEL)
    along_back, along_ahead = (apart * back.conj()).real, (apart * ahead.conj()).real
    s, t = (along_back - cosine * along_ahead) / over, (cosine * along_back - along_ahead) / over
    shift = (before + s * back + after + t * ahead) / 2 - around[here]
    shift[sine < PARALLEL] = 0
    return around[here] + shift / np.maximum(np.abs(shift) / (OUTSIDE * grain), 1)


def _coons(sides: Complex) -> Complex:
    """The bilinearly blended patch of four sides (S. A. Coons, "Surfaces for Computer-Aided Design of Space Forms").

    Args:
        sides: (4,S) clockwise: the top side from left to right, the right one downwards, the bottom one from right to
            left, the left one upwards; each ends where the next begins.

    Returns:
        (S,S) rows from top to bottom, the sides among them.
    """
    top, right, bottom, left = sides[0], sides[1], sides[2, ::-1], sides[3, ::-1]
    # What top and bottom do not already bring to the left and to the right.
    rest = np.stack([left - top[0] - _T * (bottom[0] - top[0]), right - top[-1] - _T * (bottom[-1] - top[-1])], axis=1)
    return np.stack([*rest.T, *_ACROSS]).T @ np.stack([*_ACROSS, top, bottom])


def _weights(gauge: Array, count: int, centers: bool) -> Array:
    """(count,C) by how much each of C rows counts in ``count`` places with equal gaps."""
    place = np.interp(_shares(count, centers) * gauge[-1], gauge, _index(len(gauge)))
    return np.maximum(1 - np.abs(place[:, None] - _index(len(gauge))), 0.0)


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
