"""The way along a strand of a mask to its tip, on NumPy. Points of the plane are complex numbers."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.compiled.interface import (
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
from shape_obs.compiled.numpy_curve import arc_length, catmull_rom, spread, unshrink
from shape_obs.compiled.numpy_map import settle
from shape_obs.compiled.numpy_mask import carried
from shape_obs.compiled.numpy_plane import Complex, plane, points_of


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
    places = plane(nodes)
    head = _march(mask, complex(left, top), places[:3].tolist(), width, thinnest)
    tail = _march(mask, complex(left, top), places[:-4:-1].tolist(), width, thinnest)
    curve = catmull_rom(points_of(np.concatenate([head[::-1], places, tail])))
    return curve, arc_length(curve), carried(mask, left, top, curve, 1), spread(points, weight, curve)


def _march(mask: Mask, corner: complex, start: list[complex], width: float, thinnest: float) -> list[complex]:
    """The way from the end of a chain, the first of three nodes, along its strand to the tip."""
    here, back, far = start
    step, before = here - back, back - far
    heading = _bent(step / max(abs(step), 1e-9), before / max(abs(before), 1e-9))
    path: list[complex] = []
    local, rest = np.empty(0, np.complex128), -1.0
    for _ in range(MAX_STEPS):
        local = _strand(mask, here - corner, heading, width)
        along, rest = local.real, -1.0
        if along.max(initial=0.0) > BEYOND * width:
            piece = local[(along > STEP_FROM * width) & (along <= STEP_TO * width)]
        elif (rest := _by_area(local, width)) > LAST_REST * width:
            piece = local[along > rest - LAST * width]
        else:
            break
        if not len(piece):
            break
        step = complex(piece.sum()) / len(piece) * heading
        heading = _bent(_unit(step, heading), heading)
        here += step
        path.append(here)
    if rest < 0:  # not at the tip yet
        rest = _by_area(local, width)
    return [*path, here + heading * max(rest, SHORTEST * thinnest)]


def _strand(mask: Mask, here: complex, heading: complex, width: float) -> Complex:
    """The pixels ahead that hang together with a place: how far ahead, and i times how far aside."""
    reach, aside = REACH * width + 2, SIDE * width
    u, v, hx, hy = here.real, here.imag, heading.real, heading.imag
    across, down = aside * abs(hy), aside * abs(hx)  # the box around the strip ahead, within a square about (u, v)
    left = max(int(u + max(min(hx * 2 * reach, 0.0) - across, -reach)), 0)
    top = max(int(v + max(min(hy * 2 * reach, 0.0) - down, -reach)), 0)
    right = max(int(u + min(max(hx * 2 * reach, 0.0) + across, reach)) + 2, 0)
    bottom = max(int(v + min(max(hy * 2 * reach, 0.0) + down, reach)) + 2, 0)
    crop = mask[top:bottom, left:right]
    if not crop.size:
        return np.empty(0, np.complex128)
    offset = _pixels(int(2 * reach) + 4)[: crop.shape[0], : crop.shape[1]] - (here - complex(left, top))
    local = offset * heading.conjugate()
    strand = np.abs(local.imag) <= aside
    strand &= local.real > AHEAD
    strand &= crop != 0
    count, labels = cv2.connectedComponents(strand.view(np.uint8), connectivity=8)
    if count > 2:
        offset, label = offset[strand], labels[strand]
        strand &= labels == label[np.argmin(offset.real**2 + offset.imag**2)]
    return local[strand]


@lru_cache(maxsize=16)
def _pixels(edge: int) -> Complex:
    """The pixels of a square."""
    at = np.arange(edge)
    return at + 1j * at[:, None]


def _by_area(local: Complex, width: float) -> float:
    """The length of a strand: pixels in its middle over the strip's breadth.

    Exact to a fraction of a pixel for flat caps, a twentieth of the radius short for round ones.
    """
    breadth = max(width / 4, 0.5)
    strip = local.real[np.abs(local.imag) <= breadth]
    # On a strip of one or two rows the area is off by a pixel; no rest is longer than its farthest pixel.
    return min(len(strip) / (2 * breadth), float(strip.max(initial=-0.5)) + 0.5)


def _unit(step: complex, otherwise: complex) -> complex:
    norm = abs(step)
    return step / norm if norm > 1e-9 else otherwise


def _bent(heading: complex, before: complex) -> complex:
    """The heading after a step. On a circle the tangent turns twice as far as the chord; half of that more is taken."""
    return _unit(heading + (heading - before) / 2, heading)
