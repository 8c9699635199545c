"""Measure a sheet: its border in space, and the lattice between four corners of its outline."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import deprojected
from shape_obs.clustering.som import batch_epochs
from shape_obs.compiled import compiled
from shape_obs.frame import DepthImages
from shape_obs.geometry.coons import AROUND, FINE, TURN_REACH, coons_patch, corners_of
from shape_obs.geometry.lattice import assess_lattice, lattice_gauges, sample_lattice, transposed
from shape_obs.geometry.polyline import arc_length, closed, even_around, interpolate
from shape_obs.geometry.topology import pull_of, undo_lattice_shrinkage
from shape_obs.initialization.corners import best_corners, nearest_corners, sheet_outline
from shape_obs.tracking.complete_lattice import outline_depth
from shape_obs.tracking.register_lattice import match_corners

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]
Vector = tuple[float, float, float]

UNBENT: Final = (90.0, 0.0, 0.0, 0.0)  # what ``assess_lattice`` returns of a rectangle
CELL: Final = 8  # pixels: the edge of the cells of a mask that the map of a sheet's inside is given
_MAP: Final = 8, 8  # its rows and columns
_SIGMA: Final = 0.5  # nodes: width of its neighbourhood


@compiled
def find_corners(outline: Any, seen: Array, nodes: Array, best: bool) -> Indices:
    """Return ``(4,)`` the points of an outline that are the corners of a sheet; ``(0,)`` if there are no four in order.

    Args:
        outline: A ``SheetOutline``.
        seen: ``(400, D)`` its points where corners are predicted.
        nodes: ``(625, D)`` predicted; ``(0, D)`` without a track.
        best: Whether the corners are those most like a sheet's, not those nearest to the predicted ones.
    """
    if best:
        return best_corners(outline)
    return nearest_corners(seen, outline.candidates, outline.step, corners_of(nodes))


@compiled
def numbered_corners(outline: Any, nodes: Array, best: bool) -> tuple[Indices, int, float]:
    """Return the corners of a sheet in an image as they are predicted, see ``find_corners``, ``(4,)`` or ``(0,)``.

    And which of them is farthest from where the others put it, and how far, see ``match_corners``.
    """
    corners, number, moved, places = find_corners(outline, outline.points, nodes, best), 0, 0.0, np.empty((4, 2))
    if len(corners) > 0 and len(nodes) > 0:
        found = corners.copy()
        for k in range(4):
            places[k, 0], places[k, 1] = outline.points[found[k], 0], outline.points[found[k], 1]
        quarters, number, moved = match_corners(corners_of(nodes), places)
        for k in range(4):
            corners[k] = found[(k + quarters) % 4]
    return corners, number, moved


@compiled("(f8[:,::1], f8[:,::1], f8[:,::1], b1)")
def patch_in_cloud(
    outline: Array, flat: Array, nodes: Array, best: bool
) -> tuple[Array, float, tuple[float, float, float, float]]:
    """Return what ``coons_patch`` does over a sheet in a cloud, unrolled, and the measures of ``assess_lattice``.

    Args:
        outline: ``(P, 3)`` metres, clockwise as seen.
        flat: ``(P, 2)`` the same unrolled into a plane.
        nodes: As ``find_corners`` takes it, and the next.
        best: See there.
    """
    unrolled = sheet_outline(flat)
    space = even_around(closed(outline), arc_length(closed(flat)), 0.0, AROUND)
    corners = find_corners(unrolled, space, nodes, best)
    if len(corners) == 0:
        return unrolled.points[:0], 0.0, UNBENT
    patch, kink = coons_patch(unrolled, unrolled.points, corners)
    return patch, kink, assess_lattice(patch.reshape(FINE, FINE, 2))


@compiled("(f8[:,::1], f8[:,::1], f8[::1], i8)")
def even_inside(lattice: Array, points: Array, weight: Array, epochs: int) -> Array:
    """Return a lattice ``(625, D)`` whose inside a self-organising map has evened out; its border stays.

    Args:
        lattice: ``(625, D)``.
        points: ``(M, D)`` samples of the sheet.
        weight: ``(M,)`` how much each counts.
        epochs: Of the map.
    """
    size, (high, wide), at = lattice.shape[1], _MAP, np.arange(FINE).astype(np.float64)
    fine = lattice.reshape(FINE, FINE, size)
    down, right = lattice_gauges(fine)
    start = sample_lattice(fine, down, right, high, wide, True)
    nodes = batch_epochs(points, weight, start, _MAP, False, np.full(epochs, _SIGMA))
    nodes = undo_lattice_shrinkage(nodes.reshape(high, wide, size), pull_of(_SIGMA))
    moved = np.zeros((high + 2, wide + 2, size))  # nothing at the border
    for row in range(high):
        for col in range(wide):
            for d in range(size):
                moved[row + 1, col + 1, d] = nodes[row, col, d] - start[row * wide + col, d]
    rows = interpolate(moved.reshape(high + 2, (wide + 2) * size), _knots(down, high), at)
    cols = transposed(rows.reshape(FINE, wide + 2, size)).reshape(wide + 2, FINE * size)
    found = transposed(interpolate(cols, _knots(right, wide), at).reshape(FINE, FINE, size))
    return lattice + found.reshape(FINE * FINE, size)


@compiled
def _knots(gauge: Array, count: int) -> Array:
    """Return ``(count + 2,)`` where the nodes of a map lie between the rows, or columns, of a lattice, and its ends."""
    middles, out = (np.arange(count) + 0.5) / count * gauge[-1], np.empty(count + 2)
    inside = interpolate(np.arange(FINE).astype(np.float64).reshape(FINE, 1), gauge, middles)
    out[0], out[count + 1] = 0.0, FINE - 1.0
    for k in range(count):
        out[k + 1] = inside[k, 0]
    return out


@compiled
def turns_within(
    outline: Array, space: Array, depth: DepthImages, mask: Mask, left: int, top: int, width: float, lens: Array,
    model: Any,
) -> Array:  # fmt: skip
    """Return ``(400,)`` radians by which an outline turns within the sheet, which bending does not change.

    A border that bends out of the sheet's plane turns in the image and not within the sheet; the edge of a fold does.

    Args:
        outline: ``(400, 2)`` pixels.
        space: ``(400, 3)`` the same in metres.
        depth: As ``outline_depth`` takes it, and all up to the width.
        mask: Of the sheet.
        left: Image column.
        top: Image row.
        width: Of the sheet, pixels.
        lens: The projection.
        model: The constants, one ``LatticeModel``.
    """
    inside, turns = np.empty_like(outline), np.zeros(AROUND)
    for p in range(AROUND):
        back, ahead = (p - TURN_REACH // 2) % AROUND, (p + TURN_REACH // 2) % AROUND
        x, y = outline[ahead, 0] - outline[back, 0], outline[ahead, 1] - outline[back, 1]
        far = model.inner * width / max(math.sqrt(x * x + y * y), 1e-9)
        inside[p, 0], inside[p, 1] = outline[p, 0] - far * y, outline[p, 1] + far * x
    window = left, top, mask.shape[1], mask.shape[0]
    z, _ = outline_depth(depth, window, mask, left, top, inside, width, model)
    there = deprojected(inside, z, lens)
    for p in range(len(there)):
        before = _away(space[(p - TURN_REACH) % AROUND], space[p])
        after = _away(space[p], space[(p + TURN_REACH) % AROUND])
        along = before[0] + after[0], before[1] + after[1], before[2] + after[2]
        normal = _cross(along, _away(space[p], there[p]))
        # Within the plane whose normal is n, sine and cosine of a and b are n (a x b) |n| and n^2 (a b) - (n a) (n b).
        square = max(_product(normal, normal), 1e-24)
        sine = _product(_cross(before, after), normal) * math.sqrt(square)
        cosine = square * _product(before, after) - _product(before, normal) * _product(after, normal)
        turns[p] = abs(math.atan2(sine, cosine))
    return turns


@compiled
def _away(start: Array, stop: Array) -> Vector:
    """Return the way from a point in space to another."""
    return stop[0] - start[0], stop[1] - start[1], stop[2] - start[2]


@compiled
def _product(a: Vector, b: Vector) -> float:
    """Return the dot product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def _cross(a: Vector, b: Vector) -> Vector:
    """Return the cross product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
