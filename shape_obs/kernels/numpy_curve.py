"""Curves as polylines, on NumPy."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from shape_obs.kernels.interface import EQUAL, EQUALISING_PASSES, JUDGED, Array
from shape_obs.kernels.numpy_map import best_matching_units
from shape_obs.kernels.numpy_plane import lengths, plane, points_of


def arc_length(curve: Array) -> Array:
    """See ``Kernels.arc_length``."""
    arc = np.zeros(len(curve))
    lengths(curve[1:] - curve[:-1]).cumsum(out=arc[1:])
    return arc


def interpolate(curve: Array, arc: Array, at: Array) -> Array:
    """See ``Kernels.interpolate``."""
    if curve.shape[1] == 2:
        return points_of(np.interp(at, arc, plane(curve)))
    out = np.empty((len(at), curve.shape[1]))
    for d in range(curve.shape[1]):
        out[:, d] = np.interp(at, arc, curve[:, d])
    return out


def unshrink(nodes: Array, share: float, closed: bool) -> Array:
    """See ``Kernels.unshrink``."""
    if closed:
        around = np.concatenate([nodes[-1:], nodes, nodes[:1]])
        return nodes - share * (around[2:] - 2 * nodes + around[:-2])
    bend = nodes[2:] - 2 * nodes[1:-1] + nodes[:-2]
    out = nodes.copy()
    out[1:-1] -= share * bend
    out[0] -= bend[0] / 24
    out[-1] -= bend[-1] / 24
    return out


def catmull_rom(nodes: Array, subdivisions: int = 4, closed: bool = False) -> Array:
    """See ``Kernels.catmull_rom``."""
    if closed:
        around = catmull_rom(np.concatenate([nodes[-1:], nodes, nodes[:2]]), subdivisions, False)
        return around[subdivisions : -subdivisions - 1]
    step = nodes[1:] - nodes[:-1]
    gap = np.maximum(np.sqrt(np.einsum("kd,kd->k", step, step)), 1e-9)[:, None]
    slope = step / gap
    tangent = np.empty_like(nodes)
    tangent[1:-1] = (slope[:-1] * gap[1:] + slope[1:] * gap[:-1]) / (gap[:-1] + gap[1:])
    tangent[0], tangent[-1] = 2 * slope[0] - tangent[1], 2 * slope[-1] - tangent[-2]
    ends = np.empty((4, *step.shape))
    ends[0], ends[1] = nodes[:-1], nodes[1:]
    np.multiply(gap, tangent[:-1], out=ends[2])
    np.multiply(gap, tangent[1:], out=ends[3])
    out = np.empty((len(step) * subdivisions + 1, nodes.shape[1]))
    pieces = (_hermite(subdivisions) @ ends.reshape(4, -1)).reshape(subdivisions, *step.shape)
    out[:-1].reshape(len(step), subdivisions, -1)[:] = pieces.swapaxes(0, 1)
    out[-1] = nodes[-1]
    return out


@lru_cache
def _hermite(subdivisions: int) -> Array:
    """(S,4) weights of the first and last place, and of the first and last tangent, along a cubic piece."""
    t = np.arange(subdivisions) / subdivisions
    return np.stack([(1 + 2 * t) * (1 - t) ** 2, t**2 * (3 - 2 * t), t * (1 - t) ** 2, -(t**2) * (1 - t)], axis=1)


def equidistant(curve: Array, arc: Array, count: int, margin: float, max_shift: float) -> Array:
    """See ``Kernels.equidistant``."""
    share, last = _shares(count), float(arc[-1])
    even = at = margin + (last - 2 * margin) * share
    shift = max_shift * (even[1] - even[0])
    for _ in range(EQUALISING_PASSES):
        chord = arc_length(interpolate(curve, arc, at))
        gaps = chord[1:] - chord[:-1]
        if gaps.max() - gaps.min() < EQUAL * chord[-1] / count:
            break
        at = np.interp(chord[-1] * share, chord, at)
        at = np.minimum(np.maximum(at, even - shift), even + shift)
    return at


@lru_cache
def _shares(count: int) -> Array:
    """(count,) from 0 to 1."""
    return np.linspace(0.0, 1.0, count)


def spread(points: Array, weight: Array, curve: Array) -> float:
    """See ``Kernels.spread``."""
    step = -(-len(points) // JUDGED)
    points, weight = points[::step], weight[::step]
    nearest = best_matching_units(points, curve)
    tangent = np.empty_like(curve)
    tangent[1:-1] = (curve[2:] - curve[:-2]) / 2
    tangent[0], tangent[-1] = curve[1] - curve[0], curve[-1] - curve[-2]
    reach = np.sqrt(np.einsum("pd,pd->p", tangent, tangent))
    tangent /= np.maximum(reach, 1e-9)[:, None]
    offset = points - curve[nearest]
    along = np.einsum("md,md->m", offset, tangent[nearest])
    reach = reach[nearest]
    beyond = np.minimum(np.maximum(along, -reach), reach)
    square = np.maximum(np.einsum("md,md->m", offset, offset) - 2 * along * beyond + beyond * beyond, 0.0)
    return float(weight @ square / weight.sum())
