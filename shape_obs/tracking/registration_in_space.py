"""Contour registration in space: find the place on a closed outline where an earlier outline began, as it bends.

As in the plane, the best rigid motion for every cyclic shift follows from the cross-covariances, see ``registration``.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.outline import wave_table, waves
from shape_obs.geometry.rotation import best_rotation, covariance_of, largest_trace

Array = npt.NDArray[np.float64]

_FORGETTING: Final = 0.05  # by which share what is known follows what is found, in a frame
# As in the plane: what the place weighs against the form to choose a peak, and where the form says nothing.
_TURNING: Final = 0.05
_FLAT: Final = 3e-4
_HARMONICS: Final = 12
_SHIFTS: Final = 128
_PEAKS: Final = (0.5 / 128, 0.1 / 128)
_ALIKE: Final = 0.98  # a better match of forms in space is looked for near the expected place alone
_STEPS: Final = 5
_COMPARED: Final = 48  # of the nodes, at least
_BENT: Final = 2.0  # median distances: what lies farther off has bent
_FARTHEST: Final = 1 / 24  # of the outline
_STAY: Final = 0.01  # how much staying weighs against moving
# Cosines and sines of the waves at each of the shifts that are looked at: ``(128, 2, 12)``.
_ANGLES = 2 * np.pi * np.outer(np.arange(_SHIFTS) / _SHIFTS, np.arange(1, _HARMONICS + 1))
_GRID: Final = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)


@compiled("(f8[:,::1], f8[:,::1])")
def blend_space(reference: Array, found: Array) -> Array:
    """Return the reference laid over ``found`` and moved a little there, all ``(K, 3)``."""
    covariance, before, after = covariance_of(reference, found)
    rotation = best_rotation(covariance)
    out = np.empty_like(found)
    for k in range(len(found)):
        for d in range(3):
            laid = after[d]
            for e in range(3):
                laid += (reference[k, e] - before[e]) * rotation[e, d]
            out[k, d] = laid + _FORGETTING * (found[k, d] - laid)
    return out


@compiled("(f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1])")
def index_shift_space(reference: Array, predicted: Array, found: Array, seen: Array) -> float:
    """Return what ``index_shift`` returns, by forms in space ``(K, 3)`` and places, expected and seen, ``(K, D)``."""
    cos, sin = wave_table(len(found), _HARMONICS)
    shape = _cross_spectrum(waves(reference, cos, sin), waves(found, cos, sin))
    place = _traced(_cross_spectrum(waves(predicted, cos, sin), waves(seen, cos, sin)))
    still, turned, expected = np.empty(_SHIFTS), np.full(_SHIFTS, -np.inf), 0
    for s in range(_SHIFTS):
        still[s] = _stayed(place, _GRID[s])
        expected = s if still[s] > still[expected] else expected
    first, count, best = expected - _SHIFTS // 8, 2 * (_SHIFTS // 8) + 1, expected
    for s in range(first, first + count):
        turned[s % _SHIFTS] = _turned(shape, _GRID[s % _SHIFTS])
        best = s if turned[s % _SHIFTS] > turned[best % _SHIFTS] else best
    if turned[best % _SHIFTS] < _ALIKE or best in (first, first + count - 1):  # it has turned far
        first, count = 0, _SHIFTS
        for s in range(_SHIFTS):
            turned[s] = _turned(shape, _GRID[s])
    least, most, at, match = np.inf, -np.inf, 0, -np.inf
    for s in range(_SHIFTS):
        if turned[s] > -np.inf:
            least, most = min(least, turned[s]), max(most, turned[s])
        if turned[s] + _TURNING * still[s] > match:
            at, match = s, turned[s] + _TURNING * still[s]
    flat = _FLAT / (1 + (most - least) / _FLAT)
    score = turned + flat * still
    while max(score[at - 1], score[(at + 1) % _SHIFTS]) > score[at]:
        at = (at - 1 if score[at - 1] >= score[(at + 1) % _SHIFTS] else at + 1) % _SHIFTS
    turns = at / _SHIFTS
    for width in _PEAKS:
        before, here, after = _wave(turns - width), _wave(turns), _wave(turns + width)
        low = _turned(shape, before) + flat * _stayed(place, before)
        middle = _turned(shape, here) + flat * _stayed(place, here)
        high = _turned(shape, after) + flat * _stayed(place, after)
        bend = low - 2 * middle + high
        if bend < 0:
            turns += width * min(max((low - high) / (2 * bend), -1.0), 1.0)
    return _without_bends(reference, found, turns * len(found))


@compiled
def _without_bends(reference: Array, found: Array, shift: float) -> float:
    """Refine a shift by those parts of an outline that have moved rigidly; the others count for little.

    Where a part of an outline bends out of the plane, the best rigid motion of the whole is off by up to half a gap of
    32 points. Gauss-Newton steps in the shift, the rotation and the translation, with weights that fall with the
    distance (D. Geman, D. E. McClure, "Statistical methods for tomographic image reconstruction", 1987), go over to
    the part that has not bent.
    """
    count = len(found)
    low, high, every = shift - _FARTHEST * count, shift + _FARTHEST * count, max(count // _COMPARED, 1)
    some = reference[::every]
    weight, places, ahead = np.ones(len(some)), np.empty_like(some), np.empty_like(some)
    off, far = np.empty_like(some), np.empty(len(some))
    for _ in range(_STEPS):
        for n in range(len(some)):
            at = (n * every + shift) % count
            before = min(int(at), count - 1)
            for d in range(3):
                ahead[n, d] = found[(before + 1) % count, d] - found[before, d]
                places[n, d] = found[before, d] + (at - before) * ahead[n, d]
        laid, middle = _laid(some, places, weight)
        for n in range(len(some)):
            square = 0.0
            for d in range(3):
                off[n, d] = places[n, d] - middle[d] - laid[n, d]
                square += off[n, d] ** 2
            far[n] = math.sqrt(square)
        reach = max(_BENT * np.median(far), 1e-9)
        normal, slope = np.zeros((7, 7)), np.zeros(7)
        for n in range(len(some)):
            weight[n] = 1 / (1 + (far[n] / reach) ** 2) ** 2
            for d in range(3):  # how the residual moves with the shift, a rotation and a translation
                e, f = (d + 1) % 3, (d + 2) % 3
                moves = ((0, ahead[n, d]), (1 + e, -laid[n, f]), (1 + f, laid[n, e]), (4 + d, -1.0))
                for i, by in moves:
                    slope[i] += weight[n] * by * off[n, d]
                    for j, other in moves:
                        normal[i, j] += weight[n] * by * other
        normal[0, 0] *= 1 + _STAY  # on a circle a shift is a rotation
        for i in range(7):
            normal[i, i] += 1e-12
        step = -np.linalg.solve(normal, slope)[0]
        shift = min(max(shift + min(max(step, -1.0), 1.0), low), high)
    return shift


@compiled
def _laid(points: Array, places: Array, weight: Array) -> tuple[Array, Array]:
    """Return ``(N, 3)`` weighted points rotated onto places, about the places' mean, and that mean ``(3,)``."""
    first, second, covariance, whole = np.zeros(3), np.zeros(3), np.zeros((3, 3)), weight.sum()
    for n in range(len(points)):
        for d in range(3):
            first[d] += weight[n] / whole * points[n, d]
            second[d] += weight[n] / whole * places[n, d]
    for n in range(len(points)):
        for d in range(3):
            for e in range(3):
                covariance[d, e] += weight[n] / whole * (points[n, d] - first[d]) * (places[n, e] - second[e])
    rotation = best_rotation(covariance)
    laid = np.zeros_like(points)
    for n in range(len(points)):
        for d in range(3):
            for e in range(3):
                laid[n, d] += (points[n, e] - first[e]) * rotation[e, d]
    return laid, second


@compiled
def _cross_spectrum(first: Array, second: Array) -> Array:
    """Return the spectrum of the cross-covariance over cyclic shifts, ``(D, D, 2, H)``: cosines and sines.

    It is that of two curves by their ``waves``, ``(2 D, H)``. A perfect match gives 1.
    """
    size = len(first) // 2
    scale = max(math.sqrt(np.sum(first * first) * np.sum(second * second)), 1e-12)
    out = np.empty((size, size, 2, _HARMONICS))
    for d in range(size):
        for e in range(size):
            for h in range(_HARMONICS):
                a, b, c, f = first[2 * d, h], first[2 * d + 1, h], second[2 * e, h], second[2 * e + 1, h]
                out[d, e, 0, h], out[d, e, 1, h] = (a * c + b * f) / scale, (a * f - b * c) / scale
    return out


@compiled
def _traced(spectrum: Array) -> Array:
    """Return the spectrum of the trace of the covariance: ``(2, H)``."""
    out = np.zeros((2, _HARMONICS))
    for d in range(len(spectrum)):
        for part in range(2):
            for h in range(_HARMONICS):
                out[part, h] += spectrum[d, d, part, h]
    return out


@compiled
def _wave(turns: float) -> Array:
    """Return the waves at a shift, in turns: ``(2, H)`` cosines and sines."""
    out = np.empty((2, _HARMONICS))
    for h in range(_HARMONICS):
        out[0, h], out[1, h] = math.cos(2 * math.pi * turns * (h + 1)), math.sin(2 * math.pi * turns * (h + 1))
    return out


@compiled
def _turned(spectrum: Array, wave: Array) -> float:
    """Return how well forms match at the shift of a wave, after the best proper rotation."""
    covariance = np.empty((3, 3))
    for d in range(3):
        for e in range(3):
            covariance[d, e] = _stayed(spectrum[d, e], wave)
    return largest_trace(covariance)


@compiled(reassociate=True)
def _stayed(spectrum: Array, wave: Array) -> float:
    """Return the value of a spectrum ``(2, H)`` at the shift of a wave; of a trace, how well places match unturned."""
    total = 0.0
    for h in range(_HARMONICS):
        total += spectrum[0, h] * wave[0, h] + spectrum[1, h] * wave[1, h]
    return total
