"""Connectors, plugs and hands: parts at the end of a rope that are much wider than the rope, cut from its mask."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.image.find_region import find_region
from shape_obs.image.region import Region
from shape_obs.initialization.objects import SHORTEST_ROPE

Array = npt.NDArray[np.float32]
Mask = npt.NDArray[np.uint8]

_WIDER: Final = 2.3  # rope radii that a connector has at least: two strands side by side have 2, ragged ones 2.2
_ENDS: Final = 1.45  # rope radii: where no larger circle fits in, a connector ends; crossing strands have 1.4
_CORE: Final = _WIDER / _ENDS  # of a connector's radius over that of the circles that first separate it from its rope
_HEAVIER: Final = 4.0  # times its rope's pixels: a larger part is an object with a tail, and no connector
_THIN: Final = 20  # percentile of the radii along all axes: connectors of thinner ropes are not looked for
_LEAST: Final = 1.5  # pixels of radius: thinner axes are noise
_MOST: Final = 16  # wide places that are looked at, which bounds the time


def without_connectors(region: Region) -> tuple[Region, bool]:
    """Cut the connectors from a mask of ropes.

    A connector is a part that a single rope enters and that is at least 2.3 times as wide as the rope next to it. What
    several ropes enter is none, nor is a wide object without a rope, or with a short one: the rope must be three widths
    long, reach as far as the connector is wide and have a quarter of its pixels.

    Args:
        region: The mask of any number of ropes.

    Returns:
        The mask without its connectors, and whether there are any; without one the region is returned as it is.
    """
    left, top = region.box.left - region.window.left, region.box.top - region.window.top
    box = slice(top, top + region.box.height), slice(left, left + region.box.width)
    mask = np.pad((region.mask[box] > 0).view(np.uint8), 1)
    radius = np.asarray(cv2.distanceTransform(mask, cv2.DIST_L2, 5), np.float32)
    axis = (radius >= _LEAST) & (radius >= cv2.dilate(radius, np.ones((3, 3), np.uint8)))
    along = radius[axis]
    if not len(along) or along.max() < _WIDER * _thin(along):
        return region, False
    cut = _cut(mask, radius, axis)
    if not cut.any():
        return region, False
    bare = region.mask.copy()
    bare[box][cut[1:-1, 1:-1] > 0] = 0
    return find_region(bare, region.window, 1, 0.0), True


def _thin(radii: Array) -> float:
    """Return the radius of thin ropes among those of all axes."""
    place = len(radii) * _THIN // 100
    return float(np.partition(radii, place)[place])  # NumPy's percentile takes ten times as long


class _Arms(NamedTuple):
    """What a wide part of a mask is attached to.

    Args:
        long: How many ropes enter the part.
        radius: Of the thinnest of them next to the part, pixels.
        rest: Pixels of all of them.
        part: The part with what else sticks out of it, ``(h, w)`` 0 and 1.
    """

    long: int
    radius: float
    rest: int
    part: Mask


def _cut(mask: Mask, radius: Array, axis: npt.NDArray[np.bool_]) -> Mask:
    """Return the pixels of all connectors, ``(h, w)`` 0 and 1."""
    found, waiting = np.zeros_like(mask), np.where(axis, radius, 0.0)
    thin = _WIDER * _thin(radius[axis])
    for _ in range(_MOST):
        place = int(np.argmax(waiting))
        widest = float(waiting.flat[place])
        if widest < thin:
            break
        middle = (place % mask.shape[1], place // mask.shape[1])
        left = mask & ~found
        core = _around(left, radius, middle, widest / _CORE)
        arms = _arms(left, core, radius, axis, middle)
        if arms.long == 1 and widest >= _WIDER * arms.radius:
            whole = _arms(left, _around(left, radius, middle, _ENDS * arms.radius), radius, axis, middle)
            if whole.long == 1 and int(whole.part.sum()) <= _HEAVIER * whole.rest:
                found |= whole.part
                core = whole.part
        waiting[core > 0] = 0.0
    return found


def _around(mask: Mask, radius: Array, middle: tuple[int, int], least: float) -> Mask:
    """Return the part of a mask that circles of a radius fill that can be moved to ``middle`` inside the mask."""
    core = ((radius > least) & (mask > 0)).view(np.uint8)
    labels = cv2.connectedComponents(core, connectivity=4)[1]
    own = (labels != labels[middle[1], middle[0]]).view(np.uint8)
    away = np.asarray(cv2.distanceTransform(own, cv2.DIST_L2, 5))
    return ((away <= least) & (mask > 0)).view(np.uint8)


def _arms(mask: Mask, part: Mask, radius: Array, axis: npt.NDArray[np.bool_], middle: tuple[int, int]) -> _Arms:
    """Return the ropes that enter a part of a mask."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask & ~part, connectivity=8)
    across = 2 * float(radius[middle[1], middle[0]])  # so far along a rope its width is measured
    away = np.asarray(cv2.distanceTransform(1 - part, cv2.DIST_L2, 5))
    touching = np.unique(labels[away < 2])  # next to it
    rows, columns = np.nonzero(axis & (away < across))
    whole, thinnest, long, rest = part.copy(), math.inf, 0, 0
    for label in touching[touching > 0].tolist():
        own = labels[rows, columns] == label
        r = float(np.median(radius[rows[own], columns[own]])) if own.any() else _LEAST
        area = int(stats[label, cv2.CC_STAT_AREA])
        extent = float(away[labels == label].max())
        if extent >= max(SHORTEST_ROPE * 2 * r, across):
            long, thinnest, rest = long + 1, min(thinnest, r), rest + area
        else:
            whole[labels == label] = 1
    return _Arms(long, thinnest, rest, whole)
