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
from shape_obs.frame import FARTHEST, DepthImages, metres_at
from shape_obs.image.connected_runs import nearest_pixel
from shape_obs.image.over_under import depth_at

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]

#: What is known about a tip: nothing, something hides what lies behind it, it is the rope's own.
UNKNOWN: Final = 0  # nothing is seen around a tip
HIDDEN: Final = 1  # something hides what goes on behind it
FREE: Final = 2  # the rope ends there

_SPARSE: Final = 12.0  # pixels: from this reach on every second row and column is looked at
_AT_BORDER: Final = 2  # rows or columns at a border: what leaves the image there covers some of them
_TURNS: Final = (0.0, -0.25, 0.25, -0.5, 0.5)  # tangents of how far to the side; what is cut askew seems to turn


@compiled
def remember_tips(tips: Array, shapes: Array, width: float, model: Any) -> None:
    """Remember what a rope's own tips look like that were seen once.

    Args:
        tips: ``(2, 2, 2)`` mean and variance by tip, see ``RopeState``; written to.
        shapes: ``(2, 2)`` see ``tip_shape``.
        width: Of the rope, pixels.
        model: The constants, one ``ChainModel``.
    """
    for end in range(2):
        for k in range(2):
            tips[0, end, k] = shapes[end, k]
            tips[1, end, k] = model.unfamiliar * (model.tip_noise[k] / max(width, 1.0)) ** 2


@compiled
def likelier_cut(shapes: Array, before: Array, width: float, model: Any) -> tuple[float, float]:
    """Return how much likelier, as logarithms, two tips are cut than a rope's own.

    A tip of the rope looks as it did before; what hides it cuts it in any way.

    Args:
        shapes: ``(2, 2)`` see ``tip_shape``.
        before: ``(2, 2, 2)`` see ``RopeState``.
        width: Of the rope, pixels.
        model: The constants, one ``ChainModel``.
    """
    first = last = 0.0
    for k in range(2):
        least = (model.tip_noise[k] / max(width, 1.0)) ** 2
        for end in range(2):
            own = max(before[1, end, k], least)
            any_way, off = own + model.any_cut[k] ** 2, (shapes[end, k] - before[0, end, k]) ** 2
            likelier = (off / own - off / any_way + math.log(own / any_way)) / 2
            first, last = (first, last + likelier) if end else (first + likelier, last)
    return first, last


@compiled
def learn_tips(tips: Array, shapes: Array, gain: float) -> None:
    """Move mean and variance of the tips' shapes, written to, towards another one, which counts with a weight."""
    for end in range(2):
        for k in range(2):
            off = shapes[end, k] - tips[0, end, k]
            tips[0, end, k] += gain * off
            tips[1, end, k] += gain * (off * off - tips[1, end, k])


@compiled
def chain_evidence(
    points: Array,
    arc: Array,
    z: Array,
    width: float,
    depth: DepthImages,
    noise: float,
    mask: Mask,
    at: tuple[int, int],
    edge: tuple[int, int, int, int],
    model: Any,
) -> tuple[tuple[int, int], Array]:
    """Return what is known about the first and the last point of a curve.

    Args:
        points: ``(P, 2)`` pixels.
        arc: ``(P,)`` its arc length.
        z: ``(P,)`` its smooth depth, metres.
        width: Of the rope, pixels.
        depth: The frame's, see ``frame.depth_images``.
        noise: Its standard deviation at one metre, metres.
        mask: ``(h, w)`` uint8, C-contiguous.
        at: Image column and row of its first pixel.
        edge: Left, top, width and height of the part of the image that is searched, pixels.
        model: The constants, one ``ChainModel``.

    Returns:
        What is known of both, see ``tip_evidence``; ``(2, 2)`` what they look like, see ``tip_shape``.
    """
    shapes, found = np.empty((2, 2)), (0, 0)
    for end in range(2):
        tip, step = (len(points) - 1, -1) if end else (0, 1)
        known, ahead = _seen_at(points, arc, z, tip, step, width, depth, noise, mask, at, edge, model)
        found = (found[0], known) if end else (known, 0)
        shapes[end, 0], shapes[end, 1] = tip_shape(points[tip], ahead, width, mask, at)
    return found, shapes


@compiled
def open_gaps(
    points: Array, arc: Array, off: Flags, z: Array, width: float, depth: DepthImages, noise: float, mask: Mask,
    at: tuple[int, int], edge: tuple[int, int, int, int], model: Any,
) -> float:  # fmt: skip
    """Return the share of a curve in wide gaps where no rope is: depth shows what is behind it, and an end is free.

    A rope under a shadow is seen to go on at both sides of the gap, though a straight bridge misses it.

    Args:
        points: As ``chain_evidence`` takes it, and all but one that follow.
        arc: Its arc length.
        off: ``(P,)`` where it lies off the mask.
        z: Its depth.
        width: Of the rope.
        depth: The frame's.
        noise: Of it.
        mask: Of the rope.
        at: Its place in the image.
        edge: Of what is searched.
        model: The constants, one ``ChainModel``.
    """
    last, total, before, behind = len(points) - 1, 0.0, -1, 0
    for p in range(last + 1):
        if off[p]:
            behind += depth_at(depth, points[p, 0], points[p, 1]) > z[p] + depth_limit(model.level, z[p], noise, model)
            continue
        if before >= 0 and 2 * behind > p - before - 1 and arc[p] - arc[before] > model.max_off * arc[last]:
            head, _ = _seen_at(points, arc, z, before, -1, width, depth, noise, mask, at, edge, model)
            tail, _ = _seen_at(points, arc, z, p, 1, width, depth, noise, mask, at, edge, model)
            total += (arc[p] - arc[before]) * (head == FREE or tail == FREE)
        before, behind = p, 0
    return total / max(arc[last], 1e-9)


@compiled
def _seen_at(
    points: Array, arc: Array, z: Array, tip: int, step: int, width: float, depth: DepthImages, noise: float,
    mask: Mask, at: tuple[int, int], edge: tuple[int, int, int, int], model: Any,
) -> tuple[int, Array]:  # fmt: skip
    """Return what is known about a place at which a curve goes out of sight, and the direction ``(2,)`` ahead of it.

    The rope lies before it: at the points that follow by steps of ``step``, 1 or -1. See ``chain_evidence``.
    """
    ahead, onwards = np.empty(2), np.empty(2)
    inner = _inwards(arc, tip, step, max(width, 3.0))
    x, y = points[tip, 0] - points[inner, 0], points[tip, 1] - points[inner, 1]
    reach = max(math.sqrt(x * x + y * y), 1e-9)
    ahead[0], ahead[1] = x / reach, y / reach
    slope = abs(z[tip] - z[inner]) / reach
    base = _inwards(arc, tip, step, model.tip_base[0] * width)
    before = _inwards(arc, tip, step, model.tip_base[1] * width)
    x, y = points[base, 0] - points[before, 0], points[base, 1] - points[before, 1]
    reach = math.sqrt(x * x + y * y)
    onwards[0], onwards[1] = (x / reach, y / reach) if reach > 0 else (ahead[0], ahead[1])
    known = tip_evidence(
        points[tip], ahead, points[base], onwards, width, z[tip], slope, depth, noise, mask, at, edge, model
    )
    return known, ahead


@compiled
def depth_limit(limit: float, z: float, noise: float, model: Any) -> float:
    """Return by how much depths of one surface may differ, metres: by its form, and by noise, which grows with z^2.

    Args:
        limit: The same without noise, metres.
        z: How far away it is, metres.
        noise: Standard deviation of depth at one metre, metres.
        model: The constants.
    """
    return math.hypot(limit, model.depth_sigmas * noise * z**2)


@compiled
def _inwards(arc: Array, tip: int, step: int, reach: float) -> int:
    """Return the first point of a curve that lies at least ``reach`` from a tip, along it; the other tip at most."""
    inner = tip
    while 0 <= inner + step < len(arc) and abs(arc[inner] - arc[tip]) < reach:
        inner += step
    return inner


@compiled
def tip_shape(tip: Array, ahead: Array, width: float, mask: Mask, at: tuple[int, int]) -> tuple[float, float]:
    """Return what a visible tip looks like: what hides a tip cuts the rope otherwise than it ends.

    Args:
        tip: ``(2,)`` pixels.
        ahead: ``(2,)`` the direction in which the rope would go on, of length 1.
        width: Of the rope, pixels.
        mask: ``(h, w)`` uint8, C-contiguous.
        at: Image column and row of its first pixel.

    Returns:
        How full the last square of the rope is (1 for a straight end, 0.89 for a round one), and how askew the end is:
        the tangent of its angle to a straight one.
    """
    column, row = nearest_pixel(tip[0]) - at[0], nearest_pixel(tip[1]) - at[1]
    steps = math.ceil(math.hypot(1.0, 0.8) * width)
    x0, y0 = tip[0] - at[0], tip[1] - at[1]
    count, moment = 0, 0.0
    for v in range(max(row - steps, 0), min(row + steps + 1, mask.shape[0])):
        for u in range(max(column - steps, 0), min(column + steps + 1, mask.shape[1])):
            if mask[v, u] == 0:
                continue
            along, side = (u - x0) * ahead[0] + (v - y0) * ahead[1], (v - y0) * ahead[0] - (u - x0) * ahead[1]
            if abs(along) < width and abs(side) < 0.8 * width:
                count += 1
                moment += side
    return count / width**2, 12 * moment / width**3


@compiled
def _reaches_border(tip: Array, width: float, mask: Mask, at: tuple[int, int], edge: tuple[int, int, int, int]) -> bool:
    """Return whether the mask within a width of a tip reaches the border of what is searched."""
    column, row, steps = nearest_pixel(tip[0]) - at[0], nearest_pixel(tip[1]) - at[1], math.ceil(width)
    left, top = edge[0] - at[0] + _AT_BORDER, edge[1] - at[1] + _AT_BORDER
    right, bottom = left + edge[2] - 2 * _AT_BORDER, top + edge[3] - 2 * _AT_BORDER
    for v in range(max(row - steps, 0), min(row + steps + 1, mask.shape[0])):
        for u in range(max(column - steps, 0), min(column + steps + 1, mask.shape[1])):
            if mask[v, u] != 0 and (u < left or v < top or u >= right or v >= bottom):
                return True
    return False


@compiled
def tip_evidence(
    tip: Array,
    ahead: Array,
    base: Array,
    onwards: Array,
    width: float,
    z: float,
    slope: float,
    depth: DepthImages,
    noise: float,
    mask: Mask,
    at: tuple[int, int],
    edge: tuple[int, int, int, int],
    model: Any,
) -> int:
    """Return what is known about a visible tip: ``UNKNOWN``, ``HIDDEN`` or ``FREE``.

    Args:
        tip: ``(2,)`` pixels.
        ahead: ``(2,)`` the direction in which the rope would go on, of length 1.
        base: ``(2,)`` a point of the rope before the tip, pixels: a tip that is cut askew lies off the axis.
        onwards: ``(2,)`` the direction of the rope there, of length 1.
        width: Of the rope, pixels.
        z: Its depth at the tip, metres; NaN where it is not known.
        slope: Metres by which its depth changes in a pixel, at most.
        depth: The frame's, see ``frame.depth_images``.
        noise: Its standard deviation at one metre, metres.
        mask: ``(h, w)`` uint8, C-contiguous.
        at: Image column and row of its first pixel.
        edge: Left, top, width and height of the part of the image that is searched, pixels.
        model: The constants, one ``ChainModel``.
    """
    near = max(model.at_border[0] * width, model.at_border[1])
    if (
        tip[0] < edge[0] + near
        or tip[1] < edge[1] + near
        or tip[0] > edge[0] + edge[2] - 1 - near
        or tip[1] > edge[1] + edge[3] - 1 - near
    ) and _reaches_border(tip, width, mask, at, edge):
        return HIDDEN
    reach = max(model.tip_reach[0] * width, model.tip_reach[1])
    step, (high, wide) = 2 if reach >= _SPARSE else 1, depth[0].shape if len(depth[0]) > 0 else depth[1].shape
    if high == 0 or not z > 0:
        return UNKNOWN
    column, row, steps = nearest_pixel(tip[0]), nearest_pixel(tip[1]), math.ceil(reach)
    count = nearer = aside = lower = 0
    same = depth_limit(model.level, z, noise, model)
    straight, level = np.zeros(len(_TURNS)), np.zeros(len(_TURNS))
    for v in range(max(row - steps, 0), min(row + steps + 1, high), step):
        for u in range(max(column - steps, 0), min(column + steps + 1, wide), step):
            x, y = u - tip[0], v - tip[1]
            along, across = x * ahead[0] + y * ahead[1], y * ahead[0] - x * ahead[1]
            away = math.sqrt(x * x + y * y)
            if along < -0.25 * width or away > reach:
                continue
            i, j = v - at[1], u - at[0]
            if 0 <= i < mask.shape[0] and 0 <= j < mask.shape[1] and mask[i, j] != 0:
                continue
            metres = metres_at(depth, v, u)
            known = 0 < metres < FARTHEST
            count += 1
            spare = slope * away
            nearer += known and metres < z - model.nearer - spare
            x, y = u - base[0], v - base[1]
            on, off = x * onwards[0] + y * onwards[1], y * onwards[0] - x * onwards[1]
            for turn in range(len(_TURNS)):
                if abs(off - _TURNS[turn] * on) <= max(width / 3, 1.0):
                    straight[turn] += 1
                    level[turn] += known and abs(metres - z) <= same + spare
            if abs(across) > 0.8 * width:
                aside += 1
                lower += known and metres > z + same + spare
    if nearer >= max(model.touching * count, 2.0):
        return HIDDEN
    for turn in range(len(_TURNS)):
        if straight[turn] and level[turn] >= model.goes_on * straight[turn] and lower >= model.seen_past * aside:
            return HIDDEN
    return FREE
