"""Curves as polylines: arc length, smooth interpolation, equidistant sampling. Any dimension."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# Chords are equalised this often, and no point leaves its arc position by more than this share of a gap: where a
# hairpin is narrower than a gap, equal chords would cost the points their places on the material.
_EQUALISING_PASSES = 40
_MAX_SHIFT = 0.35
# Around an outline with many corners, each of which shortens a chord, equal chords need more room.
_MAX_SHIFT_AROUND = 1.5
_EQUAL = 2e-3


def arc_length(curve: Array) -> Array:
    """(P,D) -> (P,) arc length from the first point."""
    step = np.diff(curve, axis=0)
    return np.concatenate([[0.0], np.cumsum(np.sqrt(np.einsum("pd,pd->p", step, step)))])


def interpolate(curve: Array, arc: Array, at: Array) -> Array:
    """Points of a polyline at arc positions ``at``: (P,D), (P,), (N,) -> (N,D)."""
    return np.stack([np.interp(at, arc, curve[:, d]) for d in range(curve.shape[1])], axis=1)


def resample(curve: Array, count: int) -> Array:
    """``count`` points of equal arc length from end to end: (P,D) -> (count,D)."""
    arc = arc_length(curve)
    return interpolate(curve, arc, np.linspace(0.0, arc[-1], count))


def catmull_rom(nodes: Array, subdivisions: int = 4, *, closed: bool = False) -> Array:
    """A smooth curve through nodes, for uneven gaps too.

    Cubic Hermite pieces over the chord length with the three-point tangents of Catmull and Rom ("A Class of Local
    Interpolating Splines", 1974).

    Args:
        nodes: (K,D), K >= 3, no two neighbours equal.
        subdivisions: Pieces between two nodes.
        closed: Whether the last node is followed by the first.

    Returns:
        ((K-1) * subdivisions + 1, D) points, the nodes among them; (K * subdivisions, D) when closed.
    """
    if closed:
        around = catmull_rom(np.concatenate([nodes[-1:], nodes, nodes[:2]]), subdivisions)
        return around[subdivisions : -subdivisions - 1]
    step = np.diff(nodes, axis=0)
    gap = np.maximum(np.sqrt(np.einsum("kd,kd->k", step, step)), 1e-9)[:, None]
    slope = step / gap
    tangent = np.empty_like(nodes)
    tangent[1:-1] = (slope[:-1] * gap[1:] + slope[1:] * gap[:-1]) / (gap[:-1] + gap[1:])
    tangent[0], tangent[-1] = 2 * slope[0] - tangent[1], 2 * slope[-1] - tangent[-2]
    t = (np.arange(subdivisions) / subdivisions)[:, None, None]
    pieces = (
        (1 + 2 * t) * (1 - t) ** 2 * nodes[:-1]
        + t**2 * (3 - 2 * t) * nodes[1:]
        + t * (1 - t) * gap * ((1 - t) * tangent[:-1] - t * tangent[1:])
    )
    return np.concatenate([pieces.swapaxes(0, 1).reshape(-1, nodes.shape[1]), nodes[-1:]])


def equidistant_positions(
    curve: Array, arc: Array, count: int, *, centers: bool, max_shift: float = _MAX_SHIFT
) -> Array:
    """Arc positions of ``count`` >= 2 points with equal chords.

    Args:
        curve: (P,D).
        arc: (P,) its arc length.
        count: How many.
        centers: Points at the middle of ``count`` equal pieces; else the first and last at the curve's ends.
        max_shift: Gaps by which a point may leave its place by arc length.

    Returns:
        (count,) arc positions, increasing.
    """
    margin = arc[-1] / (2 * count) if centers else 0.0
    even = at = np.linspace(margin, arc[-1] - margin, count)
    shift = max_shift * (even[1] - even[0])
    for _ in range(_EQUALISING_PASSES):
        chord = arc_length(interpolate(curve, arc, at))
        gaps = np.diff(chord)
        if np.ptp(gaps) < _EQUAL * chord[-1] / count:
            break
        at = np.interp(np.linspace(0.0, chord[-1], count), chord, at)
        at = np.clip(at, even - shift, even + shift)
    return at


def equidistant_around(curve: Array, arc: Array, count: int) -> Array:
    """Arc positions of ``count`` >= 2 points with equal chords around a closed curve, the first at its first point.

    Args:
        curve: (P,D), the first point not repeated.
        arc: (P+1,) its arc length, the last entry the whole.
        count: How many.

    Returns:
        (count,) arc positions, increasing from 0.
    """
    around = np.concatenate([curve, curve[:1]])
    return equidistant_positions(around, arc, count + 1, centers=False, max_shift=_MAX_SHIFT_AROUND)[:-1]
