"""Outlines of masks: from the pixels that a contour runs through to where the material ends."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import FittedCurve

Array = npt.NDArray[np.float64]

SAMPLED: Final = 2  # points of an outline in one sample: half the work, and no bend is lost
# Smoothing along an outline, in its steps: enough to see a direction and a length through the staircase of pixels, at
# 0.2 px off a bend of radius 10. What is fitted is not smoothed.
_STAIRCASE: Final = 2.0
_PAD: Final = 4
_GAUSSIAN = np.exp(-0.5 * (np.arange(_PAD + 1) / _STAIRCASE) ** 2)
_WEIGHTS = tuple((_GAUSSIAN / (2 * _GAUSSIAN.sum() - 1)).tolist())


@dataclass(frozen=True, eq=False)
class Outline:
    """The boundary of a piece of a mask: its outer outline, or a hole's.

    Args:
        traced: ``(P, 2)`` pixels, image coordinates, closed, either way round, through the centres of border pixels.
        hole: Whether the material lies outside.
    """

    traced: Array
    hole: bool = False

    @property
    def points(self) -> Array:
        """``(P, 2)`` where the material ends, clockwise as seen, still with the staircase of pixels."""
        return self._material[0]

    @property
    def smooth(self) -> Array:
        """``(P, 2)`` the same without the staircase, so that its length is the object's."""
        return self._material[1]

    @cached_property
    def curve(self) -> FittedCurve:
        """The smoothed outline."""
        return FittedCurve.through(self.smooth, np.zeros(len(self.smooth), bool), closed=True)

    @cached_property
    def _material(self) -> tuple[Array, Array]:
        return material_outline(np.ascontiguousarray(self.traced, dtype=np.float64), self.hole)


def clockwise(points: Array) -> bool:
    """Return whether a closed outline of ``(P, 2+)`` points runs clockwise as seen, v downwards."""
    u, v = points[:, 0] - points[0, 0], points[:, 1] - points[0, 1]
    return bool(u[:-1] @ v[1:] >= v[:-1] @ u[1:])


@compiled
def enclosed_by(traced: Array) -> float:
    """Return how many pixels lie within an outline ``(P, 2)`` through the centres of border pixels, half of them."""
    area = 0.0
    for p in range(len(traced)):
        area += traced[p - 1, 0] * traced[p, 1] - traced[p - 1, 1] * traced[p, 0]
    return abs(area) / 2 + len(traced) / 2


@compiled("(f8[:,::1], b1)")
def material_outline(traced: Array, hole: bool) -> tuple[Array, Array]:
    """Return where the material ends, clockwise as seen: with the staircase of pixels, and without.

    Per step along its main direction, a straight border runs through pixels that lie 0 to 1 px inside the edge, along
    the other axis: half a pixel on average there, so 0.5 max(|n_u|, |n_v|) along the normal n.

    Args:
        traced: ``(P, 2)`` through the centres of the border pixels, either way round.
        hole: Whether the material lies outside.

    Returns:
        ``(P, 2)`` the outline, and ``(P, 2)`` the same, smoothed.
    """
    size = len(traced)
    u, v = np.empty(size + 2 * _PAD), np.empty(size + 2 * _PAD)
    smooth_u, smooth_v = np.empty_like(u), np.empty_like(v)
    area = 0.0
    for p in range(size - 1):
        area += (traced[p, 0] - traced[0, 0]) * (traced[p + 1, 1] - traced[0, 1])
        area -= (traced[p, 1] - traced[0, 1]) * (traced[p + 1, 0] - traced[0, 0])
    first, step = (size - 1, -1) if area < 0 else (0, 1)
    for p in range(size):
        u[p + _PAD], v[p + _PAD] = traced[first + step * p, 0], traced[first + step * p, 1]
    _wrap(u)
    _wrap(v)
    _smoothed(u, smooth_u)
    _smoothed(v, smooth_v)
    points, side = np.empty((size, 2)), -1.0 if hole else 1.0
    for p in range(size):
        along_u = smooth_u[p + _PAD + 1] - smooth_u[p + _PAD - 1]
        along_v = smooth_v[p + _PAD + 1] - smooth_v[p + _PAD - 1]
        shift = 0.5 * side * max(abs(along_u), abs(along_v)) / max(along_u * along_u + along_v * along_v, 1e-18)
        u[p + _PAD] += shift * along_v
        v[p + _PAD] -= shift * along_u
        points[p, 0], points[p, 1] = u[p + _PAD], v[p + _PAD]
    _wrap(u)
    _wrap(v)
    _smoothed(u, smooth_u)
    _smoothed(v, smooth_v)
    curve = np.empty((size, 2))
    for p in range(size):
        curve[p, 0], curve[p, 1] = smooth_u[p + _PAD], smooth_v[p + _PAD]
    return points, curve


@compiled
def _smoothed(padded: Array, out: Array) -> None:
    """Fill ``out`` with a ring of numbers smoothed by a Gaussian, written out for a padding of 4; both ``(P + 8,)``."""
    for p in range(len(padded) - 2 * _PAD):
        out[p + 4] = (
            _WEIGHTS[0] * padded[p + 4]
            + _WEIGHTS[1] * (padded[p + 3] + padded[p + 5])
            + _WEIGHTS[2] * (padded[p + 2] + padded[p + 6])
            + _WEIGHTS[3] * (padded[p + 1] + padded[p + 7])
            + _WEIGHTS[4] * (padded[p] + padded[p + 8])
        )
    _wrap(out)


@compiled
def _wrap(padded: Array) -> None:
    """Fill the padding before and behind a ring of numbers."""
    size = len(padded) - 2 * _PAD
    for i in range(_PAD):
        padded[i] = padded[_PAD + (i - _PAD) % size]
        padded[_PAD + size + i] = padded[_PAD + i % size]


@compiled
def wave_table(size: int, count: int) -> tuple[Array, Array]:
    """Return cosines and sines of the first waves around ``size`` points, from the longest: both ``(count, size)``."""
    cos, sin = np.empty((count, size)), np.empty((count, size))
    for k in range(size):
        cos[0, k], sin[0, k] = math.cos(2 * math.pi * k / size), math.sin(2 * math.pi * k / size)
    along, across = cos[0], sin[0]
    for h in range(1, count):
        a, b, c, d = cos[h - 1], sin[h - 1], cos[h], sin[h]
        for k in range(size):
            c[k], d[k] = a[k] * along[k] - b[k] * across[k], b[k] * along[k] + a[k] * across[k]
    return cos, sin


@compiled(reassociate=True)
def waves(points: Array, cos: Array, sin: Array) -> Array:
    """Return the first waves around a closed curve: ``(2 D, count)``.

    Row 2d holds the sums of coordinate d times the cosine of each wave, and row 2d + 1 those with the sine.

    Args:
        points: ``(K, D)`` equidistant.
        cos: ``(count, K)``, see ``wave_table``.
        sin: The same.
    """
    (size, dimension), count = points.shape, len(cos)
    row, out = np.empty(size), np.empty((2 * dimension, count))
    for d in range(dimension):
        for k in range(size):
            row[k] = points[k, d]
        for h in range(count):
            with_cos = with_sin = 0.0
            for k in range(size):
                with_cos += row[k] * cos[h, k]
                with_sin += row[k] * sin[h, k]
            out[2 * d, h], out[2 * d + 1, h] = with_cos, with_sin
    return out


@compiled
def unround(spectrum: Array) -> float:
    """Return which share of an outline's waves ``(2 D, H)`` is not a circle's, 0...1."""
    ahead = across = both = total = 0.0
    for d in range(len(spectrum) // 2):
        a, b = spectrum[2 * d, 0], spectrum[2 * d + 1, 0]
        ahead, across, both = ahead + a * a, across + b * b, both + a * b
        for h in range(spectrum.shape[1]):
            total += spectrum[2 * d, h] ** 2 + spectrum[2 * d + 1, h] ** 2
    circle = (ahead + across) / 2 + math.sqrt(max(ahead * across - both * both, 0.0))
    return max(1 - circle / max(total, 1e-18), 0.0)


@compiled
def pairs(points: Array) -> Array:
    """Return the mean of each two points, the last alone if they are odd: ``(P, D)`` -> ``(ceil(P / 2), D)``."""
    size, dimension = points.shape
    out = np.empty(((size + 1) // 2, dimension))
    for p in range(size // 2):
        for d in range(dimension):
            out[p, d] = (points[2 * p, d] + points[2 * p + 1, d]) / 2
    if size % 2:
        for d in range(dimension):
            out[size // 2, d] = points[size - 1, d]
    return out


@compiled
def with_turning(nodes: Array, velocity: Array, share: float) -> Array:
    """Return velocities ``(K, D)`` of the nodes of a closed curve with a share of their common motion along it."""
    count, moved, square = len(nodes), 0.0, 0.0
    along = np.empty_like(nodes)
    for k in range(count):
        for d in range(nodes.shape[1]):
            along[k, d] = nodes[(k + 1) % count, d] - nodes[k - 1, d]
            moved += along[k, d] * velocity[k, d]
            square += along[k, d] ** 2
    return velocity + (share - 1) * moved / max(square, 1e-18) * along
