"""Contour registration: find the place on a closed outline where an earlier outline began.

Both outlines are sampled at the same number of equidistant places. For every cyclic shift, the best rigid motion of one
onto the other follows from their cross-covariance alone (P. H. Schönemann, "A generalized solution of the orthogonal
Procrustes problem", Psychometrika 31, 1966; proper rotations: W. Kabsch, Acta Cryst. A32, 1976), and the covariances
of all shifts are a few Fourier transforms (cf. F. P. Kuhl, C. R. Giardina, "Elliptic Fourier features of a closed
contour", 1982). In the plane, compiled loops do this with complex waves.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import FittedCurve, TrackHints
from shape_obs.geometry.outline import unround, wave_table, waves
from shape_obs.geometry.polyline import arc_length, closed, even_around
from shape_obs.tracking.complete_ring import may_be_hidden
from shape_obs.tracking.model import Model, RingConstants, RingModel, gain_of  # noqa: F401 - the second in a signature
from shape_obs.tracking.predict import Prediction
from shape_obs.tracking.register_ring_in_space import (
    HARMONICS,
    PEAKS,
    SHIFTS,
    WAVES,
    blend_space,
    index_shift_space,
    place_weight,
)

Array = npt.NDArray[np.float64]

# The waves at each shift, ``(12, 128)``.
_COS, _SIN = np.ascontiguousarray(WAVES[:, 0].T), np.ascontiguousarray(WAVES[:, 1].T)


def match_outline(curve: FittedCurve, prediction: Prediction, model: RingModel) -> tuple[FittedCurve, Array]:
    """Renumber a closed curve, clockwise as seen, from the place where the predicted outline begins.

    Returns the same curve from there on, and its ``(K, D)`` nodes, equally spaced.
    """
    reference, count = prediction.reference, len(prediction.nodes)
    if curve.points.shape[1] == 2:
        points, arc, nodes, reference, turning = renumber_outline(
            curve.points, reference, prediction.nodes, prediction.lasted, model.record
        )
        turned = FittedCurve(points, np.zeros(len(points), bool), arc, True)
    else:
        nodes = curve.even(count)
        shift, turning = index_shift_space(
            reference, prediction.nodes, nodes, nodes, prediction.resolution, model.record
        )
        turned = curve.starting_at(shift * curve.size / count)
        nodes = turned.even(count)
        gain = -math.expm1(-prediction.lasted / model.outline_memory)
        reference = blend_space(reference, nodes, gain)
    return replace(turned, hints=TrackHints(reference=reference, turning=turning)), nodes


@compiled("(f8[:,::1], f8[:,::1], f8[:,::1], f8, RingConstants[::1])")
def renumber_outline(
    points: Array, reference: Array, predicted: Array, lasted: float, model: Model
) -> tuple[Array, Array, Array, Array, float]:
    """Renumber an outline in the plane from where it began before.

    Args:
        points: ``(P, 2)``.
        reference: ``(K, 2)`` equidistant around the outline as it was, wherever it lay.
        predicted: ``(K, 2)`` the same nodes where they are expected.
        lasted: Seconds for which this frame counts.
        model: ``(1,)`` the constants.

    Returns:
        ``(P', 2)`` the same outline from there on, P' = P or P + 1; ``(P' + 1,)`` its arc length, the last entry the
        whole; ``(K, 2)`` equidistant places on it; ``(K, 2)`` the reference laid over them and moved towards them; how
        far its turning can be believed, 0...1.
    """
    count, around = len(predicted), closed(points)
    arc = arc_length(around)
    gap = arc[-1] / count
    shift, turning = index_shift(reference, predicted, even_around(around, arc, 0.0, count), model[0])
    turned = _from(points, arc, shift * gap)
    around = closed(turned)
    arc = arc_length(around)
    nodes = even_around(around, arc, 0.0, count)
    gain, most = gain_of(lasted, model[0].outline_memory), model[0].max_outline_change * lasted
    known = blend(reference, nodes, gain, most)
    return turned, arc, nodes, known, turning


@compiled("(f8[:,::1], f8[:,::1], f8, i8)")
def begin_outline(points: Array, space: Array, start: float, count: int) -> tuple[Array, Array, Array, Array, Array]:
    """Let an outline in an image begin elsewhere, with its nodes equally spaced in space.

    Args:
        points: ``(P, 2)`` pixels.
        space: ``(P, D)`` the same in metres.
        start: Arc position of the first point, metres.
        count: How many nodes.

    Returns:
        ``(P', 2)`` and ``(P', D)`` the same from there on, P' = P or P + 1; ``(P' + 1,)`` arc length in the image, the
        last entry the whole; the nodes, ``(count, 2)`` in pixels and ``(count, D)`` in metres.
    """
    metres = arc_length(closed(space))
    points, space = _from(points, metres, start), _from(space, metres, start)
    around, lifted = closed(points), closed(space)
    metres = arc_length(lifted)
    nodes, places = even_around(around, metres, 0.0, count), even_around(lifted, metres, 0.0, count)
    return points, space, arc_length(around), nodes, places


@compiled("(f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8, RingConstants[::1])")
def follow_outline(
    points: Array, space: Array, reference: Array, predicted: Array, lasted: float, model: Model
) -> tuple[Array, Array, Array, Array, Array, float, bool]:
    """Renumber an outline in an image from where it began before, by its form in space if that is known.

    Args:
        points: ``(P, 2)`` pixels.
        space: ``(P, 3)`` the same in metres, for a reference in metres.
        reference: ``(K, D)`` equidistant around the outline as it was, wherever it lay.
        predicted: ``(K, 2)`` the same nodes where they are expected, pixels.
        lasted: Seconds for which this frame counts.
        model: ``(1,)`` the constants.

    Returns:
        The points from there on ``(P', 2)``; in metres ``(P', 3)``, or ``(0, 3)``; arc length in pixels ``(P' + 1,)``;
        nodes ``(K, 2)``; the reference ``(K, D)`` as it is known now; how far its turning can be believed, 0...1;
        whether something may hide a part, by the outline in the image alone.
    """
    count = len(predicted)
    if reference.shape[1] == 2:
        turned, arc, nodes, known, turning = renumber_outline(points, reference, predicted, lasted, model)
        return turned, np.empty((0, 3)), arc, nodes, known, turning, may_be_hidden(nodes, reference, model[0])
    around, lifted = closed(points), closed(space)
    metres = arc_length(lifted)
    found, seen = even_around(lifted, metres, 0.0, count), even_around(around, metres, 0.0, count)
    shift, turning = index_shift_space(reference, predicted, found, seen, 1.0, model)
    turned, there, arc, nodes, places = begin_outline(points, space, shift * (metres[-1] / count), count)
    known = blend_space(reference, places, gain_of(lasted, model[0].outline_memory))
    return turned, there, arc, nodes, known, turning, False


@compiled
def _from(points: Array, arc: Array, start: float) -> Array:
    """Return the points of an outline ``(P, D)`` from an arc position on, with a first one there: P or P + 1 of them.

    Args:
        points: ``(P, D)``.
        arc: ``(P + 1,)`` arc length, or any other measure along it.
        start: The place.
    """
    count, whole = len(points), arc[-1]
    same, start = 1e-9 * whole, start % whole
    if start + same >= whole:
        start = 0.0
    after = 1
    while arc[after] < start + same:
        after += 1
    before = after - 1 if start - arc[after - 1] <= same else after  # the point is there already
    out = np.empty((1 + count - after + before, points.shape[1]))
    first = even_around(closed(points), arc, start, 1)
    for p in range(len(out)):
        for d in range(points.shape[1]):
            out[p, d] = first[0, d] if p == 0 else points[(after + p - 1) % count, d]
    return out


@compiled
def index_shift(reference: Array, predicted: Array, found: Array, model: Any) -> tuple[float, float]:
    """Return by how many places the numbering has moved: node k of the past is now at ``found[k + shift]``.

    Args:
        reference: ``(K, 2)`` equidistant around the outline as it was, wherever it lay.
        predicted: ``(K, 2)`` the same nodes where they are expected.
        found: ``(K, 2)`` equidistant around the outline that was found, in the same direction.
        model: The constants, one ``RingModel``.

    Returns:
        Places; fractions of a place too. And how far a turning can be believed, 0...1.
    """
    cos, sin = wave_table(len(found), HARMONICS)
    known, seen = waves(reference, cos, sin), waves(found, cos, sin)
    shape, place = _spectrum(known, seen), _spectrum(waves(predicted, cos, sin), seen)
    real, imaginary, still = np.zeros(SHIFTS), np.zeros(SHIFTS), np.zeros(SHIFTS)
    for h in range(HARMONICS):
        for s in range(SHIFTS):
            real[s] += shape[0, h] * _COS[h, s] + shape[1, h] * _SIN[h, s]
            imaginary[s] += shape[2, h] * _COS[h, s] + shape[3, h] * _SIN[h, s]
            still[s] += place[0, h] * _COS[h, s] + place[1, h] * _SIN[h, s]
    turned, score, at, best = np.empty(SHIFTS), np.empty(SHIFTS), 0, -np.inf
    for s in range(SHIFTS):
        turned[s] = math.sqrt(real[s] * real[s] + imaginary[s] * imaginary[s])
        match = turned[s] + model.start_weight * still[s]
        if match > best:
            at, best = s, match
    flat, turning = place_weight(predicted, min(unround(known), unround(seen)), 1.0, model)
    for s in range(SHIFTS):
        score[s] = turned[s] + flat * still[s]
    while max(score[at - 1], score[(at + 1) % SHIFTS]) > score[at]:
        at = (at - 1 if score[at - 1] >= score[(at + 1) % SHIFTS] else at + 1) % SHIFTS
    turns = at / SHIFTS
    for width in PEAKS:
        low, middle = _score(shape, place, flat, turns - width), _score(shape, place, flat, turns)
        high = _score(shape, place, flat, turns + width)
        bend = low - 2 * middle + high
        if bend < 0:
            turns += width * min(max((low - high) / (2 * bend), -1.0), 1.0)
    return turns * len(found), turning


@compiled
def blend(reference: Array, found: Array, gain: float, most: float) -> Array:
    """Return the reference placed over ``found`` and moved a share of the way there, all ``(K, 2)``.

    No node moves by more than a share of the radius.
    """
    count = len(found)
    before_u = before_v = after_u = after_v = 0.0
    for k in range(count):
        before_u += reference[k, 0] / count
        before_v += reference[k, 1] / count
        after_u += found[k, 0] / count
        after_v += found[k, 1] / count
    cosine = sine = size = 0.0
    for k in range(count):
        x, y = reference[k, 0] - before_u, reference[k, 1] - before_v
        size += x * x + y * y
        u, v = found[k, 0] - after_u, found[k, 1] - after_v
        cosine += x * u + y * v
        sine += x * v - y * u
    reach = math.sqrt(cosine * cosine + sine * sine)
    cosine, sine = (cosine / reach, sine / reach) if reach > 0 else (1.0, 0.0)
    out = np.empty_like(found)
    most *= math.sqrt(size / count)
    for k in range(count):
        x, y = reference[k, 0] - before_u, reference[k, 1] - before_v
        u, v = x * cosine - y * sine + after_u, x * sine + y * cosine + after_v
        out[k, 0] = u + max(-most, min(gain * (found[k, 0] - u), most))
        out[k, 1] = v + max(-most, min(gain * (found[k, 1] - v), most))
    return out


@compiled
def _spectrum(before: Array, after: Array) -> Array:
    """Return the correlation over cyclic shifts, ``(4, H)``: real cos, real sin, imaginary cos, imaginary sin.

    A wave of u + iv that runs forwards is (u_cos + v_sin) + i (v_cos - u_sin), and one that runs backwards has the
    other signs; the correlation multiplies the conjugate of the one with the other. A perfect match gives 1.
    """
    out = np.empty((4, HARMONICS))
    first = second = 0.0
    for h in range(HARMONICS):
        a, b, c, d = before[0, h], before[1, h], before[2, h], before[3, h]
        e, f, g, i = after[0, h], after[1, h], after[2, h], after[3, h]
        ahead = complex(a + d, -(c - b)) * complex(e + i, g - f)
        back = complex(a - d, -(c + b)) * complex(e - i, g + f)
        first += 2 * (a * a + b * b + c * c + d * d)
        second += 2 * (e * e + f * f + g * g + i * i)
        out[0, h], out[1, h] = ahead.real + back.real, back.imag - ahead.imag
        out[2, h], out[3, h] = ahead.imag + back.imag, ahead.real - back.real
    scale = max(math.sqrt(first * second), 1e-12)
    for k in range(4):
        for h in range(HARMONICS):
            out[k, h] /= scale
    return out


@compiled
def _score(shape: Array, place: Array, flat: float, turns: float) -> float:
    """Return how well two outlines match at one shift, in turns."""
    step = complex(math.cos(2 * math.pi * turns), math.sin(2 * math.pi * turns))
    wave = step
    real = imaginary = still = 0.0
    for h in range(HARMONICS):
        real += shape[0, h] * wave.real + shape[1, h] * wave.imag
        imaginary += shape[2, h] * wave.real + shape[3, h] * wave.imag
        still += place[0, h] * wave.real + place[1, h] * wave.imag
        wave *= step
    return math.sqrt(real * real + imaginary * imaginary) + flat * still
