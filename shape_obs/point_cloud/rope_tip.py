"""The tips of a rope in a cloud: go on from the last nodes of a chain along its strand to where it ends.

``shape_obs.image.rope_tip`` does the same in a mask.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from shape_obs.image.rope_tip import LAST, LAST_REST, MAX_STEPS, REACH, SHORTEST, SIDE, STEP_FROM, STEP_TO

if TYPE_CHECKING:
    from shape_obs.point_cloud.cloud import Cloud

Array = npt.NDArray[np.float64]


_BEYOND: Final = 0.8  # widths: noise throws single points far, so the bulk must lie farther than a pixel of a mask

_GAP: Final = (0.4, 5.0)  # the least gap between points that ends a strand, in widths and in usual gaps


def ahead(cloud: Cloud, front: Array, heading: Array, width: float) -> tuple[Array, Array]:
    """Return the strand that goes on from ``front`` ``(3,)`` in the direction ``heading``, a unit vector.

    Returns:
        ``(P, 3)`` its points from there; ``(P,)`` how far each lies ahead.
    """
    offset = cloud.around(front, REACH * width) - front
    along = offset @ heading
    side = np.sqrt(np.maximum(np.einsum("pd,pd->p", offset, offset) - along**2, 0.0))
    strand = (along > 0) & (side <= SIDE * width)
    # Another strand that passes ahead is no part of this one.
    strand[strand] = cloud.connected_ahead(front, front + offset[strand], along[strand], width)
    return offset[strand], along[strand]


def first_gap(along: Array, width: float) -> float:
    """Return how far points are connected that lie ``(P,)`` ahead."""
    order = np.sort(np.append(along, 0.0))
    gap = max(_GAP[0] * width, _GAP[1] * REACH * width / len(order))
    return float(order[np.argmax(np.append(np.diff(order) > gap, True))])


def extend_chain(nodes: Array, cloud: Cloud, width: float) -> Array:
    """Cut a chain of nodes where it hangs over the cloud, and lengthen it to the tips.

    Args:
        nodes: ``(K, 3)`` metres, K >= 3.
        cloud: What they were fitted to.
        width: The rope's, metres.

    Returns:
        ``(K', 3)``; the first and last points lie on the tips.
    """
    width = max(width, cloud.thinnest)
    on = np.flatnonzero(cloud.carries(nodes))  # a prediction that overshoots leaves empty nodes past the end
    if len(on) and on[-1] - on[0] >= 2:
        nodes = nodes[on[0] : on[-1] + 1]
    head = _extension(nodes[:3], cloud, width)
    tail = _extension(nodes[:-4:-1], cloud, width)
    return np.concatenate([head[::-1], nodes, tail])


def _extension(start: Array, cloud: Cloud, width: float) -> Array:
    """Return the way ``(S, 3)`` from the end of a chain, the first of ``(3, 3)`` nodes, to the tip."""
    front, heading, rest = start[0], _bent(start[0] - start[1], start[1] - start[2]), 0.0
    path: list[Array] = []
    for _ in range(MAX_STEPS):
        offset, along = ahead(cloud, front, heading, width)
        # Noise moves as many points forwards over the start as back, and at the far end it leaves the mean alone. So
        # the length is twice the mean, for points that are spread evenly.
        rest = 2 * float(along.mean()) if len(along) else 0.0
        if rest > _BEYOND * width:
            piece = (along > STEP_FROM * width) & (along <= STEP_TO * width)
        elif rest > LAST_REST * width:
            piece = along > rest - LAST * width
        else:
            break
        if not piece.any():
            break
        step = offset[piece].mean(axis=0)
        heading = _bent(step, heading)
        front = front + step
        path.append(front)
    return np.array([*path, front + heading * max(rest, SHORTEST * cloud.thinnest)])


def _bent(ahead: Array, before: Array) -> Array:
    """Return the heading after two chords: on a circle the tangent turns twice as far as a chord; half is added."""
    ahead, before = (way / max(float(np.linalg.norm(way)), 1e-9) for way in (ahead, before))
    heading = ahead + (ahead - before) / 2
    return heading / max(float(np.linalg.norm(heading)), 1e-9)
