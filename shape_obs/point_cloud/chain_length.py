"""A rope's curve in space: its depth, and how far along it each point lies in metres."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.frame import FARTHEST
from shape_obs.geometry.polyline import arc_length
from shape_obs.image.connected_runs import nearest_pixel
from shape_obs.point_cloud.lifting import COMPARED, SMEARED, STEP, nearest_expected
from shape_obs.point_cloud.local_depth import MAX_REACH, MIN_SHARE, median, median_depth, room

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]

_COMPANY: Final = 3  # points of a curve to either side, whose median depth a point's is compared with
_ASTRAY: Final = 0.01  # metres: farther from it, apart from their own slope, a depth is not the curve's
_SMOOTHED: Final = 4  # points to either side, over which depth is smoothed along a curve
_APART: Final = (2.0, 0.02)  # widths, and of the depth: strands that lie so far apart are not taken for each other


@compiled(
    "(f8[:,::1], f8[:,::1], b1[::1], Array(u2, 2, 'C', readonly=True), f8, u1[:,::1], UniTuple(i8, 2), f8, f8[::1], "
    "f8)",
    "(f8[:,::1], f8[:,::1], b1[::1], Array(f4, 2, 'C', readonly=True), f8, u1[:,::1], UniTuple(i8, 2), f8, f8[::1], "
    "f8)",
)
def lift_chain(
    points: Array,
    rays: Array,
    bridged: npt.NDArray[np.bool_],
    depth: npt.NDArray[Any],
    unit: float,
    mask: Mask,
    at: tuple[int, int],
    width: float,
    expected: Array,
    slack: float,
) -> tuple[Array, Array, float]:
    """Put an open curve in space, and measure how far along it each of its points lies, in metres.

    Depth that lies off its neighbours' is left out, holes are bridged, and the rest is smoothed by parabolas over
    nine points, since noise would make the curve longer than it is.

    Args:
        points: ``(P, 2)`` pixels, at about equal steps.
        rays: ``(P, 2)`` x/z and y/z of their viewing rays.
        bridged: ``(P,)`` where the curve does not lie on the object.
        depth: ``(H, W)`` read-only, uint16 or float32.
        unit: Metres in a unit of depth.
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
    z = median_depth(depth, unit, mask, at[0], at[1], points, reach, MIN_SHARE, False)
    for p in range(len(expected)):
        if not abs(z[p] / expected[p] - 1) <= slack:
            z[p] = _depth_near(depth, unit, mask, at, points[p], reach, expected[p], slack)
    _leave_out_overlaid(z, points, bridged, width)
    clean, near = np.empty(size), np.empty(2 * _COMPANY + 1)
    for p in range(size):
        clean[p] = z[p] if not bridged[p] and z[p] > 0 and not _astray(z, bridged, p, near) else np.nan
    known, before = 0, -1
    for p in range(size):
        if clean[p] > 0:
            known += 1
            for q in range(before + 1, p):
                share = 1.0 if before < 0 else (q - before) / (p - before)
                clean[q] = clean[p] if before < 0 else clean[before] + share * (clean[p] - clean[before])
            before = p
    for q in range(before + 1, size):
        clean[q] = clean[before] if before >= 0 else np.nan
    smooth = parabola_smoothed(clean, _SMOOTHED)
    for p in range(size):
        if smooth[p] <= 0:  # a parabola overshoots where depth jumps
            smooth[p] = clean[p]
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
    first, last, count = p, p, 0
    for q in range(max(p - _COMPANY, 0), min(p + _COMPANY + 1, len(z))):
        if not bridged[q] and z[q] > 0:
            first, last, at = min(first, q), q, count
            while at > 0 and near[at - 1] > z[q]:
                near[at] = near[at - 1]
                at -= 1
            near[at] = z[q]
            count += 1
    middle = (near[(count - 1) // 2] + near[count // 2]) / 2
    return abs(z[p] - middle) > _ASTRAY + abs(z[last] - z[first])


@compiled("(f8, f8)")
def strand_gap(width: float, focal: float) -> float:
    """Return by which share of its depth a strand of a rope lies apart from another.

    Args:
        width: Of the rope, pixels.
        focal: Focal length, pixels.
    """
    return max(_APART[0] * width / focal, _APART[1])


@compiled
def _depth_near(
    depth: npt.NDArray[Any],
    unit: float,
    mask: Mask,
    at: tuple[int, int],
    point: Array,
    reach: int,
    expected: float,
    slack: float,
) -> float:
    """Return the median depth of the mask around a point, of what lies where it is expected; NaN where nothing does."""
    height, width = mask.shape
    near, known = room((2 * reach + 1) ** 2), 0
    column, row = nearest_pixel(point[0]) - at[0], nearest_pixel(point[1]) - at[1]
    for v in range(max(row - reach, 0), min(row + reach + 1, height)):
        for u in range(max(column - reach, 0), min(column + reach + 1, width)):
            z = depth[v + at[1], u + at[0]] * unit
            if mask[v, u] != 0 and 0 < z < FARTHEST and abs(z / expected - 1) <= slack:
                near[known] = z
                known += 1
    return median(near, known) if known else np.nan


@compiled
def _leave_out_overlaid(z: Array, points: Array, bridged: npt.NDArray[np.bool_], width: float) -> None:
    """Set depth to NaN that belongs to what hides a bridged piece next to it, see ``overlaid``.

    Args:
        z: ``(P,)`` metres, changed in place.
        points: ``(P, 2)`` pixels.
        bridged: ``(P,)``.
        width: Of the object, pixels.
    """
    size = len(z)
    if not bridged.any():
        return
    arc, apart, others, places = arc_length(points), np.empty(size), np.empty(size), np.empty(size)
    for p in range(size):
        apart[p] = np.inf
        for q in range(size):
            if bridged[q]:
                apart[p] = min(apart[p], abs(arc[p] - arc[q]))
    for p in range(size):
        if bridged[p] or apart[p] > SMEARED * width or not z[p] > 0:
            continue
        count = 0
        for q in range(size):
            if apart[q] > SMEARED * width and abs(arc[p] - arc[q]) <= COMPARED * width and z[q] > 0:
                others[count], places[count] = z[q], arc[q]
                count += 1
        if count > 0 and z[p] < nearest_expected(places[:count], others[:count], arc[p]) - STEP:
            z[p] = np.nan


@compiled
def parabola_smoothed(values: Array, half: int) -> Array:
    """Smooth values by a parabola through each one's neighbours (Savitzky and Golay 1964, of second order).

    Args:
        values: ``(P,)``.
        half: How many neighbours to either side; at both ends the window is cut.
    """
    size, out = len(values), np.empty(len(values))
    inner = np.empty(2 * half + 1)  # the weights where the window is whole
    squares, fourths = half * (half + 1) * (2 * half + 1) / 3, 0.0
    for x in range(1, half + 1):
        fourths += 2.0 * x**4
    for x in range(-half, half + 1):
        inner[x + half] = (fourths - squares * x * x) / ((2 * half + 1) * fourths - squares * squares)
    for p in range(size):
        if half <= p < size - half:
            total = 0.0
            for k in range(2 * half + 1):
                total += inner[k] * values[p - half + k]
            out[p] = total
        else:
            out[p] = _parabola_at(values, p, max(p - half, 0), min(p + half, size - 1))
    return out


@compiled
def _parabola_at(values: Array, p: int, low: int, high: int) -> float:
    """Return the value at p of the parabola of least squares through the values from low to high."""
    s0 = s1 = s2 = s3 = s4 = t0 = t1 = t2 = 0.0
    for q in range(low, high + 1):
        x = float(q - p)
        s0, s1, s2, s3, s4 = s0 + 1.0, s1 + x, s2 + x * x, s3 + x * x * x, s4 + x * x * x * x
        t0, t1, t2 = t0 + values[q], t1 + x * values[q], t2 + x * x * values[q]
    whole = s0 * (s2 * s4 - s3 * s3) - s1 * (s1 * s4 - s2 * s3) + s2 * (s1 * s3 - s2 * s2)
    if whole <= 0:
        return values[p]
    return (t0 * (s2 * s4 - s3 * s3) - s1 * (t1 * s4 - t2 * s3) + s2 * (t1 * s3 - t2 * s2)) / whole
