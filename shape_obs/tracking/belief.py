"""Estimate how far each point of a shape may be wrong: ``Shape.sigma``, the RMS error per axis.

The values are a first estimate. They are made of lengths alone, so that they can be calibrated against scenes with
truth: with Gaussian errors, 90 % of the points lie within 2.15 sigma of the truth in an image, 2.50 sigma in space.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.topology import Topology

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

#: Metres; of points in pixels the bound is the diagonal of the image.
MAX_SIGMA: Final = 1.0
# A visible point is off by this share of a step of the observation (a pixel, a voxel) and of the object's size: lengths
# are measured along all of it. In drawn ropes and sheets of 300...800 pixels 0.2...1 px.
_RESOLUTION_SHARE: Final = 0.5
_SIZE_SHARE: Final = 0.001
# What cannot be seen is expected to stray by this share of the arc length to the nearest point that can.
_HIDDEN_SHARE: Final = 0.25
# A shape that is not seen is expected to move by this share of the bound in a second: 0.25 m/s, or a quarter of the
# diagonal; a hand that carries an object moves so.
_DRIFT: Final = 0.25
# Noise of stereo depth, z^2 s / (f B), of a RealSense D455: subpixel error s of a disparity, and baseline B.
_DISPARITY_NOISE: Final = 0.08  # pixels
_BASELINE: Final = 0.095  # metres


def expected_error(
    unseen: Array,
    unmeasured: Array,
    residual: float | Array,
    bound: float,
    *,
    scale: float | Array = 1.0,
    depth_noise: Array | None = None,
) -> npt.NDArray[np.float32]:
    """Return the RMS error per axis that is expected of each point.

    Across the line of sight a point errs by the fit's residual and by a share of its distance from what is visible.
    Along it, by the noise of depth and by a share of its distance from what was measured. In space the three axes are
    averaged: ``sqrt((2 across^2 + along^2) / 3)``.

    Args:
        unseen: ``(N,)`` arc length to the nearest visible point, pixels or metres: 0 where visible, infinite where
            nothing is; see ``arc_to_nearest``.
        unmeasured: ``(N,)`` the same to the nearest valid point.
        residual: RMS error per axis of the fitted form, one number or ``(N,)``, in the unit of ``unseen``.
        bound: Largest value returned.
        scale: Metres per pixel at each point, ``z / f``, where the lengths are in pixels and the points in metres.
        depth_noise: ``(N,)`` metres, see ``stereo_noise``; None for points in an image, or in a cloud without a camera.

    Returns:
        ``(N,)`` float32, finite, 0...``bound``, in the unit of the points; the bound where an argument is not a number.
    """
    across = scale * np.hypot(residual, _HIDDEN_SHARE * unseen)
    if depth_noise is not None:
        along = np.hypot(depth_noise, scale * _HIDDEN_SHARE * unmeasured)
        across = np.sqrt((2 * across**2 + along**2) / 3)
    return _bounded(across + np.zeros(len(unseen)), bound)


def aged(sigma: npt.NDArray[np.float32], age: float, bound: float) -> npt.NDArray[np.float32]:
    """Return the RMS error of points that were last seen ``age`` seconds ago and have moved unseen since.

    Args:
        sigma: ``(N,)`` when they were seen.
        age: Seconds.
        bound: Largest value returned; the points are expected to move by a quarter of it in a second.
    """
    return _bounded(np.hypot(sigma.astype(np.float64), _DRIFT * bound * age), bound)


def residual_of(size: float, resolution: float) -> float:
    """Return the RMS error per axis of the visible part of a form whose fit gives none.

    Args:
        size: Of the form, see ``FittedForm.size``, pixels or metres.
        resolution: Of the observation: a pixel, or the distance of a cloud's points, in the same unit.
    """
    return float(np.hypot(_RESOLUTION_SHARE * resolution, _SIZE_SHARE * size))


def stereo_noise(z: Array, focal: float) -> Array:
    """Return the standard deviation of depth ``(N,)`` metres at a depth ``z`` ``(N,)`` metres, of a D455.

    Args:
        z: Depth, metres; NaN stays NaN.
        focal: Focal length of the image, pixels.
    """
    return z**2 * (_DISPARITY_NOISE / (focal * _BASELINE))


def arc_to_nearest(points: Array, layout: Topology, known: Mask) -> Array:
    """Return the length of the way along the layout from each point to the nearest known one.

    Args:
        points: ``(N, D)``, all finite.
        layout: How the points are connected.
        known: ``(N,)`` bool.

    Returns:
        ``(N,)`` in the unit of the points: 0 where known, infinite if no point is.
    """
    if known.all():
        return np.zeros(len(points))
    if not known.any():
        return np.full(len(points), np.inf)
    edges = np.ascontiguousarray(layout.edges(), dtype=np.int64)
    return shortest_ways(np.ascontiguousarray(points, dtype=np.float64), edges, np.where(known, 0.0, np.inf))


@compiled("(f8[:,::1], i8[:,::1], f8[::1])")
def shortest_ways(points: Array, edges: npt.NDArray[np.int64], start: Array) -> Array:
    """Return the length of the shortest way along ``(E, 2)`` edges from each point to a point whose ``start`` is 0.

    Edges are relaxed forwards and backwards until nothing changes (Bellman and Ford): along a chain once.

    Args:
        points: ``(N, D)``.
        edges: ``(E, 2)`` pairs of points.
        start: ``(N,)`` 0 or infinite.
    """
    arc, changed = start.copy(), True
    while changed:
        changed = False
        for sweep in range(2 * len(edges)):
            e = sweep if sweep < len(edges) else 2 * len(edges) - 1 - sweep
            i, j = edges[e, 0], edges[e, 1]
            square = 0.0
            for d in range(points.shape[1]):
                square += (points[i, d] - points[j, d]) ** 2
            length = math.sqrt(square)
            if arc[i] + length < arc[j]:
                arc[j], changed = arc[i] + length, True
            if arc[j] + length < arc[i]:
                arc[i], changed = arc[j] + length, True
    return arc


def _bounded(sigma: Array, bound: float) -> npt.NDArray[np.float32]:
    """Return finite float32 numbers, at most the bound."""
    return np.fmin(sigma, bound).astype(np.float32)
