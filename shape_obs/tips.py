"""The real ends of a ribbon, past the last cluster centres."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.region import Region

Array = npt.NDArray[np.float64]

_MAX_STEPS: Final = 24
# In widths: how far to the side a pixel may lie to belong to this strand, and the slice ahead that a step
# moves to the centre of.
_SIDE: Final = 0.75
_STEP: Final = (0.2, 0.6)
# In widths: the length of the last piece, and the rest below which there is none. In pixels: the shortest rest.
_LAST: Final = (0.6, 0.5)
_SHORTEST: Final = 0.25
# Pixels: a thinner rope is looked at as if it were this wide, or the slices above would hold no pixel.
_THINNEST: Final = 3.0


def extend_to_tips(nodes: Array, region: Region, width: float) -> Array:
    """Cut a chain of cluster centres where it hangs over the mask, and lengthen it to the ribbon's tips.

    Args:
        nodes: (K,2) pixels, K >= 3.
        region: The mask.
        width: The ribbon's width, pixels.

    Returns:
        (K',2) pixels; the first and last points lie on the tips.
    """
    width = max(width, _THINNEST)
    nodes = _without_overhang(nodes, region)
    head = _extension(nodes[0], _heading(nodes[:3]), region, width)
    tail = _extension(nodes[-1], _heading(nodes[:-4:-1]), region, width)
    return np.concatenate([head[::-1], nodes, tail])


def _without_overhang(nodes: Array, region: Region) -> Array:
    """The nodes from the first to the last on the mask: a prediction that overshoots leaves empty ones past the end."""
    on = np.flatnonzero(region.contains(nodes, reach=1))
    return nodes[on[0] : on[-1] + 1] if len(on) and on[-1] - on[0] >= 2 else nodes


def _heading(nodes: Array) -> Array:
    """Direction out of the first of three nodes, their curvature continued."""
    near, far = nodes[0] - nodes[1], nodes[1] - nodes[2]
    near, far = near / max(np.linalg.norm(near), 1e-9), far / max(np.linalg.norm(far), 1e-9)
    return _unit(near + (near - far) / 2, near)


def _extension(node: Array, heading: Array, region: Region, width: float) -> Array:
    """March along the strand while it goes on, then step to the middle of its last piece and measure the rest."""
    front, rest = node, 0.0
    path: list[Array] = []
    for _ in range(_MAX_STEPS):
        offset, along, side = _strand_ahead(region, front, heading, width)
        rest = _rest(along, side, width)
        if np.any(along > _STEP[1] * width):
            ahead = (along > _STEP[0] * width) & (along <= _STEP[1] * width)
        elif rest > _LAST[1] * width:
            ahead = along > rest - _LAST[0] * width
        else:
            break
        if not ahead.any():
            break
        step = offset[ahead].mean(axis=0)
        heading = _continue(heading, step)
        front = front + step
        path.append(front)
    return np.array([*path, front + heading * max(rest, _SHORTEST)])


def _rest(along: Array, side: Array, width: float) -> float:
    """What lies ahead, by area: pixels in the strand's middle over the strip's breadth.

    Exact to a fraction of a pixel for flat caps, a twentieth of the radius short for round ones.
    """
    breadth = max(width / 4, 0.5)
    strip = along[(along > 0) & (np.abs(side) <= breadth)]
    # On a strip of one or two rows the area is off by a pixel; no rest is longer than its farthest pixel.
    return min(len(strip) / (2 * breadth), float(strip.max(initial=0.0)) + 0.5)


def _continue(heading: Array, step: Array) -> Array:
    """The heading after a step. On a circle the tangent turns twice as far as the chord; half of that more is taken."""
    chord = _unit(step, heading)
    return _unit(chord + (chord - heading) / 2, chord)


def _strand_ahead(region: Region, front: Array, heading: Array, width: float) -> tuple[Array, Array, Array]:
    """Mask pixels ahead of ``front`` that hang together with it: offsets (P,2), along and beside the heading (P,)."""
    reach = 1.5 * width + 2
    u, v = front[0] - region.window.left, front[1] - region.window.top
    left, top = max(int(u - reach), 0), max(int(v - reach), 0)
    crop = region.mask[top : int(v + reach) + 2, left : int(u + reach) + 2]
    x = np.arange(crop.shape[1]) + (left - u)
    y = np.arange(crop.shape[0])[:, None] + (top - v)
    along, side = x * heading[0] + y * heading[1], y * heading[0] - x * heading[1]
    strand = (crop > 0) & (along > 0) & (np.abs(side) <= _SIDE * width)
    if not strand.any():
        return np.zeros((0, 2)), np.zeros(0), np.zeros(0)
    labels = cv2.connectedComponents(strand.view(np.uint8), connectivity=8)[1]
    nearest = np.argmin(np.where(strand, x * x + y * y, np.inf))
    rows, columns = np.nonzero(labels == labels.flat[nearest])
    return np.stack([x[columns], y[rows, 0]], axis=1), along[rows, columns], side[rows, columns]


def _unit(vector: Array, otherwise: Array) -> Array:
    norm = float(np.linalg.norm(vector))
    return vector / norm if norm > 1e-9 else otherwise
