"""A rope seen through a mask: a map's curve from tip to tip, its length in space, what its tips look like.

With depth, a pixel's third coordinate is its log-depth, the logarithm of its depth times the focal length, so that
strands that touch in the image and not in space stay apart.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import stereo_noise, viewing_rays
from shape_obs.clustering.som import batch_epochs, best_matching_units
from shape_obs.compiled import compiled
from shape_obs.frame import DepthImages
from shape_obs.geometry.curve import first_coordinates, with_log_depth
from shape_obs.geometry.polyline import arc_length, catmull_rom, even_points, nearest_piece
from shape_obs.geometry.topology import pull_of, undo_shrinkage
from shape_obs.image.connected_runs import gather_cells, near_mask
from shape_obs.image.rope_tip import extend_chain, rims_of, without_ends
from shape_obs.point_cloud.chain_length import lift_chain
from shape_obs.point_cloud.strands import gather_lifted_cells, strand_gap
from shape_obs.tracking.occluders import HIDDEN, chain_evidence, open_gaps
from shape_obs.tracking.validation import sample_spread

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]
#: What ``fit_chain_in_mask`` returns.
Measured = tuple[Array, Array, Flags, Array, Array, float, float, tuple[int, int], Array]

_PROBES: Final = 32  # along a curve, at which it is looked whether it runs back along itself
_APART: Final = 3  # of them: pieces that are closer along a curve are not two strands


@compiled
def fit_chain_in_mask(
    runs: Indices,
    mask: Mask,
    at: tuple[int, int],
    start: Array,
    log_depth: Array,
    sigmas: Array,
    cell: int,
    width: float,
    depth: DepthImages,
    lens: Array,
    edge: tuple[int, int, int, int],
    model: Any,
) -> Measured:
    """Run the self-organising map of a chain in a mask, finish its curve and lift it into space, all in one call.

    Args:
        runs: ``(R, 3)`` of the mask; at least one.
        mask: ``(h, w)`` uint8, C-contiguous.
        at: Image column and row of its first pixel.
        start: ``(K, 2)`` nodes, pixels.
        log_depth: ``(K,)`` their log_depth, if there is depth; ``(0,)`` if it is not known.
        sigmas: Width of the map's neighbourhood in each epoch, node units.
        cell: Edge of the squares in which pixels are gathered.
        width: The rope's width, pixels.
        depth: The frame's, see ``frame.depth_images``; both empty without depth or a camera.
        lens: The projection, see ``Intrinsics.lens``; ``(0,)`` without one.
        edge: Left, top, width and height of the part of the image that is searched, pixels.
        model: The constants, one ``ChainModel``.

    Returns:
        ``(P, 2)`` the curve from tip to tip, pixels; its arc length in the image ``(P,)``; whether it lies off the mask
        ``(P,)``; its arc length in metres and its log-depth, ``(P,)``, or ``(0,)`` if they are not known; the mean
        square distance of the pixels from it, in the image; the share of it that cannot be the rope: it bridges a gap
        from an end that is free, or runs back along itself; what is known of both tips and what they look like, see
        ``chain_evidence``.
    """
    focal = lens[0] if len(lens) > 0 else 0.0
    if len(log_depth) > 0:
        start = with_log_depth(start, log_depth)
        points, weight = gather_lifted_cells(runs, cell, depth, focal, width, start)
    else:
        points, weight = gather_cells(runs, cell)
    line = 1, len(start)
    nodes = start
    if len(log_depth) > 0:
        nodes, sigmas = batch_epochs(points, weight, start, line, False, sigmas[:1]), sigmas[1:]
        _level_rims(points, nodes, model.off_axis * width)
    nodes = batch_epochs(points, weight, nodes, line, False, sigmas)
    nodes = undo_shrinkage(nodes, pull_of(sigmas[-1]), False)
    flat = extend_chain(first_coordinates(nodes, 2), mask, at[0], at[1], width)
    lifted = catmull_rom(flat if nodes.shape[1] == 2 else _with_log_depth(flat, nodes), 4, False)
    curve = first_coordinates(lifted, 2)
    spread = sample_spread(first_coordinates(points, 2), weight, curve) + min(cell, width) ** 2 / 12
    off, on = np.empty(len(curve), np.bool_), near_mask(mask, at[0], at[1], curve, 1)
    for p in range(len(curve)):
        off[p] = not on[p]
    arc, metres, deep, z = arc_length(curve), np.empty(0), np.empty(0), np.full(len(curve), np.nan)
    if len(lens) > 0:
        expected = np.empty(len(curve) if nodes.shape[1] == 3 else 0)
        for p in range(len(expected)):
            expected[p] = math.exp(lifted[p, 2] / focal)
        rays, slack = viewing_rays(curve, lens), strand_gap(width, focal)
        along, z, share = lift_chain(curve, rays, off, depth, mask, at, width, expected, slack)
        if share >= model.least_depth and math.isfinite(along[-1]):
            metres, deep = along, np.empty(len(curve))
            for p in range(len(curve)):
                deep[p] = focal * math.log(z[p])
    columns = max(depth[0].shape[1], depth[1].shape[1])
    noise = stereo_noise(focal, columns) if focal > 0 and columns > 0 else 0.0
    spurious = open_gaps(curve, arc, off, z, width, depth, noise, mask, at, edge, model)
    strand = with_log_depth(curve, deep) if len(deep) > 0 else curve
    spurious += _doubled_share(even_points(strand, arc, _PROBES, False), width / 2)
    ends, shapes = chain_evidence(curve, arc, z, width, depth, noise, mask, at, edge, model)
    if len(deep) > 0:
        head, tail = rims_of(curve, arc, deep, width)
        head, tail = 0.0 if ends[0] == HIDDEN else head, 0.0 if ends[1] == HIDDEN else tail
        if max(head, tail) > model.least_overhang:
            curve, arc, off, metres, deep = without_ends(curve, arc, off, metres, deep, head, tail)
    return curve, arc, off, metres, deep, spread, spurious, ends, shapes


@compiled
def _doubled_share(probes: Array, near: float) -> float:
    """Return the share of a curve that turns round and runs back along itself, where strands would lie side by side.

    Args:
        probes: ``(P, D)`` at equal steps along the curve.
        near: Strands that lie side by side are farther from each other.
    """
    count, last, turns = 0, len(probes) - 1, False
    for n in range(_APART, last + 1 - _APART):
        turns |= _along(probes, n - _APART, n, n, n + _APART) < 0
    for n in range(1, last if turns else 0):
        before, earlier, _ = nearest_piece(probes, probes[n], 0, max(n - _APART, 0))
        after, later, _ = nearest_piece(probes, probes[n], min(n + _APART - 1, last), last)
        piece = earlier if before < after else later
        count += min(before, after) <= near**2 and _along(probes, n - 1, n + 1, piece, piece + 1) < 0
    return count / (last - 1)


@compiled
def _along(points: Array, a: int, b: int, c: int, d: int) -> float:
    """Return the scalar product of two chords of a polyline: from point ``a`` to ``b``, and from ``c`` to ``d``."""
    product = 0.0
    for k in range(points.shape[1]):
        product += (points[b, k] - points[a, k]) * (points[d, k] - points[c, k])
    return product


@compiled
def _level_rims(points: Array, nodes: Array, least: float) -> None:
    """Give each sample that lies off a rope's axis the log-depth that the axis has next to it in the image.

    At its rims a rope's depth is mixed with that of what lies behind it. A few such samples are far from all others,
    and a map of a narrow neighbourhood sends a node to them: it folds.

    Args:
        points: ``(M, 3)`` pixels and log-depth; the log-depth is changed in place.
        nodes: ``(K, 3)`` along the axis.
        least: How far off the axis such a sample lies, pixels.
    """
    unit, last = best_matching_units(points, nodes), len(nodes) - 1
    for m in range(len(points)):
        k, nearest = int(unit[m]), 0.0
        for d in range(3):
            nearest += (points[m, d] - nodes[k, d]) ** 2
        if nearest <= least**2:
            continue
        for i in range(max(k - 1, 0), min(k + 1, last)):
            nearest = min(nearest, _off_segment(points[m], nodes[i], nodes[i + 1], 3)[0])
        if nearest <= least**2:
            continue
        nearest = np.inf
        for i in range(max(k - 2, 0), min(k + 2, last)):
            square, t = _off_segment(points[m], nodes[i], nodes[i + 1], 2)
            if square < nearest:
                nearest, points[m, 2] = square, nodes[i, 2] + t * (nodes[i + 1, 2] - nodes[i, 2])


@compiled
def _off_segment(point: Array, start: Array, stop: Array, size: int) -> tuple[float, float]:
    """Return the squared distance of a point from a segment, and where on it, 0...1, by their first coordinates."""
    along = square = off = 0.0
    for d in range(size):
        along += (point[d] - start[d]) * (stop[d] - start[d])
        square += (stop[d] - start[d]) ** 2
    t = min(max(along / max(square, 1e-9), 0.0), 1.0)
    for d in range(size):
        off += (point[d] - start[d] - t * (stop[d] - start[d])) ** 2
    return off, t


@compiled
def _with_log_depth(flat: Array, nodes: Array) -> Array:
    """Return ``(K', 3)`` the nodes that were extended to the tips: beyond an end, the log-depth is the end's own."""
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
