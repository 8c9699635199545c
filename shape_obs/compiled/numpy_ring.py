"""A ring of nodes that settles on an outline, on NumPy. Points of the plane are complex numbers."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from shape_obs.compiled.interface import TRACE
from shape_obs.compiled.interface_outline import CELL, JUDGED_AROUND, Array, Indices
from shape_obs.compiled.numpy_plane import Complex, plane, points_of

_BESIDE = 2  # nodes, and by
_NEAR = 6  # points of the curve, how far off the nearest can be from where a sample lies along


def ring(points: Array, smooth: Array, place: Array, count: int, sigma: float, pieces: int) -> tuple[Array, float]:
    """See ``OutlineKernels.ring``."""
    z = plane(smooth)
    closed = np.concatenate([z, z[:1]])
    arc = np.zeros(len(closed))
    np.cumsum(np.abs(closed[1:] - z), out=arc[1:])
    begin, gap = arc[np.argmin(np.abs(z - complex(*place)))], arc[-1] / count
    nodes = np.interp((begin + np.arange(count) * gap) % arc[-1], arc, closed)
    middle = nodes.sum() / count
    nodes -= middle
    samples = _paired(plane(points)) - middle
    along = np.rint((_paired(arc[:-1]) - begin) / gap).astype(np.intp)
    unit = _nearest(samples, nodes, along, _BESIDE)
    weight = np.full(len(samples), float(CELL))
    if len(z) % CELL:
        weight[-1] = 1.0
    trace = TRACE * len(z) / count
    held = np.bincount(unit, weight, count) + trace
    total = trace * nodes
    weighted = samples * weight
    total.real += np.bincount(unit, weighted.real, count)
    total.imag += np.bincount(unit, weighted.imag, count)
    h = _neighbours(count, sigma)
    s0, s1, s2 = (h @ held).reshape(3, count)
    t0, t1 = plane(h[: 2 * count] @ points_of(total)).reshape(2, count)
    nodes = (s2 * t0 - s1 * t1) / (s0 * s2 - s1 * s1)
    beside = np.exp(-0.5 / sigma**2)
    ends = np.concatenate([nodes[-1:], nodes, nodes[:1]])
    nodes -= (1 / 24 + beside / (1 + 2 * beside)) * (ends[2:] - 2 * nodes + ends[:-2])
    curve = _through(nodes, pieces)
    skip = -(-len(samples) // JUDGED_AROUND)
    return points_of(curve + middle), _missed(samples[::skip], curve, unit[::skip] * pieces)


def _paired(values: Any) -> Any:
    """The mean of each two values, the last alone where they are odd."""
    half = len(values) // CELL
    means = (values[: CELL * half : CELL] + values[1::CELL]) / CELL
    return means if len(values) == CELL * half else np.concatenate([means, values[-1:]])


def _through(nodes: Complex, pieces: int) -> Complex:
    """``Kernels.catmull_rom``, closed."""
    ends = np.concatenate([nodes, nodes[:1]])
    step = ends[1:] - nodes
    gap = np.maximum(np.abs(step), 1e-9)
    slope = step / gap
    before, back = np.concatenate([gap[-1:], gap[:-1]]), np.concatenate([slope[-1:], slope[:-1]])
    tangent = (back * gap + slope * before) / (before + gap)
    after = np.concatenate([tangent[1:], tangent[:1]])
    return (np.stack([nodes, ends[1:], gap * tangent, gap * after], axis=1) @ _hermite(pieces)).ravel()


def _nearest(samples: Complex, places: Complex, about: Indices, reach: int) -> Indices:
    """(M,) which of (P,) places around a ring is nearest to each sample, at most ``reach`` from its one ``about``."""
    ring = np.concatenate([places[-reach:], places, places[:reach]])
    first = about % len(places)
    near = ring[first[:, None] + np.arange(2 * reach + 1)]
    return (first + np.abs(near - samples[:, None]).argmin(axis=1) - reach) % len(places)


def _missed(samples: Complex, curve: Complex, about: Indices) -> float:
    """Mean distance of (M,) samples from the tangents of a curve (P,), each near its point ``about`` (M,)."""
    ends = np.concatenate([curve[-1:], curve, curve[:1]])
    nearest = _nearest(samples, curve, about, _NEAR)
    tangent = ends[nearest + 2] - ends[nearest]
    offset = (samples - curve[nearest]) * tangent.conj() / np.maximum(np.abs(tangent), 1e-9)
    beyond = np.maximum(np.abs(offset.real) - np.abs(ends[1:] - ends[:-1])[1:].sum() / len(curve), 0.0)
    return float(np.hypot(offset.imag, beyond).sum()) / len(samples)


@lru_cache(maxsize=16)
def _neighbours(count: int, sigma: float) -> Array:
    """(3*count,count) the kernel, times the offset, and times its square, see ``topology.Neighbourhood``."""
    at = np.arange(count, dtype=np.float64)
    offset = (at - at[:, None] + count // 2) % count - count // 2
    weight = np.exp(-0.5 * (offset / sigma) ** 2)
    return np.concatenate([weight, weight * offset, weight * offset**2])


@lru_cache(maxsize=4)
def _hermite(pieces: int) -> Array:
    """(4,pieces) how much the nodes and the tangents at both ends of a piece count at its points."""
    t = np.arange(pieces) / pieces
    return np.stack([(1 + 2 * t) * (1 - t) ** 2, t**2 * (3 - 2 * t), t * (1 - t) ** 2, -(t**2) * (1 - t)])
