"""What lies ahead of the end of a strand in a cloud; in a mask, ``Kernels.ribbon`` asks the same.

The real ends of a rope in a cloud, past the last cluster centres; in a mask, ``Kernels.ribbon`` finds them.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled.interface import LAST, LAST_REST, MAX_STEPS, REACH, SHORTEST, SIDE, STEP_FROM, STEP_TO
from shape_obs.point_cloud.cloud import Cloud
from shape_obs.point_cloud.deprojection import SeenCloud

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


def extend_to_tips(nodes: Array, cloud: Cloud, width: float) -> Array:
    """Cut a chain of cluster centres where it hangs over the cloud, and lengthen it to the tips.

    Args:
        nodes: (K,3) metres, K >= 3.
        cloud: What they were fitted to.
        width: The rope's, metres.

    Returns:
        (K',3); the first and last points lie on the tips.
    """
    width = max(width, cloud.thinnest)
    on = np.flatnonzero(cloud.carries(nodes))  # a prediction that overshoots leaves empty nodes past the end
    if len(on) and on[-1] - on[0] >= 2:
        nodes = nodes[on[0] : on[-1] + 1]
    head = _extension(nodes[:3], cloud, width)
    tail = _extension(nodes[:-4:-1], cloud, width)
    return np.concatenate([head[::-1], nodes, tail])


def _extension(start: Array, cloud: Cloud, width: float) -> Array:
    """(S,3) from the end of a chain, the first of (3,3) nodes, to the tip."""
    front, heading, rest = start[0], _heading(start), 0.0
    path: list[Array] = []
    for _ in range(MAX_STEPS):
        offset, along, rest, goes_on = ahead(cloud, front, heading, width)
        if goes_on:
            piece = (along > STEP_FROM * width) & (along <= STEP_TO * width)
        elif rest > LAST_REST * width:
            piece = along > rest - LAST * width
        else:
            break
        if not piece.any():
            break
        step = offset[piece].mean(axis=0)
        heading = _continue(heading, step)
        front = front + step
        path.append(front)
    return np.array([*path, front + heading * max(rest, SHORTEST * cloud.thinnest)])


def _heading(nodes: Array) -> Array:
    """Direction out of the first of three nodes, their curvature continued."""
    near, far = nodes[0] - nodes[1], nodes[1] - nodes[2]
    near, far = near / max(np.linalg.norm(near), 1e-9), far / max(np.linalg.norm(far), 1e-9)
    return _unit(near + (near - far) / 2, near)


def _continue(heading: Array, step: Array) -> Array:
    """The heading after a step. On a circle the tangent turns twice as far as the chord; half of that more is taken."""
    chord = _unit(step, heading)
    return _unit(chord + (chord - heading) / 2, chord)


def _unit(vector: Array, otherwise: Array) -> Array:
    norm = float(np.linalg.norm(vector))
    return vector / norm if norm > 1e-9 else otherwise
