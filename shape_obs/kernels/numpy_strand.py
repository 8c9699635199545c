"""The way along a strand of a mask to its tip, on NumPy."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.kernels.interface import (
    AHEAD,
    BEYOND,
    LAST,
    LAST_REST,
    MAX_STEPS,
    REACH,
    SHORTEST,
    SIDE,
    STEP_FROM,
    STEP_TO,
    Array,
    Mask,
)
from shape_obs.kernels.numpy_curve import arc_length, catmull_rom, spread, unshrink
from shape_obs.kernels.numpy_map import settle
from shape_obs.kernels.numpy_mask import carried


def ribbon(
    mask: Mask,
    left: int,
    top: int,
    points: Array,
    weight: Array,
    nodes: Array,
    first: Array,
    second: Array,
    share: float,
    width: float,
    thinnest: float,
) -> tuple[Array, Array, npt.NDArray[np.bool_], float]:
    """See ``Kernels.ribbon``."""
    nodes = unshrink(settle(points, weight, nodes, first, second), share, False)
    width = max(width, thinnest)
    on = np.flatnonzero(carried(mask, left, top, nodes, 1))
    if len(on) and on[-1] - on[0] >= 2:
        nodes = nodes[on[0] : on[-1] + 1]
    head = _march(mask, left, top, nodes[:3], width, thinnest)
    tail = _march(mask, left, top, nodes[:-4:-1], width, thinnest)
    curve = catmull_rom(np.concatenate([head[::-1], nodes, tail]))
    return curve, arc_length(curve), carried(mask, left, top, curve, 1), spread(points, weight, curve)


def _march(mask: Mask, left: int, top: int, start: Array, width: float, thinnest: float) -> Array:
    """The way from the end of a chain, the first of (3,2) nodes, along its strand to the tip: (S,2)."""
    (x, y), (x1, y1), (x2, y2) = start.tolist()
    near, far = _unit(x - x1, y - y1), _unit(x1 - x2, y1 - y2)
    heading = _bent(near, far)
    u, v, rest = x - left, y - top, 0.0
    path: list[tuple[float, float]] = []
    for _ in range(MAX_STEPS):
        offset, along, side = _strand(mask, u, v, heading, width)
        rest = _by_area(along, side, width)
        if along.max(initial=0.0) > BEYOND * width:
            piece = (along > STEP_FROM * width) & (along <= STEP_TO * width)
        elif rest > LAST_REST * width:
            piece = along > rest - LAST * width
        else:
            break
        held = np.count_nonzero(piece)
        if not held:
            break
        dx, dy = (offset @ piece / held).tolist()
        chord = _unit(dx, dy, heading)
        heading = _bent(chord, heading)
        u, v = u + dx, v + dy
        path.append((u + left, v + top))
    rest = max(rest, SHORTEST * thinnest)
    return np.array([*path, (u + left + heading[0] * rest, v + top + heading[1] * rest)])


def _strand(mask: Mask, u: float, v: float, heading: tuple[float, float], width: float) -> tuple[Array, Array, Array]:
    """The pixels ahead that hang together with (u, v): (2,P) offsets, (P,) how far ahead, (P,) how far aside."""
    reach, aside, (hx, hy) = REACH * width + 2, SIDE * width, heading
    across, down = aside * abs(hy), aside * abs(hx)  # the box around the strip ahead, within a square about (u, v)
    left = max(int(u + max(min(hx * 2 * reach, 0.0) - across, -reach)), 0)
    top = max(int(v + max(min(hy * 2 * reach, 0.0) - down, -reach)), 0)
    right = int(u + min(max(hx * 2 * reach, 0.0) + across, reach)) + 2
    bottom = int(v + min(max(hy * 2 * reach, 0.0) + down, reach)) + 2
    crop = mask[top : max(bottom, 0), left : max(right, 0)]
    x = np.arange(left - u, left - u + crop.shape[1] - 0.5)
    y = np.arange(top - v, top - v + crop.shape[0] - 0.5)[:, None]
    along, side = x * hx + y * hy, y * hx - x * hy
    strand = (crop != 0) & (along > AHEAD)
    strand &= np.abs(side) <= aside
    held = np.flatnonzero(strand)
    if not len(held):
        return np.zeros((2, 0)), np.zeros(0), np.zeros(0)
    offset = np.empty((2, len(held)))
    rows, columns = np.divmod(held, crop.shape[1])
    offset[0], offset[1] = x[columns], y[rows, 0]
    count, labels = cv2.connectedComponents(strand.view(np.uint8), connectivity=8)
    if count == 2:
        return offset, along.ravel()[held], side.ravel()[held]
    label = labels.ravel()[held]
    same = label == label[np.argmin(np.einsum("dp,dp->p", offset, offset))]
    return offset[:, same], along.ravel()[held[same]], side.ravel()[held[same]]


def _by_area(along: Array, side: Array, width: float) -> float:
    """The length of a strand: pixels in its middle over the strip's breadth.

    Exact to a fraction of a pixel for flat caps, a twentieth of the radius short for round ones.
    """
    breadth = max(width / 4, 0.5)
    strip = along[np.abs(side) <= breadth]
    # On a strip of one or two rows the area is off by a pixel; no rest is longer than its farthest pixel.
    return min(len(strip) / (2 * breadth), float(strip.max(initial=-0.5)) + 0.5)


def _unit(x: float, y: float, otherwise: tuple[float, float] | None = None) -> tuple[float, float]:
    norm = float(np.hypot(x, y))
    if otherwise is None:
        norm = max(norm, 1e-9)
    elif norm <= 1e-9:
        return otherwise
    return x / norm, y / norm


def _bent(heading: tuple[float, float], before: tuple[float, float]) -> tuple[float, float]:
    """The heading after a step. On a circle the tangent turns twice as far as the chord; half of that more is taken."""
    (x, y), (px, py) = heading, before
    return _unit(x + (x - px) / 2, y + (y - py) / 2, heading)
