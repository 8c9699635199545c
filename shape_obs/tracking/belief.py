"""Estimate how far each point of a shape may be wrong: ``Shape.sigma``, the RMS error per axis.

The values are made of lengths alone, and calibrated on scenes with truth (``shape-obs bench claims --only belief``):
about 90 % of the points lie within 2.15 sigma of the truth in an image, 2.50 sigma in space, as Gaussian errors do.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.topology import Chain, Grid, Ring, Topology

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

#: Metres; of points in pixels the bound is the diagonal of the image.
MAX_SIGMA: Final = 1.0


class Shares(NamedTuple):
    """What the errors of visible points of one kind of object are made of.

    Args:
        resolution: Share of a step of the observation (a pixel, a voxel).
        size: Share of the object's size: lengths are measured along all of it.
        depth: Multiple of a pixel's depth noise.
    """

    resolution: float
    size: float
    depth: float


# Measured with a D455's noise at 640 x 480 and 160 x 120. The depth of a sheet is that of many pixels; that of a rope
# is that of few, and the noise of those at its sides comes from what lies behind.
_SHARES: Final[dict[type[Topology], Shares]] = {
    Chain: Shares(0.25, 0.0005, 1.8),
    Ring: Shares(0.25, 0.0012, 1.0),
    Grid: Shares(0.2, 0.0004, 0.4),
}
_IN_CLOUDS: Final = Shares(0.5, 0.001, 1.0)
# A sheet's gaps are equal in space, so that points are off where they are not: by this multiple of what they differ.
_UNEVEN_SHARE: Final = 1.4
# What cannot be seen is expected to stray by this share of the arc length to the nearest point that can.
_HIDDEN_SHARE: Final = 0.25
# A shape that is not seen is expected to move by this share of the bound in a second: 0.25 m/s, or a quarter of the
# diagonal; a hand that carries an object moves so.
_DRIFT: Final = 0.25
# Noise of stereo depth, z^2 s / (f B), of a RealSense D455: subpixel error s of a disparity, and baseline B.
_DISPARITY_NOISE: Final = 0.08  # pixels
_BASELINE: Final = 0.095  # metres
_NATIVE: Final = 640  # columns; an image with fewer is one of this width that was made smaller


def expected_error(
    unseen: Array,
    unmeasured: Array,
    residual: float | Array,
    bound: float,
    *,
    stretch: float | Array = 1.0,
    depth_noise: Array | None = None,
) -> npt.NDArray[np.float32]:
    """Return the RMS error per axis that is expected of each point.

    Across the line of sight a point errs by the fit's residual, which is stretched along an object that is seen aslant,
    and by a share of its distance from what is visible. Along it, by the noise of depth and by a share of its distance
    from what was measured. In space the three axes are averaged.

    Args:
        unseen: ``(N,)`` arc length to the nearest visible point, pixels or metres: 0 where visible, infinite where
            nothing is; see ``arc_to_nearest``.
        unmeasured: ``(N,)`` the same to the nearest valid point.
        residual: RMS error per axis of the fitted form, one number or ``(N,)``, in the unit of ``unseen``.
        bound: Largest value returned.
        stretch: ``(N,)`` length along the object over its length in the image, see ``stretches``.
        depth_noise: ``(N,)`` metres, see ``stereo_noise``; None for points in an image, or in a cloud without a camera.

    Returns:
        ``(N,)`` float32, finite, 0...``bound``, in the unit of the points; the bound where an argument is not a number.
    """
    hidden = _HIDDEN_SHARE * unseen
    if depth_noise is None:
        return _bounded(np.hypot(residual, hidden), bound)
    across = np.square(residual) * (1 + np.square(stretch)) + 2 * hidden**2
    along = depth_noise**2 + (_HIDDEN_SHARE * unmeasured) ** 2
    return _bounded(np.sqrt((across + along) / 3), bound)


def aged(sigma: npt.NDArray[np.float32], age: float, bound: float) -> npt.NDArray[np.float32]:
    """Return the RMS error of points that were last seen ``age`` seconds ago and have moved unseen since.

    Args:
        sigma: ``(N,)`` when they were seen.
        age: Seconds.
        bound: Largest value returned; the points are expected to move by a quarter of it in a second.
    """
    return _bounded(np.hypot(sigma.astype(np.float64), _DRIFT * bound * age), bound)


def unevenness(points: Array, layout: Grid) -> Array:
    """Return the error per axis that the unequal gaps of a lattice in space show, ``(N,)`` metres.

    On drawn cloths that bend, the errors of the points are proportional to it.

    Args:
        points: ``(N, 3)`` metres.
        layout: The lattice.
    """
    edges = layout.edges()
    gaps = np.sqrt(np.sum((points[edges[:, 0]] - points[edges[:, 1]]) ** 2, axis=1))
    across = layout.rows * (layout.cols - 1)
    off = np.abs(np.concatenate([gaps[:across] - gaps[:across].mean(), gaps[across:] - gaps[across:].mean()]))
    ends, size = edges.ravel(), len(points)
    local = np.bincount(ends, np.repeat(off, 2), size) / np.bincount(ends, minlength=size)
    return _UNEVEN_SHARE * (local + off.mean()) / 2


def shares_of(layout: Topology, in_image: bool) -> Shares:
    """Return what the errors of visible points are made of, in images or in clouds."""
    return _SHARES.get(type(layout), _IN_CLOUDS) if in_image else _IN_CLOUDS


def stereo_noise(z: Array, focal: float, columns: int) -> Array:
    """Return the standard deviation of a pixel's depth ``(N,)`` metres at a depth ``z`` ``(N,)`` metres, of a D455.

    Args:
        z: Depth, metres; NaN stays NaN.
        focal: Focal length of the image, pixels.
        columns: Of the image.
    """
    return z**2 * (_DISPARITY_NOISE / (focal * max(_NATIVE / columns, 1.0) * _BASELINE))


def stretches(pixels: Array, points: Array, edges: npt.NDArray[np.intp], scale: Array) -> Array:
    """Return by how much the object is longer around each point than it looks, ``(N,)``, at least 1.

    Args:
        pixels: ``(N, 2)``.
        points: ``(N, 3)`` metres.
        edges: ``(E, 2)`` pairs of points.
        scale: ``(N,)`` metres per pixel across the line of sight, ``z / f``.
    """
    i, j = edges.T
    seen = np.sqrt(np.sum((pixels[i] - pixels[j]) ** 2, axis=1)) * (scale[i] + scale[j]) / 2
    long = np.sqrt(np.sum((points[i] - points[j]) ** 2, axis=1))
    size = len(pixels)
    total = [np.bincount(i, each, size) + np.bincount(j, each, size) for each in (long, seen)]
    return np.maximum(total[0] / np.maximum(total[1], 1e-9), 1.0)


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
