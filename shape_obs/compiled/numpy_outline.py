"""Outlines on NumPy. Points of the plane are complex numbers here: one array, and turning is a product."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from scipy.ndimage import correlate1d

from shape_obs.compiled.interface_outline import (
    FLAT,
    HARMONICS,
    JUDGED_AROUND,
    PEAKS,
    SHIFTS,
    SPECK,
    STAIRCASE,
    STAIRCASE_REACH,
    TURNING,
    Array,
    Box,
    Indices,
    Mask,
)
from shape_obs.compiled.numpy_curve import arc_length, interpolate
from shape_obs.compiled.numpy_map import best_matching_units
from shape_obs.compiled.numpy_plane import Complex, lengths, plane, points_of

_AT = np.arange(-STAIRCASE_REACH, STAIRCASE_REACH + 1)
_SMOOTH = np.exp(-0.5 * (_AT / STAIRCASE) ** 2)
_SMOOTH /= _SMOOTH.sum()
# The way from the point before to the point after, on the smoothed outline.
_ALONG = np.convolve(_SMOOTH, [-1.0, 0.0, 1.0][::-1])[::-1]
_WAVES = np.concatenate([np.arange(1, HARMONICS + 1), np.arange(-HARMONICS, 0)])
_ROUND = np.exp(2j * np.pi / SHIFTS * np.outer(_WAVES, np.arange(SHIFTS)))
_BESIDE = tuple(np.exp(2j * np.pi * width * np.outer(_WAVES, (-1, 0, 1))) for width in PEAKS)


def traced(mask: Mask, runs: Indices, left: int, top: int, box: Box) -> tuple[Array, float, float]:
    """See ``OutlineKernels.traced``."""
    u, v, width, height = box
    return outline_in(mask[v - top : v - top + height, u - left : u - left + width], u, v)


def outline_in(mask: Mask, left: int, top: int) -> tuple[Array, float, float]:
    """See ``OutlineKernels.traced``; of a mask that may be a view, without anything around the piece."""
    contours, table = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    parents = np.asarray(table).reshape(-1, 4)[:, 3].tolist()
    outline = np.asarray(contours[parents.index(-1)]).reshape(-1, 2) + (float(left), float(top))
    inner = [hole for hole, parent in zip(contours, parents, strict=True) if parent >= 0 and len(hole) >= SPECK]
    return outline, length_around(outline), sum(cv2.arcLength(hole, closed=True) for hole in inner)


def length_around(outline: Array) -> float:
    """Length of a closed outline (P,2)."""
    z = plane(outline)
    return float(np.abs(z[1:] - z[:-1]).sum() + abs(z[0] - z[-1]))


def border(traced: Array, hole: bool) -> tuple[Array, Array]:
    """See ``OutlineKernels.border``."""
    z = plane(traced) - plane(traced)[0]
    if np.vdot(z[:-1], z[1:]).imag < 0:
        traced = traced[::-1].copy()
    along = plane(correlate1d(traced, _ALONG, axis=0, mode="wrap"))
    reach, size = np.maximum(np.abs(along.real), np.abs(along.imag)), np.abs(along)
    points = points_of(plane(traced) + (0.5j if hole else -0.5j) * along * (reach / np.maximum(size * size, 1e-18)))
    return points, correlate1d(points, _SMOOTH, axis=0, mode="wrap")


def pairs(points: Array) -> Array:
    """See ``OutlineKernels.pairs``."""
    half = len(points) // 2
    means = (points[: 2 * half : 2] + points[1::2]) / 2
    return means if len(points) == 2 * half else np.concatenate([means, points[-1:]])


def followed(points: Array, reference: Array, predicted: Array, share: float) -> tuple[Array, Array, Array, Array]:
    """See ``OutlineKernels.followed``."""
    closed = np.concatenate([points, points[:1]])
    arc = arc_length(closed)
    count = len(predicted)
    start = lag(reference, predicted, _even(closed, arc, count)) * (arc[-1] / count)
    turned = begun_at(closed, arc, start)
    arc = arc_length(turned)
    nodes = _even(turned, arc, count)
    return turned[:-1], arc, nodes, blend(reference, nodes, share)


def begun_at(closed: Array, arc: Array, start: float) -> Array:
    """(P+1,D) a closed curve, its first point repeated, with a point at an arc position as its first: (P'+1,D)."""
    size = arc[-1]
    start %= size
    same = 1e-9 * size
    if start + same >= size:
        start = 0.0
    after = int(np.searchsorted(arc, start + same))
    before = after - 1
    share = (start - arc[before]) / max(arc[after] - arc[before], same)
    first = closed[before : before + 1] + share * (closed[after] - closed[before])
    if start - arc[before] > same:  # else the point is there already
        before += 1
    return np.concatenate([first, closed[after:-1], closed[:before], first])


def lag(reference: Array, predicted: Array, found: Array) -> float:
    """See ``OutlineKernels.lag``.

    For every cyclic shift, what the best rotation of one outline onto the other is worth is the absolute value of
    their correlation, and what they are worth as they lie is its real part.
    """
    shape, place, seen = plane(np.stack([reference, predicted, found])) @ _waves(len(found))
    power = np.abs(np.array([np.vdot(waves, waves) for waves in (shape, place, seen)]))
    spectra = np.stack([shape, place]).conj() * seen / np.maximum(np.sqrt(power[:2] * power[2]), 1e-12)[:, None]
    turned, still = spectra @ _ROUND
    turned, still = np.abs(turned), still.real
    contrast = float(turned.max() - turned.min())
    flat = FLAT / (1 + contrast / FLAT)
    at = _climb(turned + flat * still, int(np.argmax(turned + TURNING * still))) / SHIFTS
    for width, beside in zip(PEAKS, _BESIDE, strict=True):
        turned, still = (spectra * np.exp(2j * np.pi * at * _WAVES)) @ beside
        low, middle, high = (np.abs(turned) + flat * still.real).tolist()
        bend = low - 2 * middle + high
        at += width * min(max((low - high) / (2 * bend), -1.0), 1.0) if bend < 0 else 0.0
    return at * len(found)


def blend(reference: Array, found: Array, share: float) -> Array:
    """See ``OutlineKernels.blend``."""
    before, after = plane(reference), plane(found)
    before, after = before - before.sum() / len(before), after - after.sum() / len(after)
    turn = np.vdot(before, after)
    turn = turn / abs(turn) if turn else 1.0
    return found + points_of((1 - share) * (before * turn - after))


def miss(points: Array, curve: Array, size: float) -> float:
    """See ``OutlineKernels.miss``."""
    points = points[:: -(-len(points) // JUDGED_AROUND)]
    nearest = best_matching_units(points, curve)
    closed = np.concatenate([curve[-1:], curve, curve[:1]])
    tangent = closed[2:] - closed[:-2]
    tangent /= np.maximum(lengths(tangent), 1e-9)[:, None]
    offset = points - curve[nearest]
    along = np.einsum("md,md->m", offset, tangent[nearest])
    square = np.einsum("md,md->m", offset, offset) - along * along
    beyond = np.maximum(np.abs(along) - size / len(curve), 0.0)
    return float(np.sqrt(np.maximum(square, 0.0) + beyond * beyond).sum()) / len(points)


def _even(closed: Array, arc: Array, count: int) -> Array:
    """(count,D) places of equal arc length around a closed curve (P+1,D), from its first point on."""
    return interpolate(closed, arc, np.arange(count) * (arc[-1] / count))


@lru_cache(maxsize=16)
def _waves(count: int) -> Complex:
    """(count,2H) what takes ``count`` places around an outline to its waves: a few columns of a Fourier transform."""
    return np.exp(-2j * np.pi / count * np.outer(np.arange(count), _WAVES))


def _climb(score: Array, at: int) -> int:
    """The nearest summit uphill from an index, around a ring."""
    size = len(score)
    while True:
        before, here, after = score[at - 1], score[at], score[(at + 1) % size]
        if max(before, after) <= here:
            return at
        at = (at - 1 if before >= after else at + 1) % size
