"""Measure a ring: a self-organising map on the outline of a mask or a cloud, and its curve in space."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.clustering.som import batch_epochs, run_ring_som
from shape_obs.compiled import compiled
from shape_obs.geometry.outline import SAMPLED, enclosed_by, pairs
from shape_obs.geometry.polyline import arc_length, catmull_rom, closed, even_around, nearest_vertex
from shape_obs.geometry.topology import pull_of, undo_shrinkage
from shape_obs.image.outline_tracing import trace_components, trace_hole
from shape_obs.tracking.validation import ring_miss

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]

MIN_SAMPLES: Final = 8  # a ring of 16 pixels, as few as an object may have
_PIECES: Final = 4  # of the curve between two nodes
_NODES: Final = (24, 192)  # at least and at most, for any number of points


@compiled
def trace_border(mask: Mask, runs: Indices, pieces: int, left: int, top: int, hole: int) -> tuple[Array, float, float]:
    """Return the outline of the largest component of a mask or of a hole of it, and what the component looks like.

    Args:
        mask: As ``trace_components`` takes it, and the next four.
        runs: Of the mask.
        pieces: How many components there are.
        left: Image column.
        top: Image row.
        hole: Which hole, the largest first; -1 for the outer outline.

    Returns:
        ``(P, 2)`` pixels through the centres of the border pixels, ``(0, 2)`` without such a hole; the component's
        width, pixels; the share of what its outer outline encloses that is not the component's own.
    """
    outlines, stops, areas, widths, holes = trace_components(mask, runs, pieces, left, top)
    piece = int(np.argmax(areas))
    outer = outlines[stops[piece - 1] if piece > 0 else 0 : stops[piece]]
    hollow = 1 - areas[piece] / max(enclosed_by(outer), 1.0)
    if hole < 0:
        return outer, widths[piece], hollow
    at, most = -1, np.inf
    for _ in range(hole + 1):
        before, at = at, -1
        for h in range(len(holes)):
            later = holes[h, 5] < most or (holes[h, 5] == most and h > before)
            if holes[h, 0] == piece and later and (at < 0 or holes[h, 5] > holes[at, 5]):
                at = h
        if at < 0:
            return outer[:0], widths[piece], hollow
        most = holes[at, 5]
    return trace_hole(mask, int(holes[at, 1]), int(holes[at, 2]), left, top), widths[piece], hollow


@compiled("(f8, f8)")
def nodes_around(length: float, spacing: float) -> int:
    """Return how many nodes an outline gets that are to be so far apart: 24 to 192."""
    return int(min(max(np.rint(length / spacing), _NODES[0]), _NODES[1]))


@compiled
def fit_ring_in_mask(points: Array, smooth: Array, start: Array, count: int, sigma: float) -> tuple[Array, float]:
    """Run the self-organising map of a ring on the outline of a mask, and finish its curve.

    Args:
        points: ``(P, 2)`` pixels, where the material ends.
        smooth: ``(P, 2)`` the same without the staircase of pixels.
        start: ``(2,)`` the first node starts at the outline's point nearest to it.
        count: How many nodes.
        sigma: Width of the neighbourhood, nodes.

    Returns:
        ``(count * 4, 2)`` the closed curve, and how far the outline misses it, in distances of its samples.
    """
    samples = pairs(points)
    curve = catmull_rom(run_ring_som(samples, smooth, start, count, sigma), _PIECES, True)
    return curve, ring_miss(samples, curve) / SAMPLED


@compiled("(f8[:,::1], f8[::1], f8, f8[:,::1], f8[::1], i8, f8)")
def fit_ring_in_cloud(
    points: Array, weight: Array, scale: float, outline: Array, start: Array, count: int, sigma: float
) -> tuple[Array, float]:
    """Run the self-organising map of a ring on the outline of a cloud, and finish its curve.

    Args:
        points: ``(M, 3)`` samples of the outline, metres.
        weight: ``(M,)`` how much each counts.
        scale: Their distance.
        outline: ``(P, 3)`` the outline itself.
        start: ``(3,)`` the first node starts at the outline's point nearest to it.
        count: How many nodes.
        sigma: Width of the neighbourhood, nodes.

    Returns:
        ``(count * 4, 3)`` the closed curve, and how far the samples miss it, in their distances.
    """
    around = closed(outline)
    arc = arc_length(around)
    nodes = even_around(around, arc, arc[nearest_vertex(outline, start)], count)
    nodes = batch_epochs(points, weight, nodes, (1, count), True, np.full(1, sigma))
    nodes = undo_shrinkage(nodes, pull_of(sigma), True)
    curve = catmull_rom(nodes, _PIECES, True)
    return curve, ring_miss(points, curve) / scale
