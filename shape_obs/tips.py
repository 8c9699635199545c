"""The real ends of a ribbon or a rope, past the last cluster centres."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.body import Body
from shape_obs.strand import ahead

Array = npt.NDArray[np.float64]

_MAX_STEPS: Final = 24
# In widths: the slice ahead that a step moves to the centre of.
_STEP: Final = (0.2, 0.6)
# In widths: the length of the last piece, and the rest below which there is none.
_LAST: Final = (0.6, 0.5)
# A rope thinner than the body's thinnest is looked at as if it were that wide, or the slices above would hold nothing.
# Of that width: the shortest rest.
_SHORTEST: Final = 1 / 12


def extend_to_tips(nodes: Array, body: Body, width: float) -> Array:
    """Cut a chain of cluster centres where it hangs over the body, and lengthen it to the tips.

    Args:
        nodes: (K,D) pixels or metres, K >= 3.
        body: What they were fitted to.
        width: The ribbon's width, in the same unit.

    Returns:
        (K',D); the first and last points lie on the tips.
    """
    width = max(width, body.thinnest)
    nodes = _without_overhang(nodes, body)
    head = _extension(nodes[0], _heading(nodes[:3]), body, width)
    tail = _extension(nodes[-1], _heading(nodes[:-4:-1]), body, width)
    return np.concatenate([head[::-1], nodes, tail])


def _without_overhang(nodes: Array, body: Body) -> Array:
    """The nodes from the first to the last on the body: a prediction that overshoots leaves empty ones past the end."""
    on = np.flatnonzero(body.carries(nodes))
    return nodes[on[0] : on[-1] + 1] if len(on) and on[-1] - on[0] >= 2 else nodes


def _heading(nodes: Array) -> Array:
    """Direction out of the first of three nodes, their curvature continued."""
    near, far = nodes[0] - nodes[1], nodes[1] - nodes[2]
    near, far = near / max(np.linalg.norm(near), 1e-9), far / max(np.linalg.norm(far), 1e-9)
    return _unit(near + (near - far) / 2, near)


def _extension(node: Array, heading: Array, body: Body, width: float) -> Array:
    """March along the strand while it goes on, then step to the middle of its last piece and measure the rest."""
    front, rest = node, 0.0
    path: list[Array] = []
    for _ in range(_MAX_STEPS):
        offset, along, rest, goes_on = ahead(body, front, heading, width)
        if goes_on:
            piece = (along > _STEP[0] * width) & (along <= _STEP[1] * width)
        elif rest > _LAST[1] * width:
            piece = along > rest - _LAST[0] * width
        else:
            break
        if not piece.any():
            break
        step = offset[piece].mean(axis=0)
        heading = _continue(heading, step)
        front = front + step
        path.append(front)
    return np.array([*path, front + heading * max(rest, _SHORTEST * body.thinnest)])


def _continue(heading: Array, step: Array) -> Array:
    """The heading after a step. On a circle the tangent turns twice as far as the chord; half of that more is taken."""
    chord = _unit(step, heading)
    return _unit(chord + (chord - heading) / 2, chord)


def _unit(vector: Array, otherwise: Array) -> Array:
    norm = float(np.linalg.norm(vector))
    return vector / norm if norm > 1e-9 else otherwise
