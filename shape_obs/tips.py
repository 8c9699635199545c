"""The real ends of a rope in a cloud, past the last cluster centres; in a mask, ``Kernels.ribbon`` finds them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shape_obs.cloud import Cloud
from shape_obs.kernels.interface import LAST, LAST_REST, MAX_STEPS, SHORTEST, STEP_FROM, STEP_TO
from shape_obs.strand import ahead

Array = npt.NDArray[np.float64]


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
