"""Evidence for hiding: what the image and its depth show where a rope goes out of sight.

An end is hidden only with evidence. The border of what is searched cuts it off, something nearer than the rope lies
where it would go on, or its surface goes on in the depth image though its colour does not (a shadow). Missing depth is
no evidence, and neither is a rope that looks shorter: perspective does that.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.frame import FARTHEST
from shape_obs.image.connected_runs import nearest_pixel

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]

#: What is known about a tip: nothing, something hides what lies behind it, it is the rope's own.
UNKNOWN: Final = 0
HIDDEN: Final = 1
FREE: Final = 2

_REACH: Final = (1.5, 8.0)  # widths and pixels around a tip in which what hides it must be
_BORDER: Final = (0.5, 2.0)  # widths and pixels from the border, within which a rope is cut off by it
_NEARER: Final = 0.008  # metres: what is nearer than the rope by this much, and its slope, lies over it
_LEVEL: Final = 0.004  # metres: what goes on at the rope's own depth, within this, is the rope
_TOUCHING: Final = 0.06  # of the pixels ahead: that many are nearer where something hides the rope
_SEEN_PAST: Final = 0.5  # of the pixels ahead: that many lie behind a tip that is free
_GOES_ON: Final = 0.7  # of the pixels straight ahead


@compiled(
    "(f8[:,::1], f8[::1], f8[::1], f8, Array(u2, 2, 'C', readonly=True), f8, u1[:,::1], UniTuple(i8, 2), UniTuple(i8, 4))",
    "(f8[:,::1], f8[::1], f8[::1], f8, Array(f4, 2, 'C', readonly=True), f8, u1[:,::1], UniTuple(i8, 2), UniTuple(i8, 4))",
)
def chain_evidence(
    points: Array,
    arc: Array,
    z: Array,
    width: float,
    depth: npt.NDArray[Any],
    unit: float,
    mask: Mask,
    at: tuple[int, int],
    edge: tuple[int, int, int, int],
) -> tuple[int, int]:
    """Return what is known about the first and the last point of a curve, see ``tip_evidence``.

    Args:
        points: ``(P, 2)`` pixels.
        arc: ``(P,)`` its arc length.
        z: ``(P,)`` its smooth depth, metres.
        width: Of the rope, pixels.
        depth: ``(H, W)`` read-only, uint16 or float32; ``(0, 0)`` without depth.
        unit: Metres in a unit of depth.
        mask: ``(h, w)`` uint8, C-contiguous.
        at: Image column and row of its first pixel.
        edge: Left, top, width and height of the part of the image that is searched, pixels.
    """
    last, ahead = len(points) - 1, np.empty(2)
    found = (0, 0)
    for end in range(2):
        tip, step = (last, -1) if end else (0, 1)
        inner = tip
        while abs(inner + step - tip) <= last and abs(arc[inner] - arc[tip]) < max(width, 3.0):
            inner += step
        x, y = points[tip, 0] - points[inner, 0], points[tip, 1] - points[inner, 1]
        reach = max(math.sqrt(x * x + y * y), 1e-9)
        ahead[0], ahead[1] = x / reach, y / reach
        slope = abs(z[tip] - z[inner]) / reach
        known = tip_evidence(points[tip], ahead, width, z[tip], slope, depth, unit, mask, at, edge)
        found = (found[0], known) if end else (known, 0)
    return found


@compiled
def tip_evidence(
    tip: Array,
    ahead: Array,
    width: float,
    z: float,
    slope: float,
    depth: npt.NDArray[Any],
    unit: float,
    mask: Mask,
    at: tuple[int, int],
    edge: tuple[int, int, int, int],
) -> int:
    """Return what is known about a visible tip: ``UNKNOWN``, ``HIDDEN`` or ``FREE``.

    Args:
        tip: ``(2,)`` pixels.
        ahead: ``(2,)`` the direction in which the rope would go on, of length 1.
        width: Of the rope, pixels.
        z: Its depth at the tip, metres; NaN where it is not known.
        slope: Metres by which its depth changes in a pixel, at most.
        depth: ``(H, W)`` read-only, uint16 or float32; ``(0, 0)`` without depth.
        unit: Metres in a unit of depth.
        mask: ``(h, w)`` uint8, C-contiguous.
        at: Image column and row of its first pixel.
        edge: Left, top, width and height of the part of the image that is searched, pixels.
    """
    near = max(_BORDER[0] * width, _BORDER[1])
    if (
        tip[0] < edge[0] + near
        or tip[1] < edge[1] + near
        or tip[0] > edge[0] + edge[2] - 1 - near
        or tip[1] > edge[1] + edge[3] - 1 - near
    ):
        return HIDDEN
    if depth.size == 0 or not z > 0:
        return UNKNOWN
    reach = max(_REACH[0] * width, _REACH[1])
    column, row, steps = nearest_pixel(tip[0]), nearest_pixel(tip[1]), math.ceil(reach)
    count = nearer = straight = level = aside = lower = 0
    for v in range(max(row - steps, 0), min(row + steps + 1, depth.shape[0])):
        for u in range(max(column - steps, 0), min(column + steps + 1, depth.shape[1])):
            x, y = u - tip[0], v - tip[1]
            along, side = x * ahead[0] + y * ahead[1], abs(y * ahead[0] - x * ahead[1])
            away = math.sqrt(x * x + y * y)
            if along < -0.25 * width or away > reach:
                continue
            i, j = v - at[1], u - at[0]
            if 0 <= i < mask.shape[0] and 0 <= j < mask.shape[1] and mask[i, j] != 0:
                continue
            metres = depth[v, u] * unit
            known = 0 < metres < FARTHEST
            count += 1
            spare = slope * away
            nearer += known and metres < z - _NEARER - spare
            if side <= max(width / 3, 1.0) and along > 0.3 * width + 1:
                straight += 1
                level += known and abs(metres - z) <= _LEVEL + spare
            elif side > 0.8 * width:
                aside += 1
                lower += known and metres > z + _LEVEL + spare
    if nearer >= max(_TOUCHING * count, 2.0):
        return HIDDEN
    if straight and level >= _GOES_ON * straight and lower >= _SEEN_PAST * aside:
        return HIDDEN
    return FREE
