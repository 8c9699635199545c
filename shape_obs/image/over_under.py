"""Which of two strands is above where they cross: from the depth along both, else from their brightness."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.frame import DEPTH_TYPE, FARTHEST, DepthImages, metres_at
from shape_obs.geometry.crossings import Crossing
from shape_obs.geometry.polyline import arc_length, nearest_piece
from shape_obs.image.connected_runs import nearest_pixel

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Image = npt.NDArray[np.uint8]

# Depth: samples on either side of a crossing, over so many widths beyond the other strand; how far from the crossing
# samples of the strand on top may lie, in widths.
_SAMPLES: Final = 8
_BESIDE: Final = 2.0
_ON_TOP: Final = 0.3
_LONGEST: Final = 4.0  # widths: how far along a strand the other one covers it, at most
# The lower strand's depth at the crossing must be farther than the upper one's by so much: metres, and standard errors.
_LEAST_STEP: Final = 0.0015
_SURE: Final = 3.0
# Brightness: lanes along a strand, out to so many widths from its axis; the upper strand must look within the crossing
# as it does beyond, the lower one at least so much less, as a share and in grey levels.
_LANES: Final = 5
_LANE: Final = 0.36
_LIKE: Final = 0.7
_CONTRAST: Final = 3.0
_NO_IMAGE: Final = np.zeros((0, 0, 3), np.uint8)


def find_layers(
    crossings: tuple[Crossing, ...],
    curves: Sequence[Array],
    names: Sequence[str],
    widths: Sequence[float],
    depth: DepthImages,
    rgb: Image | None,
) -> tuple[Crossing, ...]:
    """Return crossings with the strand that is above, where depth or the picture shows it.

    Args:
        crossings: Of the curves.
        curves: ``(P, 2)`` pixels each.
        names: Of the curves.
        widths: Of the strands, pixels.
        depth: See ``frame.depth_images``.
        rgb: ``(H, W, 3)``; None without a picture.
    """
    if not crossings:
        return crossings
    stops = np.cumsum([len(curve) for curve in curves])
    places = {name: k for k, name in enumerate(names)}
    at = np.array([[*each.arcs, *each.pixel] for each in crossings])
    who = np.array([[places[name] for name in each.slots] for each in crossings])
    points = np.ascontiguousarray(np.concatenate(curves), dtype=np.float64)
    picture = _NO_IMAGE if rgb is None else np.ascontiguousarray(rgb)
    above = upper_strands(points, stops, who, at, np.array(widths), depth, picture).tolist()
    return tuple(each._replace(above=None if one < 0 else one) for each, one in zip(crossings, above, strict=True))


@compiled("(f8[:,::1], i8[::1], i8[:,::1], f8[:,::1], f8[::1], " + DEPTH_TYPE + ", Array(u1, 3, 'C', readonly=True))")
def upper_strands(
    points: Array, stops: Indices, who: Indices, at: Array, widths: Array, depth: DepthImages, rgb: Image
) -> Indices:
    """Return which strand is above at each crossing: ``(C,)`` 0 for the first, 1 for the second, -1 if unknown.

    Args:
        points: ``(P, 2)`` pixels of all curves.
        stops: ``(K,)`` where each curve ends in ``points``.
        who: ``(C, 2)`` the curves that cross.
        at: ``(C, 4)`` shares of the lengths of both, and the pixel.
        widths: ``(K,)`` pixels.
        depth: See ``frame.depth_images``.
        rgb: ``(H, W, 3)``; empty without a picture.
    """
    out = np.full(len(who), -1, np.int64)
    for c in range(len(who)):
        heading = np.empty((2, 2))
        for s in range(2):
            curve = points[stops[who[c, s] - 1] if who[c, s] else 0 : stops[who[c, s]]]
            _heading(curve, at[c, s], float(widths[who[c, s]]), heading[s])
        sine = max(abs(heading[0, 0] * heading[1, 1] - heading[0, 1] * heading[1, 0]), 0.05)
        half = np.empty(2)  # how far along each strand the other one covers it
        for s in range(2):
            half[s] = min(0.5 * widths[who[c, 1 - s]] / sine, _LONGEST * widths[who[c, s]])
        if len(depth[0]) > 0 or len(depth[1]) > 0:
            out[c] = _by_depth(points, stops, who[c], at[c], widths, half, depth)
        if out[c] < 0 and len(rgb) > 0:
            out[c] = _by_profile(points, stops, who[c], at[c], widths, half, rgb)
    return out


@compiled
def _place(curve: Array, arc: Array, along: float) -> tuple[float, float]:
    """Return the point of a curve at an arc position; beyond its ends it goes on straight."""
    k = min(max(np.searchsorted(arc, along), 1), len(arc) - 1)
    share = (along - arc[k - 1]) / max(arc[k] - arc[k - 1], 1e-9)
    return (
        curve[k - 1, 0] + share * (curve[k, 0] - curve[k - 1, 0]),
        curve[k - 1, 1] + share * (curve[k, 1] - curve[k - 1, 1]),
    )


@compiled
def _heading(curve: Array, share: float, width: float, out: Array) -> None:
    """Write the direction of a curve, over a width to either side of a share of its length."""
    arc = arc_length(curve)
    here = share * arc[-1]
    u, v = _place(curve, arc, max(here - width, 0.0))
    far_u, far_v = _place(curve, arc, min(here + width, arc[-1]))
    norm = max(np.hypot(far_u - u, far_v - v), 1e-9)
    out[0], out[1] = (far_u - u) / norm, (far_v - v) / norm


@compiled
def depth_at(depth: DepthImages, u: float, v: float) -> float:
    """Return the depth at a pixel in metres; 0 where there is none."""
    (high, wide), column, row = (
        depth[0].shape if len(depth[0]) > 0 else depth[1].shape,
        nearest_pixel(u),
        nearest_pixel(v),
    )
    if not (0 <= row < high and 0 <= column < wide):
        return 0.0
    metres = metres_at(depth, row, column)
    return metres if 0 < metres < FARTHEST else 0.0


@compiled
def _by_depth(
    points: Array, stops: Indices, who: Indices, at: Array, widths: Array, half: Array, depth: DepthImages
) -> int:
    """Return which strand is above by the depth along both.

    The depth of each strand on either side of the crossing is continued into it by a line. The strand on top is seen
    there; the other one is hidden, and its line lies behind what is seen.
    """
    step, error = np.empty(2), np.empty(2)
    for s in range(2):
        k, other = who[s], who[1 - s]
        curve = points[stops[k - 1] if k else 0 : stops[k]]
        arc = arc_length(curve)
        here, width = at[s] * arc[-1], widths[k]
        number, sums, seen, on_top = 0, np.zeros(5), np.empty(2 * _SAMPLES), np.empty(2 * _SAMPLES)
        where = np.empty(2 * _SAMPLES)
        for i in range(2 * _SAMPLES):
            side = 1.0 if i % 2 else -1.0
            offset = side * (half[s] + 0.15 * widths[other] + 1.0 + (i // 2) / _SAMPLES * _BESIDE * width)
            if not 0 <= here + offset <= arc[-1]:
                continue
            u, v = _place(curve, arc, here + offset)
            metres = depth_at(depth, u, v)
            if metres > 0:
                seen[number], where[number] = metres, offset
                number += 1
        top = 0
        for i in range(2 * _SAMPLES):
            offset = (2 * i / (2 * _SAMPLES - 1) - 1) * _ON_TOP * min(widths[k], widths[other])
            u, v = _place(curve, arc, here + offset)
            metres = depth_at(depth, u, v)
            if metres > 0:
                on_top[top] = metres
                top += 1
        if number < _SAMPLES // 2 or top < 3:
            return -1
        middle = np.median(seen[:number])
        for i in range(number):
            if abs(seen[i] - middle) < 0.05:  # else a sample has slipped off the rope, to what is far behind
                sums[0] += 1
                sums[1] += where[i]
                sums[2] += where[i] * where[i]
                sums[3] += seen[i] - middle
                sums[4] += where[i] * (seen[i] - middle)
        spread = sums[0] * sums[2] - sums[1] * sums[1]
        if sums[0] < _SAMPLES // 2 or spread <= 0:
            return -1
        at_zero = (sums[2] * sums[3] - sums[1] * sums[4]) / spread
        slope = (sums[0] * sums[4] - sums[1] * sums[3]) / spread
        square = 0.0
        for i in range(number):
            if abs(seen[i] - middle) < 0.05:
                square += (seen[i] - middle - at_zero - slope * where[i]) ** 2
        step[s] = middle + at_zero - np.median(on_top[:top])
        error[s] = square / max(sums[0] - 2, 1.0) * sums[2] / spread
    apart = step[1] - step[0]
    if abs(apart) < max(_LEAST_STEP, _SURE * np.sqrt(error[0] + error[1])):
        return -1
    return 0 if apart > 0 else 1


@compiled
def _grey(rgb: Image, u: float, v: float) -> float:
    """Return the brightness between four pixels, the nearest ones of the image."""
    high, wide = rgb.shape[0], rgb.shape[1]
    u, v = min(max(u, 0.0), wide - 1.001), min(max(v, 0.0), high - 1.001)
    column, row = int(u), int(v)
    total = 0.0
    for i in range(2):
        for j in range(2):
            weight = (u - column if j else 1 - (u - column)) * (v - row if i else 1 - (v - row))
            pixel = rgb[row + i, column + j]
            total += weight * (float(pixel[0]) + float(pixel[1]) + float(pixel[2])) / 3
    return total


@compiled
def _by_profile(points: Array, stops: Indices, who: Indices, at: Array, widths: Array, half: Array, rgb: Image) -> int:
    """Return which strand is above by the brightness across both: the upper one looks within the crossing as beyond."""
    unlike = np.zeros(2)
    for s in range(2):
        k, other = who[s], who[1 - s]
        curve, beyond = (
            points[stops[k - 1] if k else 0 : stops[k]],
            points[stops[other - 1] if other else 0 : stops[other]],
        )
        arc, across = arc_length(curve), arc_length(beyond)
        here, there, width = at[s] * arc[-1], at[1 - s] * across[-1], float(widths[k])
        reach, place, number = 2 * half[1 - s] + widths[other], np.empty(2), 0
        first = max(np.searchsorted(across, there - reach) - 1, 0)
        stop = min(np.searchsorted(across, there + reach), len(across) - 1)
        for j in range(_LANES):
            lateral = float((2 * j / (_LANES - 1) - 1) * _LANE * width)
            known, total = 0, 0.0
            for i in range(2 * _SAMPLES):
                side = 1.0 if i % 2 else -1.0
                along = here + side * (half[s] + 0.25 * width + 1.0 + (i // 2) / _SAMPLES * width)
                if 0 <= along <= arc[-1]:
                    u, v = _beside(curve, arc, along, lateral, width)
                    total += _grey(rgb, u, v)
                    known += 1
            if known < _SAMPLES // 2:
                return -1
            for i in range(_SAMPLES):
                along = here + (2 * (i + 0.5) / _SAMPLES - 1) * half[s]
                u, v = _beside(curve, arc, along, lateral, width)
                place[0], place[1] = u, v
                if nearest_piece(beyond, place, first, stop)[0] < (_LANE * widths[other]) ** 2:
                    unlike[s] += abs(_grey(rgb, u, v) - total / known)
                    number += 1
        if number < _LANES:
            return -1
        unlike[s] /= number
    low, high = min(unlike[0], unlike[1]), max(unlike[0], unlike[1])
    if low > _LIKE * high or high - low < _CONTRAST:
        return -1
    return 0 if unlike[0] < unlike[1] else 1


@compiled
def _beside(curve: Array, arc: Array, along: float, lateral: float, width: float) -> tuple[float, float]:
    """Return the place to the side of a curve at an arc position."""
    u, v = _place(curve, arc, along)
    back_u, back_v = _place(curve, arc, along - 0.5 * width)
    far_u, far_v = _place(curve, arc, along + 0.5 * width)
    norm = max(np.hypot(far_u - back_u, far_v - back_v), 1e-9)
    return u - lateral * (far_v - back_v) / norm, v + lateral * (far_u - back_u) / norm
