"""Share the pixels of one mask among the objects that it holds, each of which is known by a curve."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.image.connected_runs import nearest_pixel
from shape_obs.image.find_region import find_region
from shape_obs.image.region import Region
from shape_obs.image.roi import Window

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]
Owners = npt.NDArray[np.uint32]

_RAGGED: Final = 0.75  # pixels that the border of a ribbon may stick out
_DENSE: Final = 0.16  # of the square of a radius: points of a curve that are closer make no difference
MOST: Final = 32  # objects in one mask: a bit each


@compiled("(u1[:,::1], i8[:,::1], i8, i8, f8[:,::1], i8[::1], f8[::1], f8, f8, i8)")
def share_pixels(
    mask: Mask,
    runs: Indices,
    left: int,
    top: int,
    points: Array,
    stops: Indices,
    radius: Array,
    reach: float,
    slack: float,
    spread: int,
) -> tuple[Owners, Indices, int]:
    """Return which curves each pixel of a mask belongs to, as bits, and how much is contested.

    A pixel belongs to the curve whose ribbon is nearest, and to every other one whose ribbon is hardly farther: where
    curves cross, to both. With a negative slack it belongs to one alone, or to none where another ribbon is about as
    near.

    Args:
        mask: ``(h, w)`` uint8, 0 = background.
        runs: ``(R, 3)`` its runs, image coordinates.
        left: Image column of its first pixel.
        top: Image row of its first pixel.
        points: ``(P, 2)`` pixels of all curves, one after the other, closer than their radius.
        stops: ``(K,)`` where each curve ends in ``points``; at most ``MOST`` of them.
        radius: ``(K,)`` half the width of each ribbon, pixels.
        reach: Pixels around a ribbon that it may claim.
        slack: A second ribbon that is farther by so many pixels claims a pixel as well; if negative, one that is
            farther by less than so many denies it.
        spread: Pixels beyond the reach of all ribbons, at most so far along the mask, go to the owners of the nearest.

    Returns:
        ``(h, w)`` bits, 0 for the background and for what belongs to none; ``(K,)`` how many pixels of each ribbon
        another one reaches as well; how many pixels of the mask are beyond the reach of all.
    """
    high, wide = mask.shape
    least, second = np.empty((high, wide), np.float32), np.empty((high, wide), np.float32)
    nearest, owners = np.empty((high, wide), np.int8), np.zeros((high, wide), np.uint32)
    for at in range(len(runs)):
        for column in range(runs[at, 1] - left, runs[at, 2] - left):
            row = runs[at, 0] - top
            least[row, column] = second[row, column] = np.inf
            nearest[row, column] = -1
    for k in range(len(stops)):
        far, begin, end = radius[k] + reach, stops[k - 1] if k else 0, stops[k]
        before = -1
        for p in range(begin, end):
            if 0 <= before < p < end - 1:
                du, dv = points[p, 0] - points[before, 0], points[p, 1] - points[before, 1]
                if du * du + dv * dv < _DENSE * radius[k] * radius[k]:
                    continue
            before = p
            u, v = points[p, 0] - left, points[p, 1] - top
            # Near a tip: pixels beyond it are outside the ribbon, or it would grow along another one that it touches.
            tip, inner = (begin, min(begin + 2, end - 1)) if p - begin < end - 1 - p else (end - 1, max(end - 3, begin))
            tip_u, tip_v = points[tip, 0] - left, points[tip, 1] - top
            out_u, out_v = points[tip, 0] - points[inner, 0], points[tip, 1] - points[inner, 1]
            at_tip = np.hypot(u - tip_u, v - tip_v) <= radius[k]
            for row in range(max(nearest_pixel(v - far), 0), min(nearest_pixel(v + far) + 1, high)):
                below = (row - v) * (row - v)
                half = np.sqrt(max(far * far - below, 0.0))
                for column in range(max(int(np.ceil(u - half)), 0), min(int(np.floor(u + half)) + 1, wide)):
                    if mask[row, column] == 0:
                        continue
                    square = below + (column - u) * (column - u)
                    excess = np.float32(np.sqrt(square) - radius[k] if square > radius[k] * radius[k] else 0.0)
                    if at_tip and (column - tip_u) * out_u + (row - tip_v) * out_v > 0:
                        excess = np.float32(np.hypot(column - tip_u, row - tip_v))
                    if slack >= 0 and excess <= slack:
                        owners[row, column] |= np.uint32(1 << k)
                    if nearest[row, column] == k:
                        least[row, column] = min(least[row, column], excess)
                    elif excess < least[row, column]:
                        second[row, column], least[row, column] = least[row, column], excess
                        nearest[row, column] = k
                    else:
                        second[row, column] = min(second[row, column], excess)
    contested, beyond = np.zeros(len(stops), np.int64), 0
    for at in range(len(runs)):
        for column in range(runs[at, 1] - left, runs[at, 2] - left):
            row = runs[at, 0] - top
            k = nearest[row, column]
            if k < 0:
                beyond += 1
                continue
            if second[row, column] < np.inf:
                contested[k] += 1
            if slack >= 0 or second[row, column] - least[row, column] >= -slack:
                owners[row, column] |= np.uint32(1 << k)
    if spread > 0 and beyond > 0:
        _spread(mask, runs, left, top, owners, spread)
    return owners, contested, beyond


@compiled
def _spread(mask: Mask, runs: Indices, left: int, top: int, owners: Owners, steps: int) -> None:
    """Give pixels of a mask that belong to none to the owners of the nearest, some steps along the mask, in place."""
    high, wide = mask.shape
    waiting, count, at = np.empty(mask.size, np.int64), 0, 0
    for run in range(len(runs)):
        row = runs[run, 0] - top
        for column in range(runs[run, 1] - left, runs[run, 2] - left):
            if owners[row, column]:
                for step in range(4):
                    v, u = row + (step == 0) - (step == 1), column + (step == 2) - (step == 3)
                    if 0 <= v < high and 0 <= u < wide and mask[v, u] and owners[v, u] == 0:
                        waiting[count] = row * wide + column
                        count += 1
                        break
    for _ in range(steps):
        layer = count
        while at < layer:
            row, column = waiting[at] // wide, waiting[at] % wide
            at += 1
            for step in range(4):
                v, u = row + (step == 0) - (step == 1), column + (step == 2) - (step == 3)
                if 0 <= v < high and 0 <= u < wide and mask[v, u] and owners[v, u] == 0:
                    owners[v, u] = owners[row, column]
                    waiting[count] = v * wide + u
                    count += 1


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
    left, top, *_ = region.window
    points, stops = np.ascontiguousarray(np.concatenate(curves)), np.cumsum([len(curve) for curve in curves])
    radius, spread = np.array(widths) / 2 + _RAGGED, round(how.spread * max(widths))
    image = region.mask, region.runs, left, top
    return share_pixels(*image, points, stops, radius, how.reach, how.slack, spread)


def part_of(region: Region, owners: Owners, curves: Iterable[int], min_area: int, min_share: float) -> Region:
    """Return the pixels of a region that belong to some of the curves, as a region of its own.

    Args:
        region: Of all objects.
        owners: ``(h, w)`` bits, see ``share_pixels``.
        curves: Their indices.
        min_area: Smaller pieces are dropped, pixels.
        min_share: So are those smaller than this share of the largest.
    """
    own = (owners & np.uint32(sum(1 << k for k in curves))) != 0
    rows, columns = np.flatnonzero(own.any(axis=1)), np.flatnonzero(own.any(axis=0))
    left, top, wide, high = 0, 0, own.shape[1], own.shape[0]
    if len(rows):  # a pixel of background around it, but for what the whole region's window cuts off
        left, top = max(int(columns[0]) - 1, 0), max(int(rows[0]) - 1, 0)
        wide, high = min(int(columns[-1]) + 2, wide) - left, min(int(rows[-1]) + 2, high) - top
    window = Window(region.window.left + left, region.window.top + top, wide, high)
    mask = np.ascontiguousarray(own[top : top + high, left : left + wide]).view(np.uint8)
    return find_region(mask, window, min_area, min_share)
