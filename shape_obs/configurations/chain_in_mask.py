"""A rope seen through a mask: a map's curve from tip to tip, its length in space, what its tips look like.

With depth, a pixel's third coordinate is its relief, the logarithm of its depth times the focal length, so that strands
that touch in the image and not in space stay apart.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.clustering.som import batch_epochs
from shape_obs.compiled import compiled
from shape_obs.configurations.base import Scene
from shape_obs.frame import FARTHEST, readable_depth
from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.observed import Observed
from shape_obs.geometry.polyline import arc_length, catmull_rom
from shape_obs.geometry.topology import undo_shrinkage
from shape_obs.image.connected_runs import gather_cells, near_mask
from shape_obs.image.region import Region
from shape_obs.image.rope_tip import extend_chain
from shape_obs.point_cloud.chain_length import lift_chain, strand_gap
from shape_obs.tracking.occluders import HIDDEN, Tips, chain_evidence
from shape_obs.tracking.validation import sample_spread

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]
Moments = tuple[Array, Array]

_LEAST_DEPTH: Final = 0.3  # of a curve's points: with less its length in metres is not measured
_LONG: Final = 3.0  # widths: of a shorter curve the ends have no direction of their own
_LEAST_RIM: Final = 0.5  # pixels, cut off an end that is seen at an angle
_MOVED: Final = 0.13  # of its depth, by which a rope may come nearer or go away beyond what was predicted
_FEW: Final = 3.0  # times as many pixels as a strand behind has in a square: then it is none


@compiled(
    "(i8[:,::1], i8, Array(u2, 2, 'C', readonly=True), f8, f8, f8, f8[:,::1])",
    "(i8[:,::1], i8, Array(f4, 2, 'C', readonly=True), f8, f8, f8, f8[:,::1])",
)
def gather_lifted_cells(
    runs: Indices, edge: int, depth: npt.NDArray[Any], unit: float, focal: float, width: float, expected: Array
) -> tuple[Array, Array]:
    """Gather the pixels of ``(R, 3)`` runs into squares, those of two strands at unlike depths apart.

    Args:
        runs: Of a mask; at least one.
        edge: Of the squares, pixels.
        depth: ``(H, W)`` read-only, uint16 or float32.
        unit: Metres in a unit of depth.
        focal: Focal length, pixels.
        width: Of the rope, pixels.
        expected: ``(K, 3)`` pixels and relief where the rope should be: what lies far from all of it in depth is not
            the rope's, and a square without depth takes the relief of the nearest of them.

    Returns:
        ``(M, 3)`` centroids, pixels and relief; ``(M,)`` counts.
    """
    low, high = np.inf, -np.inf
    for k in range(len(expected)):
        low, high = min(low, expected[k, 2]), max(high, expected[k, 2])
    low, high = math.exp(low / focal - _MOVED), min(math.exp(high / focal + _MOVED), FARTHEST)
    left, right, most = runs[0, 1], runs[0, 2], 0
    for at in range(len(runs)):
        left, right = min(left, runs[at, 1]), max(right, runs[at, 2])
        most += (runs[at, 2] - runs[at, 1]) // edge + 2
    top, left = runs[0, 0] // edge, left // edge
    across = (right - 1) // edge - left + 1
    places = np.full((runs[-1, 0] // edge - top + 1) * across, -1, np.int32)
    # Of each square: pixels, sums of columns and rows, pixels with depth, sum of their depth, the least and the most.
    sums, held, behind, apart = np.empty((2 * most, 7)), 0, math.exp(strand_gap(width, focal)), False
    for at in range(len(runs)):
        row, column, base = runs[at, 0], runs[at, 1], (runs[at, 0] // edge - top) * across - left
        cell = column // edge
        while column < runs[at, 2]:
            into, stop = places[base + cell], min((cell + 1) * edge, runs[at, 2])
            if into < 0:
                _clear(sums[held])
                places[base + cell] = into = held
                held += 1
            near, far, known, total = sums[into, 5], sums[into, 6], 0.0, 0.0
            for k in range(column, stop):
                metres = depth[row, k] * unit
                if low < metres < high:
                    near, far, known, total = min(near, metres), max(far, metres), known + 1, total + metres
            sums[into, 5], sums[into, 6], apart = near, far, apart or far > behind * near
            _add(sums[into], row, column, stop, known, total)
            column, cell = stop, cell + 1
    if apart:
        held = _part_strands(runs, edge, depth, unit, (low, high), behind, top, left, across, places, sums, held)
    points, weight, at = np.empty((held, 3)), np.empty(held), 0
    for into in range(held):
        count = sums[into, 0]
        if count == 0:
            continue
        u, v = sums[into, 1] / count, sums[into, 2] / count
        points[at, 0], points[at, 1], weight[at] = u, v, count
        if sums[into, 3] > 0:
            points[at, 2] = focal * math.log(sums[into, 4] / sums[into, 3])
        else:
            points[at, 2] = expected[_nearest_in_image(u, v, expected), 2]
        at += 1
    return points[:at], weight[:at]


@compiled
def _clear(sums: Array) -> None:
    for k in range(7):
        sums[k] = 0.0
    sums[5] = np.inf


@compiled
def _add(sums: Array, row: int, start: int, stop: int, known: float, metres: float) -> None:
    """Add pixels of one row to a square's sums, and the depth of those where it is known."""
    count = float(stop - start)
    sums[0], sums[1], sums[2] = sums[0] + count, sums[1] + count * (start + stop - 1) / 2, sums[2] + count * row
    sums[3], sums[4] = sums[3] + known, sums[4] + metres


@compiled
def _part_strands(
    runs: Indices, edge: int, depth: npt.NDArray[Any], unit: float, limits: tuple[float, float], behind: float,
    top: int, left: int, across: int, places: npt.NDArray[np.int32], sums: Array, held: int,
) -> int:  # fmt: skip
    """Give the strand behind another in a square sums of its own; return how many there are then."""
    count, other = held, np.full(held, -1, np.int64)
    for into in range(held):
        if sums[into, 6] > behind * sums[into, 5]:
            near = sums[into, 5]
            other[into] = count
            _clear(sums[count])
            _clear(sums[into])
            sums[into, 5], count = near, count + 1
    for at in range(len(runs)):
        row, base = runs[at, 0], (runs[at, 0] // edge - top) * across - left
        for column in range(runs[at, 1], runs[at, 2]):
            into = places[base + column // edge]
            if other[into] >= 0:
                metres = depth[row, column] * unit
                known = limits[0] < metres < limits[1]
                far = known and metres > behind * sums[into, 5]
                _add(
                    sums[other[into] if far else into], row, column, column + 1, 1.0 if known else 0.0,
                    metres if known else 0.0,
                )  # fmt: skip
    for into in range(held):
        if other[into] >= 0 and _FEW * sums[other[into], 0] < sums[into, 0]:  # the table next to the rope
            for k in range(3):
                sums[into, k] += sums[other[into], k]
                sums[other[into], k] = 0.0
    return count


@compiled
def _nearest_in_image(u: float, v: float, nodes: Array) -> int:
    """Return which of ``(K, 3)`` nodes lies nearest to a pixel in the image."""
    best, least = 0, np.inf
    for k in range(len(nodes)):
        square = (nodes[k, 0] - u) ** 2 + (nodes[k, 1] - v) ** 2
        if square < least:
            best, least = k, square
    return best


@compiled(
    "(f8[:,::1], f8[::1], f8[:,::1], Tuple((f8[:,:,:,::1], f8[:,:,:,:,::1])), f8, u1[:,::1], UniTuple(i8, 2), f8)"
)
def fit_chain_in_mask(
    points: Array,
    weight: Array,
    start: Array,
    moments: Moments,
    pull: float,
    mask: Mask,
    at: tuple[int, int],
    width: float,
) -> tuple[Array, Array, npt.NDArray[np.bool_], float]:
    """Run the self-organising map of a chain in a mask and finish its curve, all in one call.

    Args:
        points: ``(M, D)`` pixels, gathered; D = 3 with their relief.
        weight: ``(M,)`` how many each stands for.
        start: ``(K, D)`` nodes.
        moments: Of the neighbourhood, see ``topology.Neighbourhoods``.
        pull: How far averaging pulls the nodes, see ``topology.shrinkage``.
        mask: ``(h, w)`` uint8, C-contiguous.
        at: Image column and row of its first pixel.
        width: The rope's width, pixels.

    Returns:
        ``(P, D)`` the curve from tip to tip; its arc length in the image ``(P,)``, pixels; whether the mask has a pixel
        there ``(P,)``; the mean square distance of the pixels from it, in the image.
    """
    left, top = at
    nodes = undo_shrinkage(batch_epochs(points, weight, start, moments[0], moments[1]), pull, False)
    flat = extend_chain(_in_image(nodes), mask, left, top, width)
    curve = catmull_rom(flat if nodes.shape[1] == 2 else _with_relief(flat, nodes), 4, False)
    drawn = _in_image(curve)
    on_object = near_mask(mask, left, top, drawn, 1)
    return curve, arc_length(drawn), on_object, sample_spread(_in_image(points), weight, drawn)


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


def lifted_samples(
    region: Region, start: Array, cell: int, width: float, scene: Scene
) -> tuple[Array, tuple[Array, Array]]:
    """Return the nodes to start from and a mask's samples, with their relief where it is known of both."""
    if start.shape[1] == 2 or scene.depth is None or scene.intrinsics is None:
        return np.ascontiguousarray(start[:, :2]), gather_cells(region.runs, cell)
    readable, focal = readable_depth(scene.depth), scene.intrinsics.fx
    return start, gather_lifted_cells(region.runs, cell, *readable, focal, width, start)


def measured_curve(curve: FittedCurve, observed: Observed, width: float, scene: Scene) -> tuple[FittedCurve, Tips]:
    """Return a curve with its length in metres where there is depth, and what its two tips look like."""
    if not isinstance(observed, Region) or scene.edge is None:
        return curve, Tips()
    (depth, unit), z, expected = readable_depth(scene.depth), np.full(len(curve.points), np.nan), np.zeros(0)
    at, left_out = observed.window[:2], curve.interpolated
    if scene.intrinsics is not None:
        rays = np.ascontiguousarray(scene.intrinsics.rays(curve.points)[:, :2])
        if curve.relief is not None:
            expected = np.exp(curve.relief / scene.intrinsics.fx)
        slack = strand_gap(width, scene.intrinsics.fx)
        lifted = lift_chain(curve.points, rays, left_out, depth, unit, observed.mask, at, width, expected, slack)
        metres, z, share = lifted
        if share >= _LEAST_DEPTH and np.isfinite(metres).all():
            curve = replace(curve, metres=metres, relief=scene.intrinsics.fx * np.log(z))
    left, top, wide, high = scene.edge
    seen = depth, unit, observed.mask, at, (left, top, wide, high)
    tips = Tips(*chain_evidence(curve.points, curve.arc, z, width, *seen), width)
    return _without_rims(curve, tips.known, width), tips


def _without_rims(curve: FittedCurve, ends: tuple[int, int], width: float) -> FittedCurve:
    """Return a curve that ends at the tips of the rope's axis: of a steep rope, the rim of its end lies beyond it.

    The round end of a tube of width w that is k times as long in space as in the image reaches w/2 (1 - 1/k) farther.
    """
    if curve.relief is None or curve.size < _LONG * width:
        return curve
    rims = rims_of(curve.points, curve.arc, curve.relief, width)
    head, tail = (0.0 if known == HIDDEN else rim for rim, known in zip(rims, ends, strict=True))
    return curve.trimmed(head, tail) if max(head, tail) > _LEAST_RIM else curve


@compiled("(f8[:,::1], f8[::1], f8[::1], f8)")
def rims_of(points: Array, arc: Array, relief: Array, width: float) -> tuple[float, float]:
    """Return how far the rims of both ends of a rope reach beyond the tips of its axis, pixels."""
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
