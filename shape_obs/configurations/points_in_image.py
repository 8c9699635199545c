"""Points of a form in an image: put in space, flagged as visible and valid, given their expected errors."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import viewing_rays
from shape_obs.compiled import compiled
from shape_obs.frame import DEPTH_TYPE, MILLIMETRE, DepthImages
from shape_obs.image.connected_runs import near_mask
from shape_obs.point_cloud.local_depth import MAX_REACH, MIN_SHARE, median_depth
from shape_obs.point_cloud.strands import strand_gap, strand_under
from shape_obs.tracking.belief import MAX_SIGMA, Shares, point_errors, stereo_noise

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float32]
Flags = npt.NDArray[np.bool_]
Mask = npt.NDArray[np.uint8]
#: Pixels, metres, visible, valid and errors of ``seen_points``.
Seen = tuple[Floats, Floats, Flags, Flags, Floats]
#: The types of ``Configuration.where``, the last arguments of what lays points on a form.
WHERE_TYPES: Final = DEPTH_TYPE + ", u1[:,::1], UniTuple(i8, 2), f8, f8[::1], f8, i8[:,::1], i8, Shares, i8, f8"

# Where a rope is this much longer in space than in the image, a pixel holds so much of it that its depth is no point's.
_END_ON: Final = 2.4
_END_ON_IF_THIN: Final = 2.0  # the same of a rope thinner than 6 px, of which a pixel holds more
_THIN: Final = 6.0


@compiled("(f8[:,::1], b1[::1], f8[::1], f8[::1], " + DEPTH_TYPE + ", u1[:,::1], UniTuple(i8, 2), f8, f8[::1], f8, b1)")
def lift_points(
    points: Array, interpolated: Flags, relief: Array, steep: Array, depth: DepthImages, mask: Mask,
    at: tuple[int, int], width: float, lens: Array, radius: float, rope: bool,
) -> tuple[Floats, Floats, Array, Flags, Flags]:  # fmt: skip
    """Put points in an image in space, and say which are seen and measured.

    Args:
        points: ``(N, 2)`` pixels.
        interpolated: ``(N,)`` whether the form is interpolated there.
        relief: ``(N,)`` of the form, see ``FittedCurve.relief``; ``(0,)`` takes the median depth around each point.
        steep: ``(N,)`` how much longer the form is there in space than in the image; ``(0,)`` without relief.
        depth: The frame's, see ``frame.depth_images``.
        mask: ``(h, w)`` uint8, C-contiguous.
        at: Image column and row of its first pixel.
        width: Of the object, pixels; depth is looked for within a quarter of it.
        lens: The projection, see ``Intrinsics.lens``.
        radius: Metres from the surface to the axis along the viewing ray; 0 stays on the surface.
        rope: Whether the object is too narrow for its depth to slope across it.

    Returns:
        ``(N, 2)`` pixels; ``(N, 3)`` metres, camera frame, NaN where unknown; ``(N,)`` depth, metres; ``(N,)`` whether
        the mask has a pixel there and nothing lies over it; ``(N,)`` whether it is also measured.
    """
    count, reach = len(points), min(max(int(np.rint(width / 4)), 1), MAX_REACH)
    pixels, found = np.empty((count, 2), np.float32), np.empty((count, 3), np.float32)
    visible, valid, rays = (
        near_mask(mask, at[0], at[1], points, 1),
        np.empty(count, np.bool_),
        viewing_rays(points, lens),
    )
    z = np.empty(count)
    if len(relief) > 0:
        for n in range(count):
            z[n] = math.exp(relief[n] / lens[0])
        known, under = strand_under(depth, mask, at, points, reach, z, strand_gap(width, lens[0]))
        for n in range(count):
            visible[n] = visible[n] and not interpolated[n] and not under[n]
            valid[n] = visible[n] and known[n] and steep[n] < (_END_ON if width >= _THIN else _END_ON_IF_THIN)
    else:
        if len(depth[0]) > 0:
            z, _ = median_depth(depth[0], MILLIMETRE, mask, at[0], at[1], points, reach, MIN_SHARE, not rope)
        else:
            z, _ = median_depth(depth[1], 1.0, mask, at[0], at[1], points, reach, MIN_SHARE, not rope)
        for n in range(count):
            visible[n] = visible[n] and not interpolated[n]
            valid[n] = visible[n] and math.isfinite(z[n])
    for n in range(count):
        pixels[n, 0], pixels[n, 1] = points[n, 0], points[n, 1]
        length = math.sqrt(rays[n, 0] ** 2 + rays[n, 1] ** 2 + 1)
        for d in range(3):
            found[n, d] = rays[n, d] * (z[n] + radius / length)
            valid[n] = valid[n] and math.isfinite(found[n, d])
    return pixels, found, z, visible, valid


@compiled
def seen_points(
    points: Array, relief: Array, steep: Array, rope: bool, size: float, depth: DepthImages, mask: Mask,
    at: tuple[int, int], width: float, lens: Array, radius: float, edges: Indices, across: int, shares: Shares,
    columns: int, diagonal: float,
) -> Seen:  # fmt: skip
    """Return all that a shape holds of points on a form in an image that is seen as a whole, see ``Shape``.

    Args:
        points: As ``lift_points`` takes them, and the next three.
        relief: Pixels.
        steep: Ratios.
        rope: Whether it is one.
        size: Of the form.
        depth: As ``lift_points`` takes it, and the next five; with an empty ``lens`` points stay in the image.
        mask: Of the object.
        at: Its place.
        width: Pixels.
        lens: The projection.
        radius: Metres.
        edges: See ``known_layout``, and the next two.
        across: Edges.
        shares: What errors are made of.
        columns: Of the image.
        diagonal: Of the image, pixels: the bound of errors in pixels.

    Returns:
        ``(N, 2)`` pixels; ``(N, 3)`` metres, ``(0, 3)`` without depth; ``(N,)`` visible; ``(N,)`` valid; ``(N,)`` the
        expected errors.
    """
    residual = math.hypot(shares.resolution, shares.size * size)
    if len(lens) > 0:
        pixels, places, _, visible, valid = lift_points(
            points, np.zeros(len(points), np.bool_), relief, steep, depth, mask, at, width, lens, radius, rope
        )
        focal = (lens[0] + lens[1]) / 2
        errors = point_errors(
            places, pixels, visible, valid, edges, across, residual, shares.aslant, focal,
            shares.depth * stereo_noise(focal, columns), MAX_SIGMA,
        )  # fmt: skip
        return pixels, places, visible, valid, errors
    pixels, visible = points.astype(np.float32), near_mask(mask, at[0], at[1], points, 1)
    errors = point_errors(pixels, pixels[:0], visible, visible, edges, across, residual, 0.0, 0.0, 0.0, diagonal)
    return pixels, np.empty((0, 3), np.float32), visible, visible.copy(), errors


@compiled
def nothing_seen() -> Seen:
    """Return what ``seen_points`` returns of no points."""
    pixels, flags = np.empty((0, 2), np.float32), np.empty(0, np.bool_)
    return pixels, np.empty((0, 3), np.float32), flags, flags, np.empty(0, np.float32)
