"""What lies ahead of the end of a strand: the same question to a mask and to a cloud."""

from __future__ import annotations

from typing import Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.body import Body
from shape_obs.cloud import Cloud
from shape_obs.deproject import SeenCloud
from shape_obs.region import Region

Array = npt.NDArray[np.float64]

_SIDE: Final = 0.75  # widths: how far to the side a point may lie to belong to this strand
_REACH: Final = 1.5  # widths: how far ahead
# Widths: a strand goes on where a pixel lies beyond the first; noise alone throws points of a cloud that far, so there
# the bulk must.
_BEYOND: Final = (0.6, 0.8)
_GAP: Final = (0.4, 5.0)  # in a cloud: the least gap between points that ends a strand, in widths and in usual gaps


class Ahead(NamedTuple):
    """The strand ahead of a place.

    Args:
        offset: (P,D) its points from there.
        along: (P,) how far each lies ahead.
        rest: The length of it, in the body's unit, where it ends within 1.5 widths.
        goes_on: Whether there is more of it than a last piece.
    """

    offset: Array
    along: Array
    rest: float
    goes_on: bool


def ahead(body: Body, front: Array, heading: Array, width: float) -> Ahead:
    """The strand that goes on from ``front`` (D,) in the direction ``heading``, a unit vector."""
    return _in_cloud(body, front, heading, width) if isinstance(body, Cloud) else _in_mask(body, front, heading, width)


def _in_cloud(cloud: Cloud, front: Array, heading: Array, width: float) -> Ahead:
    """Noise carries as many points forwards over the start as back, and at the far end it leaves the mean alone.

    So the length is twice the mean, for points that are spread evenly.
    """
    points = cloud.around(front, _REACH * width)
    offset = points - front
    along = offset @ heading
    side = np.sqrt(np.maximum(np.einsum("pd,pd->p", offset, offset) - along**2, 0.0))
    strand = (along > 0) & (side <= _SIDE * width)
    # Another strand that passes ahead is no part of this one.
    if isinstance(cloud, SeenCloud):
        strand[strand] = cloud.in_sight(front, points[strand])
    else:
        strand &= along <= _first_gap(along[strand], width)
    offset, along = offset[strand], along[strand]
    rest = 2 * float(along.mean()) if len(along) else 0.0
    return Ahead(offset, along, rest, rest > _BEYOND[1] * width)


def _first_gap(along: Array, width: float) -> float:
    """How far points hang together that lie (P,) ahead."""
    order = np.sort(np.append(along, 0.0))
    gap = max(_GAP[0] * width, _GAP[1] * _REACH * width / len(order))
    return float(order[np.argmax(np.append(np.diff(order) > gap, True))])


def _in_mask(region: Region, front: Array, heading: Array, width: float) -> Ahead:
    """The pixels that hang together with ``front``."""
    reach = _REACH * width + 2
    u, v = front[0] - region.window.left, front[1] - region.window.top
    left, top = max(int(u - reach), 0), max(int(v - reach), 0)
    crop = region.mask[top : int(v + reach) + 2, left : int(u + reach) + 2]
    x = np.arange(crop.shape[1]) + (left - u)
    y = np.arange(crop.shape[0])[:, None] + (top - v)
    along, side = x * heading[0] + y * heading[1], y * heading[0] - x * heading[1]
    strand = (crop > 0) & (along > 0) & (np.abs(side) <= _SIDE * width)
    if not strand.any():
        return Ahead(np.zeros((0, 2)), np.zeros(0), 0.0, False)
    labels = cv2.connectedComponents(strand.view(np.uint8), connectivity=8)[1]
    nearest = np.argmin(np.where(strand, x * x + y * y, np.inf))
    rows, columns = np.nonzero(labels == labels.flat[nearest])
    along, side = along[rows, columns], side[rows, columns]
    offset = np.stack([x[columns], y[rows, 0]], axis=1)
    return Ahead(offset, along, _by_area(along, side, width), bool(np.any(along > _BEYOND[0] * width)))


def _by_area(along: Array, side: Array, width: float) -> float:
    """The length of a strand: pixels in its middle over the strip's breadth.

    Exact to a fraction of a pixel for flat caps, a twentieth of the radius short for round ones.
    """
    breadth = max(width / 4, 0.5)
    strip = along[(along > 0) & (np.abs(side) <= breadth)]
    # On a strip of one or two rows the area is off by a pixel; no rest is longer than its farthest pixel.
    return min(len(strip) / (2 * breadth), float(strip.max(initial=0.0)) + 0.5)
