"""Contour registration: find the place on a closed outline where an earlier outline began.

Both outlines are sampled at the same number of equidistant places. For every cyclic shift, the best rigid motion of one
onto the other follows from their cross-covariance alone (P. H. Schönemann, "A generalized solution of the orthogonal
Procrustes problem", Psychometrika 31, 1966; proper rotations: W. Kabsch, Acta Cryst. A32, 1976), and the covariances
of all shifts are a few Fourier transforms (cf. F. P. Kuhl, C. R. Giardina, "Elliptic Fourier features of a closed
contour", 1982). In the image, forms are compared in pixels; with depth, in space.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.outline import unround, wave_table, waves
from shape_obs.geometry.polyline import arc_length, closed, even_around, starting_at
from shape_obs.geometry.rotation import largest_trace, moved_onto, spread_of
from shape_obs.tracking.model import gain_of

Array = npt.NDArray[np.float64]
#: A closed curve from where it begins: points ``(P, D)``; the same in metres ``(P, 3)``, ``(0, 3)`` if its form is that
#: of the points; their arc length ``(P + 1,)``; nodes on them, equally spaced by form ``(K, D)``; the form's own nodes.
Begun = tuple[Array, Array, Array, Array, Array]

_HARMONICS: Final = 12  # waves around the outline that are compared: on a noisy circle more of them mislead
_SHIFTS: Final = 128  # at which a peak is looked for, ten to the shortest wave
_PEAKS: Final = (0.5 / _SHIFTS, 0.1 / _SHIFTS)  # turns: half-widths of the parabolas through it, one after the other
_ANGLES = 2 * np.pi * np.outer(np.arange(_SHIFTS) / _SHIFTS, np.arange(1, _HARMONICS + 1))  # radians
_COS, _SIN = np.ascontiguousarray(np.cos(_ANGLES.T)), np.ascontiguousarray(np.sin(_ANGLES.T))  # (12, 128)
_STEPS: Final = 5  # of Gauss-Newton
_COMPARED: Final = 48  # of the nodes, at least


@compiled
def register_ring(
    points: Array, space: Array, reference: Array, predicted: Array, resolution: float, lasted: float, model: Any
) -> tuple[Array, Array, Array, Array, Array, float]:
    """Renumber an outline from where it began before.

    Args:
        points: ``(P, D)``.
        space: ``(P, 3)`` the same in metres; ``(0, 3)`` if its form is that of the points.
        reference: ``(K, D')`` equidistant around its form as it was, wherever it was.
        predicted: ``(K, D)`` the same nodes where they are expected.
        resolution: Of the points.
        lasted: Seconds for which this frame counts.
        model: The constants, one ``RingModel``.

    Returns:
        Points, space, arc length and nodes, see ``Begun``; the reference as it is known now; how far the turning can be
        believed, 0...1.
    """
    count, around = len(predicted), closed(points)
    line = closed(space) if len(space) > 0 else around
    arc = arc_length(line)
    found = even_around(line, arc, 0.0, count)
    seen = even_around(around, arc, 0.0, count) if len(space) > 0 else found
    shift, turning = index_shift(reference, predicted, found, seen, resolution, model)
    points, space, arc, nodes, places = begin_outline(points, space, shift * (arc[-1] / count), count)
    # What a hand hides slowly is not forgotten; with depth, the hand is seen.
    most = np.inf if reference.shape[1] == 3 else model.max_outline_change * lasted
    known = blend(reference, places, gain_of(lasted, model.outline_memory), most)
    return points, space, arc, nodes, known, turning


@compiled
def begin_outline(points: Array, space: Array, start: float, count: int) -> Begun:
    """Let an outline begin elsewhere, with its nodes equally spaced by its form.

    Args:
        points: ``(P, D)``.
        space: ``(P, 3)`` the same in metres; ``(0, 3)`` if its form is that of the points.
        start: Arc position of the first point by its form.
        count: How many nodes.

    Returns:
        See ``Begun``.
    """
    known = arc_length(closed(space if len(space) > 0 else points))
    points = starting_at(points, known, start)
    around = closed(points)
    arc = arc_length(around)
    if len(space) == 0:
        nodes = even_around(around, arc, 0.0, count)
        return points, space, arc, nodes, nodes
    space = starting_at(space, known, start)
    line = closed(space)
    metres = arc_length(line)
    return points, space, arc, even_around(around, metres, 0.0, count), even_around(line, metres, 0.0, count)


@compiled("(f8[:,::1], f8[::1], f8[::1])")
def first_place(seen: Array, arc: Array, target: Array) -> float:
    """Return the arc position of a closed curve that is nearest a target, or where u + v is least.

    Args:
        seen: ``(P, D)`` its points.
        arc: ``(P + 1,)`` its arc length.
        target: ``(D,)``; ``(0,)`` without one.
    """
    far, count, at = np.empty(len(seen)), len(seen), 0
    for p in range(count):
        far[p] = seen[p, 0] + seen[p, 1] if len(target) == 0 else 0.0
        for d in range(len(target)):
            far[p] += (seen[p, d] - target[d]) ** 2
        at = p if far[p] < far[at] else at
    before, after = arc[at] - arc[at - 1] if at > 0 else arc[count] - arc[count - 1], arc[at + 1] - arc[at]
    fall, rise = (far[at - 1] - far[at]) / before, (far[(at + 1) % count] - far[at]) / after
    shift = (fall * after - rise * before) / (2 * (fall + rise)) if fall + rise > 0 else 0.0  # of a parabola
    return arc[at] + min(max(shift, -before), after)


@compiled
def index_shift(
    reference: Array, predicted: Array, found: Array, seen: Array, resolution: float, model: Any
) -> tuple[float, float]:
    """Return by how many places the numbering has moved: node k of the past is now at ``found[k + shift]``.

    Args:
        reference: ``(K, D')`` equidistant around the outline as it was, wherever it was.
        predicted: ``(K, D)`` the same nodes where they are expected.
        found: ``(K, D')`` equidistant around the outline that was found, in the same direction.
        seen: ``(K, D)`` the same where places are compared.
        resolution: Of the places.
        model: The constants, one ``RingModel``.

    Returns:
        Places; fractions of a place too. And how far a turning can be believed, 0...1.
    """
    count, in_space = len(found), reference.shape[1] == 3
    cos, sin = wave_table(count, _HARMONICS)
    before, after = waves(reference, cos, sin), waves(found, cos, sin)
    shape = _cross_spectrum(before, after)
    place = _traced(_cross_spectrum(waves(predicted, cos, sin), waves(seen, cos, sin) if in_space else after))
    flat, turning = place_weight(predicted, min(unround(before), unround(after)), resolution, model)
    turned, still, score = _turned_by_shifts(shape), _over_shifts(place), np.empty(_SHIFTS)
    at, best = 0, -np.inf
    for s in range(_SHIFTS):
        match, score[s] = turned[s] + model.start_weight * still[s], turned[s] + flat * still[s]
        at, best = (s, match) if match > best else (at, best)
    while max(score[at - 1], score[(at + 1) % _SHIFTS]) > score[at]:
        at = (at - 1 if score[at - 1] >= score[(at + 1) % _SHIFTS] else at + 1) % _SHIFTS
    turns = at / _SHIFTS
    for width in _PEAKS:
        low, middle = _match(shape, place, flat, turns - width), _match(shape, place, flat, turns)
        turns += width * _peak(low, middle, _match(shape, place, flat, turns + width))
    if not in_space:
        return turns * count, turning
    expected = int(np.argmax(still))
    stay = expected + _peak(still[expected - 1], still[expected], still[(expected + 1) % _SHIFTS])
    return _without_bends(before, after, cos, sin, turns * count, stay / _SHIFTS * count, flat, model), turning


@compiled
def _peak(low: float, middle: float, high: float) -> float:
    """Return where the parabola through three values has its peak, in steps from the middle one, -1...1."""
    bend = low - 2 * middle + high
    return min(max((low - high) / (2 * bend), -1.0), 1.0) if bend < 0 else 0.0


@compiled
def blend(reference: Array, found: Array, gain: float, most: float) -> Array:
    """Return the reference placed over ``found`` and moved a share of the way there, all ``(K, D)``.

    No coordinate moves by more than a share of the radius.
    """
    out = moved_onto(reference, reference, found, np.ones(len(found)), False)
    most *= math.sqrt(spread_of(reference))
    for k in range(len(found)):
        for d in range(found.shape[1]):
            out[k, d] += max(-most, min(gain * (found[k, d] - out[k, d]), most))
    return out


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
    small = resolution**2 / max(spread_of(predicted), 1e-18)
    flat, noise = model.place_weight[0] + model.place_weight[1] * small, model.staircase * small
    return flat / (1 + contrast / flat), 1 / (1 + (noise / max(contrast, 1e-9 * noise)) ** 2)


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
    every = max(count // _COMPARED, 1)
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
        own = moved_onto(some, some, places, weight, False)
        for n in range(len(some)):
            square = 0.0
            for d in range(3):
                off[n, d] = places[n, d] - own[n, d]
                square += off[n, d] ** 2
            far[n] = math.sqrt(square)
        reach = max(model.outlier * np.median(far), 1e-9)
        normal, slope = np.zeros((7, 7)), np.zeros(7)
        for n in range(len(some)):
            weight[n] = 1 / (1 + (far[n] / reach) ** 2) ** 2
            for d in range(3):  # how the residual moves with the shift, a rotation and a translation
                e, f = (d + 1) % 3, (d + 2) % 3
                moves = ((0, speed[n, d]), (1 + e, -own[n, f]), (1 + f, own[n, e]), (4 + d, -1.0))
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
        shift += min(max(step, -1.0), 1.0)
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
def _over_shifts(spectrum: Array) -> Array:
    """Return the values of a spectrum ``(2, H)`` over the shifts: ``(S,)``."""
    out = np.zeros(_SHIFTS)
    for h in range(_HARMONICS):
        a, b, cos, sin = spectrum[0, h], spectrum[1, h], _COS[h], _SIN[h]
        for s in range(_SHIFTS):
            out[s] += a * cos[s] + b * sin[s]
    return out


@compiled
def _turned_by_shifts(spectrum: Array) -> Array:
    """Return how well forms match over the shifts, ``(S,)``, after the best proper rotation."""
    size, out = len(spectrum), np.empty(_SHIFTS)
    if size == 2:  # the sum of both singular values, the lesser one negative for a reflection
        along, across = _over_shifts(_traced(spectrum)), _over_shifts(spectrum[0, 1] - spectrum[1, 0])
        for s in range(_SHIFTS):
            out[s] = math.sqrt(along[s] ** 2 + across[s] ** 2)
        return out
    covariances = np.empty((_SHIFTS, size, size))
    for d in range(size):
        for e in range(size):
            values = _over_shifts(spectrum[d, e])
            for s in range(_SHIFTS):
                covariances[s, d, e] = values[s]
    for s in range(_SHIFTS):
        out[s] = largest_trace(covariances[s])
    return out


@compiled
def _match(shape: Array, place: Array, flat: float, turns: float) -> float:
    """Return how well two outlines match at one shift, in turns: their forms, and a little their places."""
    step, size, still = complex(math.cos(2 * math.pi * turns), math.sin(2 * math.pi * turns)), len(shape), 0.0
    wave, covariance = step, np.zeros((size, size))
    for h in range(_HARMONICS):
        for d in range(size):
            for e in range(size):
                covariance[d, e] += shape[d, e, 0, h] * wave.real + shape[d, e, 1, h] * wave.imag
        still += place[0, h] * wave.real + place[1, h] * wave.imag
        wave *= step
    return largest_trace(covariance) + flat * still
