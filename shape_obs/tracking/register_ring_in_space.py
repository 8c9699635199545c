"""Contour registration in space: find the place on a closed outline where an earlier outline began, as it bends.

As in the plane, the best rigid motion for every cyclic shift follows from the cross-covariances, see ``register_ring``.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.outline import unround, wave_table, waves
from shape_obs.geometry.rotation import best_rotation, covariance_of, largest_trace
from shape_obs.tracking.model import Model, RingConstants  # noqa: F401 - the second in a signature

Array = npt.NDArray[np.float64]

HARMONICS: Final = 12  # waves around the outline that are compared: on a noisy circle more of them mislead
SHIFTS: Final = 128  # at which a peak is looked for, ten to the shortest wave
PEAKS: Final = (0.5 / SHIFTS, 0.1 / SHIFTS)  # turns: half-widths of the parabolas through it, one after the other
_ANGLES = 2 * np.pi * np.outer(np.arange(SHIFTS) / SHIFTS, np.arange(1, HARMONICS + 1))  # radians
WAVES: Final = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)  # (128, 2, 12) cosines and sines at each shift
_NEARBY: Final = SHIFTS // 8  # shifts to either side of the expected one that are tried first
_STEPS: Final = 5  # of Gauss-Newton
_COMPARED: Final = 48  # of the nodes, at least


@compiled("(f8[:,::1], f8[:,::1], f8)")
def blend_space(reference: Array, found: Array, gain: float) -> Array:
    """Return the reference placed over ``found`` and moved a share of the way there, all ``(K, 3)``."""
    covariance, before, after = covariance_of(reference, found)
    rotation = best_rotation(covariance)
    out = np.empty_like(found)
    for k in range(len(found)):
        for d in range(3):
            laid = after[d]
            for e in range(3):
                laid += (reference[k, e] - before[e]) * rotation[e, d]
            out[k, d] = laid + gain * (found[k, d] - laid)
    return out


@compiled("(f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8, RingConstants[::1])")
def index_shift_space(
    reference: Array, predicted: Array, found: Array, seen: Array, resolution: float, model: Model
) -> tuple[float, float]:
    """Return what ``index_shift`` returns, by forms in space ``(K, 3)`` and places, expected and seen, ``(K, D)``.

    The resolution is that of the places; ``(1,)`` the constants.
    """
    constants = model[0]
    cos, sin = wave_table(len(found), HARMONICS)
    before, after = waves(reference, cos, sin), waves(found, cos, sin)
    shape = _cross_spectrum(before, after)
    place = _traced(_cross_spectrum(waves(predicted, cos, sin), waves(seen, cos, sin)))
    still, turned, expected = np.empty(SHIFTS), np.full(SHIFTS, -np.inf), 0
    for s in range(SHIFTS):
        still[s] = _stayed(place, WAVES[s])
        expected = s if still[s] > still[expected] else expected
    first, count, best = expected - _NEARBY, 2 * _NEARBY + 1, expected
    for s in range(first, first + count):
        turned[s % SHIFTS] = _turned(shape, WAVES[s % SHIFTS])
        best = s if turned[s % SHIFTS] > turned[best % SHIFTS] else best
    if turned[best % SHIFTS] < constants.alike or best in (first, first + count - 1):  # it has turned far
        first, count = 0, SHIFTS
        for s in range(SHIFTS):
            turned[s] = _turned(shape, WAVES[s])
    at, match = 0, -np.inf
    for s in range(SHIFTS):
        if turned[s] + constants.start_weight * still[s] > match:
            at, match = s, turned[s] + constants.start_weight * still[s]
    flat, turning = place_weight(predicted, min(unround(before), unround(after)), resolution, constants)
    score = turned + flat * still
    while max(score[at - 1], score[(at + 1) % SHIFTS]) > score[at]:
        at = (at - 1 if score[at - 1] >= score[(at + 1) % SHIFTS] else at + 1) % SHIFTS
    turns = at / SHIFTS
    for width in PEAKS:
        behind, here, ahead = _wave(turns - width), _wave(turns), _wave(turns + width)
        low = _turned(shape, behind) + flat * _stayed(place, behind)
        middle = _turned(shape, here) + flat * _stayed(place, here)
        high = _turned(shape, ahead) + flat * _stayed(place, ahead)
        bend = low - 2 * middle + high
        if bend < 0:
            turns += width * min(max((low - high) / (2 * bend), -1.0), 1.0)
    stay = _peak(place, expected) * len(found)
    return _without_bends(before, after, cos, sin, turns * len(found), stay, flat, constants), turning


@compiled
def place_weight(predicted: Array, contrast: float, resolution: float, model: Any) -> tuple[float, float]:
    """Return how much the place of an outline weighs against its form, and how far its turning can be believed.

    The form of a round outline does not say how it has turned: the noise of its pixels does, and would turn it by gaps.
    The weight falls as the outline is less round, since what is predicted of a turning outline lags behind.

    Args:
        predicted: ``(K, D)`` where it is expected.
        contrast: How far the outline is from a circle, see ``unround``.
        resolution: In the unit of the places.
        model: The constants, one ``RingModel``.

    Returns:
        The weight, relative to a match of 1; 0...1.
    """
    square = 0.0
    for d in range(predicted.shape[1]):
        square += np.var(predicted[:, d])
    small = resolution**2 / max(square, 1e-18)
    flat, noise = model.place_weight[0] + model.place_weight[1] * small, model.staircase * small
    return flat / (1 + contrast / flat), 1 / (1 + (noise / max(contrast, 1e-9 * noise)) ** 2)


@compiled
def _peak(place: Array, at: int) -> float:
    """Return the shift at which places match best, in turns, next to one of those that are looked at."""
    low, middle = _stayed(place, WAVES[at - 1]), _stayed(place, WAVES[at])
    high = _stayed(place, WAVES[(at + 1) % SHIFTS])
    bend = low - 2 * middle + high
    return (at + (min(max((low - high) / (2 * bend), -1.0), 1.0) if bend < 0 else 0.0)) / SHIFTS


@compiled
def _without_bends(
    reference: Array, found: Array, cos: Array, sin: Array, shift: float, stay: float, flat: float, model: Any
) -> float:
    """Refine a shift by those parts of an outline that have moved rigidly; the others count for little.

    Where a part of an outline bends out of the plane, the best rigid motion of the whole is off by up to half a gap of
    32 points. Gauss-Newton steps in the shift, the rotation and the translation, with weights that fall with the
    distance (D. Geman, D. E. McClure, "Statistical methods for tomographic image reconstruction", 1987), go over to
    the part that has not bent. Outlines are compared by their waves: between noisy nodes a line is smoother than at
    them, which would draw the shift there.

    Args:
        reference: ``(6, H)`` the waves of the outline as it was.
        found: ``(6, H)`` the same now.
        cos: ``(H, K)``, see ``wave_table``.
        sin: The same.
        shift: To refine, places.
        stay: Where the place of the outline is expected, the same.
        flat: How much that weighs.
        model: The constants, one ``RingModel``.
    """
    count = cos.shape[1]
    low, high, every = (
        shift - model.max_refinement * count,
        shift + model.max_refinement * count,
        max(count // _COMPARED, 1),
    )
    cos, sin = cos[:, ::every] * (2 / count), sin[:, ::every] * (2 / count)
    some = _drawn(reference, cos, sin)
    weight, moved, ahead, off = np.ones(len(some)), np.empty_like(found), np.empty_like(found), np.empty_like(some)
    far = np.empty(len(some))
    for _ in range(_STEPS):
        for h in range(found.shape[1]):
            turn = 2 * math.pi * (h + 1) / count
            along, across = math.cos(turn * shift), math.sin(turn * shift)
            for d in range(3):
                a, b = found[2 * d, h], found[2 * d + 1, h]
                moved[2 * d, h], moved[2 * d + 1, h] = a * along + b * across, b * along - a * across
                ahead[2 * d, h], ahead[2 * d + 1, h] = turn * moved[2 * d + 1, h], -turn * moved[2 * d, h]
        places, speed = _drawn(moved, cos, sin), _drawn(ahead, cos, sin)
        laid, middle = _laid(some, places, weight)
        for n in range(len(some)):
            square = 0.0
            for d in range(3):
                off[n, d] = places[n, d] - middle[d] - laid[n, d]
                square += off[n, d] ** 2
            far[n] = math.sqrt(square)
        reach = max(model.outlier * np.median(far), 1e-9)
        normal, slope = np.zeros((7, 7)), np.zeros(7)
        for n in range(len(some)):
            weight[n] = 1 / (1 + (far[n] / reach) ** 2) ** 2
            for d in range(3):  # how the residual moves with the shift, a rotation and a translation
                e, f = (d + 1) % 3, (d + 2) % 3
                moves = ((0, speed[n, d]), (1 + e, -laid[n, f]), (1 + f, laid[n, e]), (4 + d, -1.0))
                for i, by in moves:
                    slope[i] += weight[n] * by * off[n, d]
                    for j, other in moves:
                        normal[i, j] += weight[n] * by * other
        away = (shift - stay + count / 2) % count - count / 2
        slope[0] += flat * normal[0, 0] * away  # on a circle a shift is a rotation
        normal[0, 0] *= 1 + flat
        for i in range(7):
            normal[i, i] += 1e-12
        step = -np.linalg.solve(normal, slope)[0]
        shift = min(max(shift + min(max(step, -1.0), 1.0), low), high)
    return shift


@compiled(reassociate=True)
def _drawn(spectrum: Array, cos: Array, sin: Array) -> Array:
    """Return places ``(N, 3)`` around a closed curve by its waves ``(6, H)``, at those of the tables ``(H, N)``."""
    out, row = np.empty((cos.shape[1], 3)), np.empty(cos.shape[1])
    for d in range(3):
        row[:] = 0.0
        for h in range(len(cos)):
            a, b = spectrum[2 * d, h], spectrum[2 * d + 1, h]
            for n in range(len(row)):
                row[n] += a * cos[h, n] + b * sin[h, n]
        for n in range(len(row)):
            out[n, d] = row[n]
    return out


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
    out = np.empty((size, size, 2, HARMONICS))
    for d in range(size):
        for e in range(size):
            for h in range(HARMONICS):
                a, b, c, f = first[2 * d, h], first[2 * d + 1, h], second[2 * e, h], second[2 * e + 1, h]
                out[d, e, 0, h], out[d, e, 1, h] = (a * c + b * f) / scale, (a * f - b * c) / scale
    return out


@compiled
def _traced(spectrum: Array) -> Array:
    """Return the spectrum of the trace of the covariance: ``(2, H)``."""
    out = np.zeros((2, HARMONICS))
    for d in range(len(spectrum)):
        for part in range(2):
            for h in range(HARMONICS):
                out[part, h] += spectrum[d, d, part, h]
    return out


@compiled
def _wave(turns: float) -> Array:
    """Return the waves at a shift, in turns: ``(2, H)`` cosines and sines."""
    out = np.empty((2, HARMONICS))
    for h in range(HARMONICS):
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
    for h in range(HARMONICS):
        total += spectrum[0, h] * wave[0, h] + spectrum[1, h] * wave[1, h]
    return total
