"""A rope seen through a mask: a map's curve from tip to tip, its length in space, what its tips look like.

With depth, a pixel's third coordinate is its relief, the logarithm of its depth times the focal length, so that strands
that touch in the image and not in space stay apart.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import viewing_rays
from shape_obs.clustering.som import batch_epochs
from shape_obs.compiled import compiled
from shape_obs.frame import DEPTH_TYPE, DepthImages
from shape_obs.geometry.polyline import arc_length, catmull_rom, interpolate
from shape_obs.geometry.topology import undo_shrinkage
from shape_obs.image.connected_runs import gather_cells, near_mask
from shape_obs.image.rope_tip import extend_chain
from shape_obs.point_cloud.chain_length import lift_chain
from shape_obs.point_cloud.lifting import gather_lifted_cells, strand_gap
from shape_obs.tracking.occluders import HIDDEN, chain_evidence
from shape_obs.tracking.validation import sample_spread

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]

_LEAST_DEPTH: Final = 0.3  # of a curve's points: with less its length in metres is not measured
_LONG: Final = 3.0  # widths: of a shorter curve the ends have no direction of their own
_LEAST_RIM: Final = 0.5  # pixels, cut off an end that is seen at an angle


@compiled(
    "(i8[:,::1], u1[:,::1], UniTuple(i8, 2), f8[:,::1], f8[::1], f8, i8, f8, " + DEPTH_TYPE + ", f8[::1], "
    "UniTuple(i8, 4))"
)
def fit_chain_in_mask(
    runs: Indices,
    mask: Mask,
    at: tuple[int, int],
    start: Array,
    sigmas: Array,
    pull: float,
    cell: int,
    width: float,
    depth: DepthImages,
    lens: Array,
    edge: tuple[int, int, int, int],
) -> tuple[Array, Array, Flags, Array, Array, float, tuple[int, int], Array]:
    """Run the self-organising map of a chain in a mask, finish its curve and lift it into space, all in one call.

    Args:
        runs: ``(R, 3)`` of the mask; at least one.
        mask: ``(h, w)`` uint8, C-contiguous.
        at: Image column and row of its first pixel.
        start: ``(K, 2)`` nodes, pixels; ``(K, 3)`` with their relief, if there is depth.
        sigmas: Width of the map's neighbourhood in each epoch, node units.
        pull: How far averaging pulls the nodes, see ``topology.shrinkage``.
        cell: Edge of the squares in which pixels are gathered.
        width: The rope's width, pixels.
        depth: The frame's, see ``frame.depth_images``; both empty without depth or a camera.
        lens: The projection, see ``Intrinsics.lens``; ``(0,)`` without one.
        edge: Left, top, width and height of the part of the image that is searched, pixels.

    Returns:
        ``(P, 2)`` the curve from tip to tip, pixels; its arc length in the image ``(P,)``; whether it lies off the mask
        ``(P,)``; its arc length in metres and its relief, ``(P,)``, or ``(0,)`` if they are not known; the mean square
        distance of the pixels from it, in the image; what is known of both tips and what they look like, see
        ``chain_evidence``.
    """
    focal = lens[0] if len(lens) > 0 else 0.0
    if start.shape[1] == 3:
        points, weight = gather_lifted_cells(runs, cell, depth, focal, width, start)
    else:
        points, weight = gather_cells(runs, cell)
    nodes = undo_shrinkage(batch_epochs(points, weight, start, (1, len(start)), False, sigmas), pull, False)
    flat = extend_chain(_in_image(nodes), mask, at[0], at[1], width)
    lifted = catmull_rom(flat if nodes.shape[1] == 2 else _with_relief(flat, nodes), 4, False)
    curve = _in_image(lifted)
    spread = sample_spread(_in_image(points), weight, curve)
    off, on = np.empty(len(curve), np.bool_), near_mask(mask, at[0], at[1], curve, 1)
    for p in range(len(curve)):
        off[p] = not on[p]
    arc, metres, relief, z = arc_length(curve), np.empty(0), np.empty(0), np.full(len(curve), np.nan)
    if len(lens) > 0:
        expected = np.empty(len(curve) if nodes.shape[1] == 3 else 0)
        for p in range(len(expected)):
            expected[p] = math.exp(lifted[p, 2] / focal)
        rays, slack = viewing_rays(curve, lens), strand_gap(width, focal)
        along, z, share = lift_chain(curve, rays, off, depth, mask, at, width, expected, slack)
        if share >= _LEAST_DEPTH and math.isfinite(along[-1]):
            metres, relief = along, np.empty(len(curve))
            for p in range(len(curve)):
                relief[p] = focal * math.log(z[p])
    ends, shapes = chain_evidence(curve, arc, z, width, depth, mask, at, edge)
    if len(relief) > 0 and arc[-1] >= _LONG * width:
        head, tail = rims_of(curve, arc, relief, width)
        head, tail = 0.0 if ends[0] == HIDDEN else head, 0.0 if ends[1] == HIDDEN else tail
        if max(head, tail) > _LEAST_RIM:
            curve, arc, off, metres, relief = without_ends(curve, arc, off, metres, relief, head, tail)
    return curve, arc, off, metres, relief, spread, ends, shapes


@compiled
def without_ends(
    points: Array, arc: Array, flags: Flags, metres: Array, relief: Array, head: float, tail: float
) -> tuple[Array, Array, Flags, Array, Array]:
    """Return a curve without so much of both of its ends, in units of its arc length in the image.

    What is cut off is as long in metres as it is where the curve is seen least aslant, or less.

    Args:
        points: ``(P, 2)``.
        arc: ``(P,)`` its arc length.
        flags: ``(P,)``.
        metres: ``(P,)`` its arc length in space.
        relief: ``(P,)``.
        head: Off the start.
        tail: Off the end.
    """
    last, first, stop = len(arc) - 1, 1, len(arc) - 1
    while first < last and arc[first] <= head:
        first += 1
    while stop > first and arc[stop - 1] >= arc[last] - tail:
        stop -= 1
    count, least = stop - first + 2, np.inf
    at, line, kept = np.empty(count), np.empty((len(arc), 4)), np.empty(count, np.bool_)
    for p in range(len(arc)):
        line[p, 0], line[p, 1], line[p, 2], line[p, 3] = points[p, 0], points[p, 1], metres[p], relief[p]
        if p > 0:
            least = min(least, (metres[p] - metres[p - 1]) / max(arc[p] - arc[p - 1], 1e-9))
    at[0], at[count - 1], kept[0], kept[count - 1] = head, arc[last] - tail, flags[0], flags[last]
    for p in range(first, stop):
        at[p - first + 1], kept[p - first + 1] = arc[p], flags[p]
    found = interpolate(line, arc, at)
    found[0, 2] = min(head * least, found[0, 2])
    found[count - 1, 2] = max(metres[last] - tail * least, found[count - 1, 2])
    shorter, along, deep = np.empty((count, 2)), np.empty(count), np.empty(count)
    for p in range(count):
        shorter[p, 0], shorter[p, 1], deep[p] = found[p, 0], found[p, 1], found[p, 3]
        along[p] = found[p, 2] - found[0, 2]
    return shorter, arc_length(shorter), kept, along, deep


@compiled
def _in_image(points: Array) -> Array:
    """Return ``(N, 2)`` the pixels of ``(N, D)`` points."""
    flat = np.empty((len(points), 2))
    for n in range(len(points)):
        flat[n, 0], flat[n, 1] = points[n, 0], points[n, 1]
    return flat


@compiled
def _with_relief(flat: Array, nodes: Array) -> Array:
    """Return ``(K', 3)`` the nodes that were extended to the tips: beyond an end, the relief is the end's own."""
    lifted, known = np.empty((len(flat), 3)), -1
    for p in range(len(flat)):
        lifted[p, 0], lifted[p, 1] = flat[p, 0], flat[p, 1]
        same = -1
        for k in range(max(known, 0), len(nodes)):
            if nodes[k, 0] == flat[p, 0] and nodes[k, 1] == flat[p, 1]:
                same = k
                break
        if same >= 0:
            if known < 0:
                for before in range(p):
                    lifted[before, 2] = nodes[same, 2]
            known = same
        lifted[p, 2] = nodes[max(known, 0), 2]
    return lifted


@compiled
def rims_of(points: Array, arc: Array, relief: Array, width: float) -> tuple[float, float]:
    """Return how far the rims of both ends of a rope reach beyond the tips of its axis, pixels.

    The round end of a tube of width w that is k times as long in space as in the image reaches w/2 (1 - 1/k) farther.
    """
    last = len(arc) - 1
    inner, outer = last, 0
    while arc[inner] > width:
        inner -= 1
    while arc[outer] < arc[last] - width:
        outer += 1
    return _rim(points, relief, 0, inner, width), _rim(points, relief, last, outer, width)


@compiled
def _rim(points: Array, relief: Array, tip: int, inner: int, width: float) -> float:
    flat = math.hypot(points[inner, 0] - points[tip, 0], points[inner, 1] - points[tip, 1])
    return width / 2 * (1 - 1 / math.hypot(1.0, (relief[inner] - relief[tip]) / max(flat, 1e-9)))
