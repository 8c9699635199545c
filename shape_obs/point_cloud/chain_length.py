"""A rope's curve in space: its depth, and how far along it each point lies in metres."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.frame import DEPTH_TYPE, DepthImages
from shape_obs.geometry.polyline import arc_length
from shape_obs.point_cloud.lifting import leave_out_overlaid
from shape_obs.point_cloud.local_depth import MAX_REACH, median, room
from shape_obs.point_cloud.strands import strand_depth

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]

_COMPANY: Final = 3  # points of a curve to either side, whose median depth a point's is compared with
_ASTRAY: Final = 0.01  # metres: farther from it, apart from their own slope, a depth is not the curve's
_FEWEST: Final = 3  # points with depth that make a curve in space
_EXACT: Final = 3e-4  # of the depth: the least noise of it
_NORMAL: Final = 1.21  # standard deviations of a value, in median distances from the mean of two others
_CURVED: Final = 4.0  # per metre: the squared curvature that ropes have, and the arc over which it changes
_ROUNDS: Final = 2
_LEAST: Final = 1e-9  # of a pivot: without it, depth in a single place would say nothing of a slope


@compiled("(f8[:,::1], f8[:,::1], b1[::1], " + DEPTH_TYPE + ", u1[:,::1], UniTuple(i8, 2), f8, f8[::1], f8)")
def lift_chain(
    points: Array,
    rays: Array,
    bridged: npt.NDArray[np.bool_],
    depth: DepthImages,
    mask: Mask,
    at: tuple[int, int],
    width: float,
    expected: Array,
    slack: float,
) -> tuple[Array, Array, float]:
    """Put an open curve in space, and measure how far along it each of its points lies, in metres.

    Depth that lies off its neighbours' is left out, holes are bridged, and the rest is smoothed, since noise would make
    the curve longer than it is. Each depth counts where its pixels are on average: at a tip they all lie on one side of
    the point.

    Args:
        points: ``(P, 2)`` pixels, at about equal steps.
        rays: ``(P, 3)`` their viewing rays, scaled to z = 1.
        bridged: ``(P,)`` where the curve does not lie on the object.
        depth: The frame's, see ``frame.depth_images``.
        mask: ``(h, w)`` uint8, C-contiguous.
        at: Image column and row of its first pixel.
        width: Of the object, pixels; depth is looked for within a quarter of it.
        expected: ``(P,)`` metres where the curve was fitted in space; ``(0,)`` where it was fitted in the image.
        slack: By which share a depth may differ from that to be the curve's.

    Returns:
        ``(P,)`` arc length, metres; ``(P,)`` smooth depth, metres; the share of the points that have depth.
    """
    size = len(points)
    reach = min(max(int(np.rint(width / 4)), 1), MAX_REACH)
    z, places = strand_depth(depth, mask, at, points, reach, expected, slack)
    if bridged.any():
        leave_out_overlaid(z, arc_length(points), bridged, 0.0, width)
    clean, near, along, step = np.empty(size), np.empty(2 * _COMPANY + 1), np.arange(float(size)), _step(points)
    known, least, most = 0, np.inf, 0.0
    for p in range(size):
        clean[p] = np.nan
        if not bridged[p] and z[p] > 0 and not _astray(z, bridged, p, near):
            clean[p], along[p] = z[p], p + _ahead(points, p, places[p]) / step
            known, least, most = known + 1, min(least, z[p]), max(most, z[p])
    if known < _FEWEST:
        return np.full(size, np.nan), np.full(size, np.nan), known / size
    apart = min(max(int((2 * reach + 1) / step), 1), size // 4)
    noise = max(_noise_of(clean, apart), _EXACT * least)
    _bridge(clean, bridged)
    smooth = smooth_depth(clean, along, rays, apart * noise**2)
    for p in range(size):  # a spline overshoots where depth jumps
        smooth[p] = min(max(smooth[p], least / 2), 2 * most)
    arc = np.zeros(size)
    for p in range(1, size):
        x = rays[p, 0] * smooth[p] - rays[p - 1, 0] * smooth[p - 1]
        y = rays[p, 1] * smooth[p] - rays[p - 1, 1] * smooth[p - 1]
        away = smooth[p] - smooth[p - 1]
        arc[p] = arc[p - 1] + math.sqrt(x * x + y * y + away * away)
    return arc, smooth, known / size


@compiled
def _astray(z: Array, bridged: npt.NDArray[np.bool_], p: int, near: Array) -> bool:
    """Return whether a depth lies off the median of its neighbours', by more than their own slope explains."""
    begin, stop, off = max(p - _COMPANY, 0), min(p + _COMPANY + 1, len(z)), 0.0
    for q in range(begin, stop):
        if not bridged[q] and z[q] > 0:
            off = max(off, abs(z[q] - z[p]))
    if off <= _ASTRAY:  # then it is as near to their median, which takes longer to find
        return False
    first, last, count = p, p, 0
    for q in range(begin, stop):
        if not bridged[q] and z[q] > 0:
            first, last, at = min(first, q), q, count
            while at > 0 and near[at - 1] > z[q]:
                near[at] = near[at - 1]
                at -= 1
            near[at] = z[q]
            count += 1
    middle = (near[(count - 1) // 2] + near[count // 2]) / 2
    return abs(z[p] - middle) > _ASTRAY + abs(z[last] - z[first])


@compiled
def _step(points: Array) -> float:
    """Return the mean distance of neighbours."""
    total = 0.0
    for p in range(1, len(points)):
        x, y = points[p, 0] - points[p - 1, 0], points[p, 1] - points[p - 1, 1]
        total += math.sqrt(x * x + y * y)
    return max(total / (len(points) - 1), 1e-9)


@compiled
def _ahead(points: Array, p: int, place: Array) -> float:
    """Return how far a place lies ahead of a point along a curve."""
    before, after = max(p - 1, 0), min(p + 1, len(points) - 1)
    x, y = points[after, 0] - points[before, 0], points[after, 1] - points[before, 1]
    return (x * (place[0] - points[p, 0]) + y * (place[1] - points[p, 1])) / max(math.sqrt(x * x + y * y), 1e-9)


@compiled
def _bridge(values: Array, bridged: npt.NDArray[np.bool_]) -> None:
    """Put straight lines under bridged pieces, and level ones at long ends without depth: a spline would swing out."""
    before = -1
    for p in range(len(values)):
        if values[p] > 0:
            for q in range(before + 1, p):
                if before < 0 and p - q > _COMPANY:
                    values[q] = values[p]
                elif before >= 0 and bridged[q]:
                    values[q] = values[before] + (q - before) / (p - before) * (values[p] - values[before])
            before = p
    for q in range(before + _COMPANY + 1, len(values)):
        values[q] = values[before]


@compiled
def _noise_of(values: Array, apart: int) -> float:
    """Return the standard deviation of the noise of values along a curve, those ``apart`` being independent."""
    off, known = room(len(values)), 0
    for p in range(apart, len(values) - apart):
        away = values[p] - (values[p - apart] + values[p + apart]) / 2
        if away == away:  # all three are known
            off[known] = abs(away)
            known += 1
    return _NORMAL * median(off, known) if known else 0.0


@compiled
def smooth_depth(values: Array, along: Array, rays: Array, variance: float) -> Array:
    """Return the depth along a curve that bends as little as its noise allows: a smoothing spline.

    It is the least of the squared misfits, over the noise, plus the squared curvature of the depth over the arc length
    in space, over what ropes have of it (G. Wahba, "Improper priors, spline smoothing and the problem of guarding
    against model errors in regression", 1978). The steps in space follow from the depth, in two rounds.

    Args:
        values: ``(P,)`` metres, NaN where it is not known.
        along: ``(P,)`` where each was measured, as an index into the curve that need not be whole.
        rays: ``(P, 2)`` x/z and y/z of the viewing rays.
        variance: Of the noise of a value.
    """
    size = len(values)
    z, rate = np.full(size, float(np.nanmean(values))), np.empty(size - 1)  # points in a metre
    turned = np.empty(size - 1)  # squared, from one ray to the next
    for p in range(size - 1):
        turned[p] = (rays[p + 1, 0] - rays[p, 0]) ** 2 + (rays[p + 1, 1] - rays[p, 1]) ** 2
    for _ in range(_ROUNDS):
        for p in range(size - 1):
            rate[p] = 1 / max(math.sqrt(z[p] * z[p] * turned[p] + (z[p + 1] - z[p]) ** 2), 1e-6)
        main, next_, after, right = np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(size)
        for p in range(size):
            if values[p] > 0:
                i = min(max(int(along[p]), 0), size - 2)
                t = along[p] - i
                main[i] += (1 - t) ** 2
                main[i + 1] += t * t
                next_[i] += t * (1 - t)
                right[i] += (1 - t) * values[p]
                right[i + 1] += t * values[p]
        for p in range(1, size - 1):
            a, b = rate[p - 1], rate[p]
            w = 2 * variance / _CURVED * a * b / (a + b)
            main[p - 1] += w * a * a
            main[p] += w * (a + b) ** 2
            main[p + 1] += w * b * b
            next_[p - 1] -= w * a * (a + b)
            next_[p] -= w * b * (a + b)
            after[p - 1] += w * a * b
        for p in range(size):  # the equations are positive definite, of two diagonals to either side
            main[p] = 1 / max(main[p], _LEAST)  # its inverse from here on
            if p + 1 < size:
                share = next_[p] * main[p]
                main[p + 1] -= share * next_[p]
                right[p + 1] -= share * right[p]
                if p + 2 < size:
                    next_[p + 1] -= share * after[p]
                    over = after[p] * main[p]
                    main[p + 2] -= over * after[p]
                    right[p + 2] -= over * right[p]
        for p in range(size - 1, -1, -1):
            total = right[p]
            if p + 1 < size:
                total -= next_[p] * z[p + 1]
            if p + 2 < size:
                total -= after[p] * z[p + 2]
            z[p] = total * main[p]
    return z
