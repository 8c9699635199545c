"""What lies ahead of the end of a strand in a cloud; in a mask, ``Kernels.ribbon`` asks the same."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.cloud import Cloud
from shape_obs.deproject import SeenCloud
from shape_obs.kernels.interface import REACH, SIDE

Array = npt.NDArray[np.float64]

_BEYOND: Final = 0.8  # widths: noise throws single points far, so the bulk must lie farther than a pixel of a mask
_GAP: Final = (0.4, 5.0)  # the least gap between points that ends a strand, in widths and in usual gaps


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


def ahead(cloud: Cloud, front: Array, heading: Array, width: float) -> Ahead:
    """The strand that goes on from ``front`` (3,) in the direction ``heading``, a unit vector.

    Noise carries as many points forwards over the start as back, and at the far end it leaves the mean alone.

    So the length is twice the mean, for points that are spread evenly.
    """
    points = cloud.around(front, REACH * width)
    offset = points - front
    along = offset @ heading
    side = np.sqrt(np.maximum(np.einsum("pd,pd->p", offset, offset) - along**2, 0.0))
    strand = (along > 0) & (side <= SIDE * width)
    # Another strand that passes ahead is no part of this one.
    if isinstance(cloud, SeenCloud):
        strand[strand] = cloud.in_sight(front, points[strand])
    else:
        strand &= along <= _first_gap(along[strand], width)
    offset, along = offset[strand], along[strand]
    rest = 2 * float(along.mean()) if len(along) else 0.0
    return Ahead(offset, along, rest, rest > _BEYOND * width)


def _first_gap(along: Array, width: float) -> float:
    """How far points hang together that lie (P,) ahead."""
    order = np.sort(np.append(along, 0.0))
    gap = max(_GAP[0] * width, _GAP[1] * REACH * width / len(order))
    return float(order[np.argmax(np.append(np.diff(order) > gap, True))])
