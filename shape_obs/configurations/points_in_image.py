"""Points on a form in an image: put in space, flagged as visible and valid, given their expected errors."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import stereo_noise, viewing_rays
from shape_obs.compiled import compiled
from shape_obs.frame import DEPTH_TYPE, DepthImages
from shape_obs.geometry.topology import fill_lattice
from shape_obs.image.connected_runs import near_mask
from shape_obs.point_cloud.local_depth import MAX_REACH, MIN_SHARE, median_depth
from shape_obs.point_cloud.strands import strand_gap, strand_under
from shape_obs.tracking.belief import MAX_SIGMA, Shares, point_errors

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float32]
Flags = npt.NDArray[np.bool_]
Mask = npt.NDArray[np.uint8]
#: Pixels, metres, visible, valid and errors of ``seen_points``.
Seen = tuple[Floats, Floats, Flags, Flags, Floats]

_END_ON: Final = 2.4  # times as long in space as in the image: there a pixel's depth is no single point's
_END_ON_IF_THIN: Final = 2.0  # the same of a thin rope, whose pixels hold more of it
_THIN: Final = 6.0  # pixels: narrower ropes are thin


@compiled(
    "(f8[:,::1], b1[::1], f8[::1], f8[::1], b1[::1], f8[::1], f8, "
    + DEPTH_TYPE
    + ", u1[:,::1], UniTuple(i8, 2), f8, f8[::1], f8, i8[:,::1], i8, Shares, i8, f8)"
)
def seen_points(
    points: Array, interpolated: Flags, log_depth: Array, steep: Array, foreign: Flags, off: Array,
    size: float, depth: DepthImages, mask: Mask, at: tuple[int, int], width: float, lens: Array, radius: float,
    edges: Indices, across: int, shares: Shares, columns: int, diagonal: float,
) -> Seen:  # fmt: skip
    """Return all that a shape holds of points on a form in an image, see ``Shape``.

    Args:
        points: ``(N, 2)`` pixels.
        interpolated: ``(N,)`` whether the form is interpolated there.
        log_depth: ``(N,)`` of the form, see ``FittedCurve``; ``(0,)`` takes the median depth around each point.
        steep: ``(N,)`` how much longer the form is there in space than in the image; ``(0,)`` without log-depth.
        foreign: ``(N,)`` whether the depth there may be that of what hides a piece next to it; ``(0,)`` if none is.
        off: ``(N,)`` metres by which points of a sheet may be off within it, see ``Isometry``; ``(0,)`` without depth.
        size: Of the form, pixels.
        depth: The frame's, see ``frame.depth_images``.
        mask: ``(h, w)`` uint8, C-contiguous.
        at: Image column and row of its first pixel.
        width: Of the object, pixels; depth is looked for within a quarter of it.
        lens: The projection, see ``Intrinsics.lens``; ``(0,)`` without depth: points stay in the image.
        radius: Metres from the surface to the axis along the viewing ray; 0 stays on the surface.
        edges: ``(E, 2)`` neighbours among the points.
        across: How many of these lie along the rows of a lattice; 0 for a line or a ring.
        shares: What errors are made of.
        columns: Of the image.
        diagonal: Of the image, pixels: the bound of errors in pixels.

    Returns:
        ``(N, 2)`` pixels; ``(N, 3)`` metres, camera frame, of points that are not valid where they are expected, NaN
        where that is unknown, ``(0, 3)`` without depth; ``(N,)`` visible: the mask has a pixel there and nothing lies
        over it; ``(N,)`` valid: also measured; ``(N,)`` the expected errors, see ``point_errors``.
    """
    count, pixels, residual = len(points), points.astype(np.float32), math.hypot(shares.resolution, shares.size * size)
    visible = near_mask(mask, at[0], at[1], points, 1)
    for n in range(count):
        visible[n] = visible[n] and not interpolated[n]
    if len(lens) == 0:
        errors = point_errors(pixels, pixels[:0], visible, visible, edges, across, residual, 0.0, 0.0, 0.0, diagonal)
        return pixels, np.empty((0, 3), np.float32), visible, visible.copy(), errors
    reach = min(max(int(np.rint(width / 4)), 1), MAX_REACH)
    valid, z = np.empty(count, np.bool_), np.empty(count)
    if len(log_depth) > 0:
        for n in range(count):
            z[n] = math.exp(log_depth[n] / lens[0])
        known, under = strand_under(depth, mask, at, points, reach, z, strand_gap(width, lens[0]))
        for n in range(count):
            visible[n] = visible[n] and not under[n]
            valid[n] = visible[n] and known[n] and steep[n] < (_END_ON if width >= _THIN else _END_ON_IF_THIN)
    else:
        rope = across == 0 and len(edges) < count  # too narrow for its depth to slope across it
        z, _ = median_depth(depth, mask, at[0], at[1], points, reach, MIN_SHARE, not rope)
        for n in range(count):
            valid[n] = visible[n] and math.isfinite(z[n])
    places = _in_space(points, z, lens, radius)
    for n in range(count):
        if len(foreign) > 0 and foreign[n]:
            z[n], valid[n] = np.nan, False
        for d in range(3):
            valid[n] = valid[n] and math.isfinite(places[n, d])  # the lens may have no ray there
    if len(log_depth) == 0 and not valid.all():
        # What is uncertain on a sheet still has its own depth; next to a curve it may be that of what lies over it.
        known = np.isfinite(z) if across > 0 else valid
        places = _in_space(points, _filled(z, known, edges, across), lens, radius)
    focal = (lens[0] + lens[1]) / 2
    errors = point_errors(
        places, pixels, visible, valid, edges, across, residual, shares.aslant, focal,
        shares.depth * stereo_noise(focal, columns), MAX_SIGMA,
    )  # fmt: skip
    for n in range(len(off)):
        error = math.hypot(errors[n], off[n] / math.sqrt(3))
        errors[n] = error if error < MAX_SIGMA else MAX_SIGMA
    return pixels, places, visible, valid, errors


@compiled
def _in_space(points: Array, z: Array, lens: Array, radius: float) -> Floats:
    """Return ``(N, 3)`` metres of pixels at depths ``(N,)``: on the surface, or ``radius`` behind it."""
    found, rays = np.empty((len(points), 3), np.float32), viewing_rays(points, lens)
    for n in range(len(points)):
        length = math.sqrt(rays[n, 0] ** 2 + rays[n, 1] ** 2 + 1)
        for d in range(3):
            found[n, d] = rays[n, d] * (z[n] + radius / length)
    return found


@compiled
def _filled(values: Array, known: Flags, edges: Indices, across: int) -> Array:
    """Return values ``(N,)``, the unknown ones from their known neighbours, if any: by index, or over the lattice."""
    count, out = len(values), values.copy()
    if not known.any():
        return out
    if across > 0:
        rows = count - across
        return fill_lattice(out.reshape(rows, count // rows, 1), known.reshape(rows, count // rows)).reshape(count)
    closed = len(edges) == count
    for n in range(count):
        if known[n]:
            continue
        before, after = 1, 1
        while before <= count and (closed or n - before >= 0) and not known[(n - before) % count]:
            before += 1
        while after <= count and (closed or n + after < count) and not known[(n + after) % count]:
            after += 1
        first, last = values[(n - before) % count], values[(n + after) % count]
        if not closed and n - before < 0:
            first = last
        elif not closed and n + after >= count:
            last = first
        out[n] = (first * after + last * before) / (before + after)
    return out
