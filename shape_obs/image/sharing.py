"""Share the pixels of one mask among the objects that it holds, each of which is known by a curve."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.image.connected_runs import nearest_pixel
from shape_obs.image.find_region import region_of_runs
from shape_obs.image.region import Region

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Owners = npt.NDArray[np.uint32]
Singles = npt.NDArray[np.float32]

_RAGGED: Final = 0.75  # pixels that the border of a ribbon may stick out
_DENSE: Final = 0.16  # of the square of a radius: points of a curve that are closer make no difference
MOST: Final = 32  # objects in one mask: a bit each


@compiled("(i8[:,::1], f8[:,::1], i8[::1], f8[::1], f8, f8, i8)")
def share_pixels(
    runs: Indices, points: Array, stops: Indices, radius: Array, reach: float, slack: float, spread: int
) -> tuple[Owners, Indices, int]:
    """Return which curves each pixel of a mask belongs to, as bits, and how much is contested.

    A pixel belongs to the curve whose ribbon is nearest, and to every other one whose ribbon is hardly farther: where
    curves cross, to both. With a negative slack it belongs to one alone, or to none where another ribbon is about as
    near.

    Args:
        runs: ``(R, 3)`` of the mask, see ``connected_runs``.
        points: ``(P, 2)`` pixels of all curves, one after the other, closer than their radius.
        stops: ``(K,)`` where each curve ends in ``points``; at most ``MOST`` of them.
        radius: ``(K,)`` half the width of each ribbon, pixels.
        reach: Pixels around a ribbon that it may claim.
        slack: A second ribbon that is farther by so many pixels claims a pixel as well; if negative, one that is
            farther by less than so many denies it.
        spread: Pixels beyond the reach of all ribbons, at most so far along the mask, go to the owners of the nearest.

    Returns:
        Bits of each pixel of the mask in the order of the runs, 0 for what belongs to none; ``(K,)`` how many pixels of
        each ribbon another one reaches as well; how many pixels of the mask are beyond the reach of all.
    """
    begin = np.zeros(len(runs) + 1, np.int64)  # the first pixel of each run
    for at in range(len(runs)):
        begin[at + 1] = begin[at] + runs[at, 2] - runs[at, 1]
    count = begin[-1]
    least, second = np.full(count, np.inf, np.float32), np.full(count, np.inf, np.float32)
    nearest, owners = np.full(count, -1, np.int8), np.zeros(count, np.uint32)
    square = np.full(count, np.inf, np.float32)  # of the distance to one curve
    for k in range(len(stops) if count else 0):
        _measure(square, runs, begin, points[stops[k - 1] if k else 0 : stops[k]], radius[k], reach)
        for at in range(count):
            if square[at] == np.inf:
                continue
            excess = np.float32(max(np.sqrt(square[at]) - radius[k], 0.0))
            square[at] = np.inf
            if slack >= 0 and excess <= slack:
                owners[at] |= np.uint32(1 << k)
            if excess < least[at]:
                second[at], least[at], nearest[at] = least[at], excess, k
            else:
                second[at] = min(second[at], excess)
    contested, beyond = np.zeros(len(stops), np.int64), 0
    for at in range(count):
        k = nearest[at]
        if k < 0:
            beyond += 1
            continue
        if second[at] < np.inf:
            contested[k] += 1
        if slack >= 0 or second[at] - least[at] >= -slack:
            owners[at] |= np.uint32(1 << k)
    if spread > 0 and beyond > 0:
        _spread(owners, runs, begin, spread)
    return owners, contested, beyond


@compiled
def _measure(square: Singles, runs: Indices, begin: Indices, curve: Array, radius: float, reach: float) -> None:
    """Lower the squares of pixels' distances to a curve where they are within its reach, in place.

    Pixels beyond a tip lie as far outside the ribbon as they are from the tip, or it would grow along another one that
    it touches.
    """
    rows, far, last, before = _rows(runs), radius + reach, len(curve) - 1, -1
    for p in range(last + 1):
        if 0 <= before < p < last:
            du, dv = curve[p, 0] - curve[before, 0], curve[p, 1] - curve[before, 1]
            if du * du + dv * dv < _DENSE * radius * radius:
                continue
        before = p
        u, v = curve[p, 0], curve[p, 1]
        tip, inner = (0, min(2, last)) if 2 * p < last else (last, max(last - 2, 0))
        out_u, out_v = curve[tip, 0] - curve[inner, 0], curve[tip, 1] - curve[inner, 1]
        at_tip = np.hypot(u - curve[tip, 0], v - curve[tip, 1]) <= radius
        for row in range(max(nearest_pixel(v - far), runs[0, 0]), min(nearest_pixel(v + far), runs[-1, 0]) + 1):
            below = (row - v) * (row - v)
            half = np.sqrt(max(far * far - below, 0.0))
            for at in range(rows[row - runs[0, 0]], rows[row - runs[0, 0] + 1]):
                first, stop = max(int(np.ceil(u - half)), runs[at, 1]), min(int(np.floor(u + half)) + 1, runs[at, 2])
                if first >= stop:
                    continue
                pixels = square[begin[at] + first - runs[at, 1] : begin[at] + stop - runs[at, 1]]
                if not at_tip:  # a loop without branches takes several pixels at once
                    for i in range(len(pixels)):
                        across = np.float32(first + i - u)
                        away = np.float32(below) + across * across
                        pixels[i] = away if away < pixels[i] else pixels[i]
                    continue
                for i in range(len(pixels)):
                    across, beyond = first + i - u, first + i - curve[tip, 0]
                    away = np.float32(below + across * across)
                    if beyond * out_u + (row - curve[tip, 1]) * out_v > 0:
                        away = np.float32((np.hypot(beyond, row - curve[tip, 1]) + radius) ** 2)
                    pixels[i] = min(pixels[i], away)


@compiled
def _rows(runs: Indices) -> Indices:
    """Return the first run of each row from that of the first run, and where the last row ends."""
    first = np.full(runs[-1, 0] - runs[0, 0] + 2, len(runs))
    for at in range(len(runs) - 1, -1, -1):
        first[runs[at, 0] - runs[0, 0]] = at
    for row in range(len(first) - 2, -1, -1):  # a row without runs begins where the next one does
        first[row] = min(first[row], first[row + 1])
    return first


@compiled
def _spread(owners: Owners, runs: Indices, begin: Indices, steps: int) -> None:
    """Give pixels of a mask that belong to none to the owners of the nearest, some steps along the mask, in place."""
    adjacent = _neighbours(runs, begin)
    waiting, count, at = np.empty(len(owners), np.int64), 0, 0
    for pixel in range(len(owners)):
        if owners[pixel]:
            for k in range(4):
                if adjacent[pixel, k] >= 0 and owners[adjacent[pixel, k]] == 0:
                    waiting[count] = pixel
                    count += 1
                    break
    for _ in range(steps):
        layer = count
        while at < layer:
            pixel = waiting[at]
            at += 1
            for k in range(4):
                other = adjacent[pixel, k]
                if other >= 0 and owners[other] == 0:
                    owners[other] = owners[pixel]
                    waiting[count] = other
                    count += 1


@compiled
def _neighbours(runs: Indices, begin: Indices) -> Indices:
    """Return the pixels on the left, on the right, above and below each pixel of a mask, -1 for the background."""
    adjacent, above = np.full((begin[-1], 4), -1), 0
    for at in range(len(runs)):
        for pixel in range(begin[at], begin[at + 1]):
            adjacent[pixel, 0] = pixel - 1 if pixel > begin[at] else -1
            adjacent[pixel, 1] = pixel + 1 if pixel < begin[at + 1] - 1 else -1
        while runs[above, 0] < runs[at, 0] - 1 or (runs[above, 0] < runs[at, 0] and runs[above, 2] <= runs[at, 1]):
            above += 1
        other = above  # the runs of the row above that begin before this one ends
        while runs[other, 0] == runs[at, 0] - 1 and runs[other, 1] < runs[at, 2]:
            for column in range(max(runs[at, 1], runs[other, 1]), min(runs[at, 2], runs[other, 2])):
                here, there = begin[at] + column - runs[at, 1], begin[other] + column - runs[other, 1]
                adjacent[here, 2], adjacent[there, 3] = there, here
            other += 1
    return adjacent


class Reach(NamedTuple):
    """How far ribbons claim pixels.

    Args:
        reach: Pixels around a ribbon.
        slack: See ``share_pixels``.
        spread: Widths: what sticks out of a ribbon no farther along the mask belongs to it.
    """

    reach: float
    slack: float
    spread: float = 0.0


#: Ribbons where they are expected, and where they may have moved far: what is theirs for certain.
EXPECTED: Final = Reach(6.0, -3.0)
WIDE: Final = Reach(16.0, -3.0)
#: Ribbons where they were found: with all that is theirs, without what sticks out, and with the ragged border alone.
FOUND: Final = Reach(3.0, 0.5, 2.0)
TRACED: Final = Reach(3.0, 0.5)
CLOSE: Final = Reach(1.5, 0.5)


def share(region: Region, curves: Sequence[Array], widths: Sequence[float], how: Reach) -> tuple[Owners, Indices, int]:
    """Share the pixels of a region among ribbons, see ``share_pixels``.

    Args:
        region: Of all objects.
        curves: ``(P, 2)`` pixels each.
        widths: Pixels.
        how: How far the ribbons reach.
    """
    points, stops = np.ascontiguousarray(np.concatenate(curves)), np.cumsum([len(curve) for curve in curves])
    radius, spread = np.array(widths) / 2 + _RAGGED, round(how.spread * max(widths))
    return share_pixels(region.runs, points, stops, radius, how.reach, how.slack, spread)


def part_of(region: Region, owners: Owners, curves: Iterable[int], min_area: int, min_share: float) -> Region:
    """Return the pixels of a region that belong to some of the curves, as a region of its own.

    Args:
        region: Of all objects.
        owners: Bits of each pixel, see ``share_pixels``.
        curves: Their indices.
        min_area: Smaller pieces are dropped, pixels.
        min_share: So are those smaller than this share of the largest.
    """
    return region_of_runs(
        owned_runs(region.runs, owners, sum(1 << k for k in curves)), region.window, min_area, min_share
    )


@compiled("(i8[:,::1], u4[::1], i8)")
def owned_runs(runs: Indices, owners: Owners, bits: int) -> Indices:
    """Return the runs of the pixels that have one of some bits, ``(S, 3)``."""
    found, size, begin = np.empty((2 * len(runs) + 16, 3), np.int64), 0, 0
    for at in range(len(runs)):
        first, inside = runs[at, 1], False
        pixels = owners[begin : begin + runs[at, 2] - first]
        begin += len(pixels)
        for i in range(len(pixels)):
            owned = pixels[i] & np.uint32(bits) != 0
            if owned == inside:
                continue
            if size == len(found):
                found = np.concatenate((found, np.empty_like(found)))
            if owned:
                found[size, 0], found[size, 1] = runs[at, 0], first + i
            else:
                found[size, 2] = first + i
                size += 1
            inside = owned
        if inside:
            found[size, 2] = runs[at, 2]
            size += 1
    return found[:size].copy()
