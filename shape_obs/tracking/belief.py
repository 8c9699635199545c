"""Estimate how far each point of a shape may be wrong: ``Shape.sigma``, the RMS error per axis.

The values are made of lengths alone, and calibrated on scenes with truth (``shape-obs bench claims --only belief``):
about 90 % of the points lie within 2.15 sigma of the truth in an image, 2.50 sigma in space, as Gaussian errors do.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics, stereo_noise
from shape_obs.compiled import compiled
from shape_obs.geometry.topology import Chain, Grid, Ring, Topology

Array = npt.NDArray[np.float64]
Points = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

#: Of points in pixels the bound is the diagonal of the image.
MAX_SIGMA: Final = 1.0  # metres: an object on a table is nowhere farther off


class Shares(NamedTuple):
    """What the errors of visible points of one kind of object are made of.

    Args:
        resolution: Share of a step of the observation (a pixel, a voxel).
        size: Share of the object's size: lengths are measured along all of it.
        depth: Multiple of a pixel's depth noise.
        aslant: Share of the object's length in space, of points where it is seen end-on: what is measured of the length
            there depends on depth.
    """

    resolution: float
    size: float
    depth: float
    aslant: float


# The depth of a sheet is that of many pixels; that of a rope is that of few, and the noise of those at its sides comes
# from what lies behind.
_SHARES: Final[dict[type[Topology], Shares]] = {
    Chain: Shares(0.35, 0.0005, 1.8, 0.013),
    Ring: Shares(0.25, 0.0012, 1.0, 0.0),
    Grid: Shares(0.2, 0.0004, 0.4, 0.0),
}  # measured with a D455's noise at 640 x 480 and 160 x 120
_IN_CLOUDS: Final = Shares(0.5, 0.001, 1.0, 0.0)  # measured with the same noise, in clouds of all three shapes
_UNEVEN_SHARE: Final = 1.4  # of the difference of a sheet's gaps, which are equal in space: so far are points off
_HIDDEN_SHARE: Final = 0.32  # of the arc length to the nearest visible point: what cannot be seen errs by so much
_DRIFT: Final = 0.25  # of the bound in a second, by which an unseen shape moves: a hand that carries it does 0.25 m/s


def errors_in_cloud(
    points: Points, visible: Mask, valid: Mask, layout: Topology, size: float, resolution: float,
    camera: Intrinsics | None, off: Array,
) -> npt.NDArray[np.float32]:  # fmt: skip
    """Return the RMS error per axis that is expected of each point of a shape in a cloud, see ``point_errors``.

    Args:
        points: ``(N, 3)`` metres.
        visible: ``(N,)`` bool.
        valid: ``(N,)`` bool.
        layout: How the points are connected.
        size: Of the form that was fitted, metres.
        resolution: The distance of the cloud's points, metres.
        camera: The projection; None if there is none.
        off: ``(N,)`` metres by which points of a sheet may be off within it, see ``Isometry``; ``(0,)`` without depth.

    Returns:
        ``(N,)`` float32 metres; finite, at most ``MAX_SIGMA``, which also stands where a point is not a number.
    """
    shares, focal, noise = _IN_CLOUDS, 0.0, 0.0
    if camera is not None:
        focal = (camera.fx + camera.fy) / 2
        noise = shares.depth * stereo_noise(focal, camera.width)
    edges, across, _ = known_layout(layout)
    residual = math.hypot(shares.resolution * resolution, shares.size * size)
    no_pixels = np.zeros((0, 2), np.float32)
    fitted = point_errors(
        points, no_pixels, visible, valid, edges, across, residual, shares.aslant, focal, noise, MAX_SIGMA
    )
    return fitted if len(off) == 0 else _bounded(np.hypot(fitted, off / math.sqrt(3)), MAX_SIGMA)


def error_on_sheet(z: float, camera: Intrinsics) -> float:
    """Return the RMS error per axis of a visible point of a sheet that lies flat at a depth ``z``, metres."""
    shares, focal = _SHARES[Grid], (camera.fx + camera.fy) / 2
    return math.hypot(shares.resolution * z / focal, shares.depth * stereo_noise(focal, camera.width) * z**2)


@lru_cache(maxsize=64)
def known_layout(layout: Topology) -> tuple[npt.NDArray[np.int64], int, Shares]:
    """Return ``(E, 2)`` neighbours, how many lie along the rows of a lattice, and what errors in images are made of."""
    across = layout.rows * (layout.cols - 1) if isinstance(layout, Grid) else 0
    return np.ascontiguousarray(layout.edges(), dtype=np.int64), across, _SHARES.get(type(layout), _IN_CLOUDS)


@compiled("(f4[:,::1], f4[:,::1], b1[::1], b1[::1], i8[:,::1], i8, f8, f8, f8, f8, f8)")
def point_errors(
    places: Points,
    pixels: Points,
    visible: Mask,
    valid: Mask,
    edges: npt.NDArray[np.int64],
    across: int,
    residual: float,
    aslant: float,
    focal: float,
    noise: float,
    bound: float,
) -> npt.NDArray[np.float32]:
    """Return the RMS error per axis that is expected of each point, ``(N,)``; finite, at most the bound.

    Across the line of sight a point errs by the fit's residual, which is stretched along an object that is seen aslant,
    and by a share of its distance from what is visible. Along it, by the noise of depth and by a share of its distance
    from what was measured. In space the three axes are averaged. A sheet's gaps are equal in space: where those of a
    lattice differ, its points are off.

    Args:
        places: ``(N, D)`` pixels or metres; those that were not measured where they are expected.
        pixels: ``(N, 2)``; ``(0, 2)`` if ``residual`` is in the unit of the places.
        visible: ``(N,)``.
        valid: ``(N,)``.
        edges: ``(E, 2)`` pairs of neighbours.
        across: How many of them lie along the rows of a lattice; 0 for other layouts.
        residual: RMS error per axis of the fitted form, pixels or the unit of the places.
        aslant: See ``Shares``.
        focal: Focal length, pixels; 0 without depth and a camera.
        noise: Standard deviation of depth at one metre, metres.
        bound: Largest value.
    """
    count, size = len(edges), len(places)
    gaps, out = np.empty(count), np.empty(size, np.float32)
    for e in range(count):
        square = 0.0
        for d in range(places.shape[1]):
            square += (places[edges[e, 0], d] - places[edges[e, 1], d]) ** 2
        gaps[e] = math.sqrt(square)
    unseen, unmeasured = shortest_ways(gaps, edges, visible), shortest_ways(gaps, edges, valid)
    long, seen, uneven, ends = np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(size)
    offs = 0.0
    if len(pixels) > 0:
        along, down = gaps[:across].sum() / max(across, 1), gaps[across:].sum() / max(count - across, 1)
        for e in range(count):
            i, j = edges[e, 0], edges[e, 1]
            looks = math.hypot(pixels[i, 0] - pixels[j, 0], pixels[i, 1] - pixels[j, 1])
            looks *= (places[i, 2] + places[j, 2]) / (2 * focal)
            off = abs(gaps[e] - (along if e < across else down)) if across > 0 else 0.0
            offs += off / count
            for k in (i, j):
                long[k] += gaps[e]
                seen[k] += looks
                uneven[k] += off
                ends[k] += 1.0
    for k in range(size):
        rough, stretch = residual, 1.0
        if len(pixels) > 0:
            stretch = max(long[k] / max(seen[k], 1e-9), 1.0)
            rough = math.hypot(
                residual * places[k, 2] / focal, _UNEVEN_SHARE * (uneven[k] / max(ends[k], 1.0) + offs) / 2
            )
        hidden = _HIDDEN_SHARE * unseen[k]
        if focal > 0:
            deep = noise * places[k, 2] ** 2
            square = rough**2 * (1 + stretch**2) + 2 * hidden**2 + deep**2 + (_HIDDEN_SHARE * unmeasured[k]) ** 2
            square += (aslant * gaps.sum() * (1 - 1 / stretch)) ** 2
            error = math.sqrt(square / 3)
        else:
            error = math.hypot(rough, hidden)
        out[k] = error if error < bound else bound
    return out


def aged(sigma: npt.NDArray[np.float32], age: float, bound: float) -> npt.NDArray[np.float32]:
    """Return the RMS error of points that were last seen ``age`` seconds ago and have moved unseen since.

    Args:
        sigma: ``(N,)`` when they were seen.
        age: Seconds.
        bound: Largest value returned; the points are expected to move by a quarter of it in a second.
    """
    return _bounded(np.hypot(sigma.astype(np.float64), _DRIFT * bound * age), bound)


@compiled
def shortest_ways(gaps: Array, edges: npt.NDArray[np.int64], known: Mask) -> Array:
    """Return the length of the shortest way along ``(E, 2)`` edges of lengths ``(E,)`` to a known point, ``(N,)``.

    It is 0 for known points, and infinite if no point is known. Edges are relaxed forwards and backwards until nothing
    changes (Bellman and Ford): along a chain once.
    """
    arc, changed = np.where(known, 0.0, np.inf), not known.all()
    while changed:
        changed = False
        for sweep in range(2 * len(edges)):
            e = sweep if sweep < len(edges) else 2 * len(edges) - 1 - sweep
            i, j = edges[e, 0], edges[e, 1]
            if arc[i] + gaps[e] < arc[j]:
                arc[j], changed = arc[i] + gaps[e], True
            if arc[j] + gaps[e] < arc[i]:
                arc[i], changed = arc[j] + gaps[e], True
    return arc


def _bounded(sigma: Array, bound: float) -> npt.NDArray[np.float32]:
    """Return finite float32 numbers, at most the bound."""
    return np.fmin(sigma, bound).astype(np.float32)
