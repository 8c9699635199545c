"""Measure a ring: a self-organising map on the outline of a mask, and its curve in space."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.clustering.som import run_ring_som
from shape_obs.compiled import compiled
from shape_obs.frame import DepthImages
from shape_obs.geometry.outline import SAMPLED, enclosed_by, material_outline, pairs
from shape_obs.geometry.polyline import catmull_rom
from shape_obs.image.outline_tracing import trace_largest
from shape_obs.tracking.complete_lattice import Edges, Lens, rim_depth
from shape_obs.tracking.model import DepthLimits
from shape_obs.tracking.validation import ring_miss

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]

PIECES: Final = 4  # of the curve between two nodes
MIN_SAMPLES: Final = 8  # a ring of 16 pixels, as few as an object may have


@compiled("(f8[:,::1], b1, f8[::1], i8, f8)")
def fit_ring_in_mask(traced: Array, hole: bool, start: Array, count: int, sigma: float) -> tuple[Array, float]:
    """Run the self-organising map of a ring on the outline of a mask and finish its curve, all in one call.

    Args:
        traced: ``(P, 2)`` pixels, through the centres of the border pixels.
        hole: Whether the material lies outside.
        start: ``(2,)`` the first node starts at the outline's point nearest to it.
        count: How many nodes.
        sigma: Width of the neighbourhood, nodes.

    Returns:
        ``(count * 4, 2)`` the closed curve, and how far the outline misses it, in distances of its samples.
    """
    points, smooth = material_outline(traced, hole)
    samples = pairs(points)
    nodes, unit = run_ring_som(samples, smooth, start, count, sigma)
    curve = catmull_rom(nodes, PIECES, True)
    return curve, ring_miss(samples, unit, curve, PIECES) / SAMPLED


@compiled
def see_outline(
    mask: Mask, runs: Indices, pieces: int, left: int, top: int, depth: DepthImages,
    edge: Edges, camera: Lens, start: Array, count: int, sigma: float, limits: DepthLimits,
) -> tuple[Array, Array, bool, float, float, float]:  # fmt: skip
    """Fit a ring to the outline of the largest piece of a mask, and put it in space, all in one call.

    Args:
        mask: As ``trace_components`` takes it, and the next four.
        runs: Of the mask.
        pieces: How many components there are.
        left: Image column.
        top: Image row.
        depth: As ``rim_depth`` takes it, and the next.
        edge: Of what is searched.
        camera: Focal lengths and principal point of a pinhole, pixels.
        start: As ``fit_ring_in_mask`` takes it.
        count: How many nodes.
        sigma: Width of the neighbourhood, nodes.
        limits: As ``rim_depth`` takes it.

    Returns:
        ``(count * 4, 2)`` the closed curve; the same in metres, ``(0, 3)`` without depth; whether something lies over
        it; how far the outline misses it, in distances of its samples; the width, 0 for a few pixels; the area that
        the outline encloses, square pixels.
    """
    traced, width = trace_largest(mask, runs, pieces, left, top)
    if len(traced) <= SAMPLED * (MIN_SAMPLES - 1):
        return np.empty((0, 2)), np.empty((0, 3)), False, 0.0, 0.0, 0.0
    curve, miss = fit_ring_in_mask(traced, False, start, count, sigma)
    z, cut = rim_depth(depth, edge, mask, left, top, curve, width, limits)
    return curve, lifted(curve, z, camera), bool(cut.any()), miss, width, enclosed_by(traced)


@compiled
def lifted(points: Array, z: Array, camera: Lens) -> Array:
    """Return pixels ``(P, 2)`` in the space of a pinhole, ``(P, 3)``; ``(0, 3)`` without a camera or depth."""
    count = len(points) if camera[0] > 0 and not np.isnan(z[0]) else 0
    out = np.empty((count, 3))
    for p in range(count):
        out[p, 0] = (points[p, 0] - camera[2]) / camera[0] * z[p]
        out[p, 1] = (points[p, 1] - camera[3]) / camera[1] * z[p]
        out[p, 2] = z[p]
    return out
