"""Curves as polylines, on NumPy."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from shape_obs.compiled.interface import EQUAL, EQUALISING_PASSES, JUDGED, Array
from shape_obs.compiled.numpy_map import best_matching_units
from shape_obs.compiled.numpy_plane import lengths, plane, points_of


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
    return _unshrinking(len(nodes), share) @ nodes


@lru_cache
def _unshrinking(size: int, share: float) -> Array:
    """(K,K) what ``unshrink`` does to the nodes of an open line."""
    table = np.eye(size)
    for k in range(size):
        at, by = (k, share) if 0 < k < size - 1 else (min(max(k, 1), size - 2), 1 / 24)
        table[k, at - 1 : at + 2] -= by * np.array([1.0, -2.0, 1.0])
    return table


def catmull_rom(nodes: Array, subdivisions: int = 4, closed: bool = False) -> Array:
    """See ``Kernels.catmull_rom``."""
    if closed:
        around = catmull_rom(np.concatenate([nodes[-1:], nodes, nodes[:2]]), subdivisions, False)
        return around[subdivisions : -subdivisions - 1]
    flat = nodes.shape[1] == 2
    places = plane(nodes) if flat else nodes
    step = places[1:] - places[:-1]
    gap = np.maximum(np.abs(step) if flat else lengths(nodes[1:] - nodes[:-1])[:, None], 1e-9)
    slope, before, after = step / gap, gap[:-1], gap[1:]
    tangent = np.empty_like(places)
    tangent[1:-1] = (slope[:-1] * after + slope[1:] * before) / (before + after)
    tangent[0], tangent[-1] = 2 * slope[0] - tangent[1], 2 * slope[-1] - tangent[-2]
    ends = np.empty((4, *step.shape), step.dtype)
    ends[0], ends[1] = places[:-1], places[1:]
    np.multiply(gap, tangent[:-1], out=ends[2])
    np.multiply(gap, tangent[1:], out=ends[3])
    out = np.empty((len(step) * subdivisions + 1, nodes.shape[1]))
    pieces = (_hermite(subdivisions) @ ends.view(np.float64).reshape(4, -1)).view(step.dtype)
    drawn = plane(out) if flat else out
    drawn[:-1].reshape(len(step), subdivisions, *step.shape[1:])[:] = pieces.reshape(-1, *step.shape).swapaxes(0, 1)
    drawn[-1] = places[-1]
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
    low, high = even - shift, even + shift
    for _ in range(EQUALISING_PASSES):
        chord = arc_length(interpolate(curve, arc, at))
        gaps = chord[1:] - chord[:-1]
        if gaps.max() - gaps.min() < EQUAL * chord[-1] / count:
            break
        at = np.interp(chord[-1] * share, chord, at)
        np.minimum(np.maximum(at, low, out=at), high, out=at)
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
    tangent[1:-1] = (curve[2:] - curve[:-2]) * 0.5
    tangent[0], tangent[-1] = curve[1] - curve[0], curve[-1] - curve[-2]
    if curve.shape[1] == 2:
        forward = plane(tangent)
        reach = np.abs(forward)
        turn = forward.conj() / np.maximum(reach, 1e-9)
        offset = (plane(points) - plane(curve)[nearest]) * turn[nearest]
        along, square = np.abs(offset.real), offset.imag**2
    else:
        reach = lengths(tangent)
        tangent /= np.maximum(reach, 1e-9)[:, None]
        offset = points - curve[nearest]
        along = np.abs(np.einsum("md,md->m", offset, tangent[nearest]))
        square = np.maximum(np.einsum("md,md->m", offset, offset) - along * along, 0.0)
    beyond = np.maximum(along - reach[nearest], 0.0)
    return float(weight @ (square + beyond * beyond) / weight.sum())
