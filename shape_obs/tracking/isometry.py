"""The isometry of a sheet: whether depth shows that it is folded or crumpled.

A sheet does not stretch: if it is spread out, all of its rows are equally long along the surface, and so are its
columns.
A fold makes those shorter that skip what it hides. Where a piece lies over another, its edge is a step in depth, and
where the sheet goes on beneath itself, its surface turns away from the camera before it ends.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import projected, viewing_rays
from shape_obs.compiled import compiled
from shape_obs.frame import FARTHEST, MILLIMETRE, DepthImages
from shape_obs.geometry.coons import FINE
from shape_obs.image.connected_runs import nearest_pixel

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]
Mask = npt.NDArray[np.uint8]
Place = tuple[int, int]

_LAST: Final = FINE - 1  # of the nodes of a line
_SAMPLES: Final = 6  # of depth from a node of a line to the next, at most


#: By which share of the median the shortest row or column is shorter along the surface, and the longest longer; over
#: which share of the rows, or of the columns, depth steps within the sheet; over which share of a side the surface
#: turns away from the camera.
Measures = tuple[float, float, float, float]
#: ``(625,)`` metres by which a node may be off its material, 0 for less than a tenth of a gap, ``(0,)`` if nothing
#: shows that; metres between two points of the shape; what shows that it is folded.
Isometry = tuple[Array, float, Measures]


@compiled
def isometry(
    lattice: Array, hidden: Flags, depth: DepthImages, mask: Mask, at: Place, lens: Array, rows: int, cols: int,
    model: Any,
) -> Isometry:  # fmt: skip
    """Return what shows whether a sheet is spread out: depth under its lattice, or the lattice itself in a cloud.

    Args:
        lattice: ``(625, D)`` pixels or metres, row by row.
        hidden: ``(625,)`` nodes whose depth is not their own.
        depth: The frame's, see ``frame.depth_images``.
        mask: The sheet's.
        at: Image column and row of its first pixel.
        lens: The projection, see ``Intrinsics.lens``.
        rows: Of the shape.
        cols: The same.
        model: The constants, one ``LatticeModel``.
    """
    if len(lens) > 0 and len(depth[0]) + len(depth[1]) > 0:
        places = projected(lattice, lens) if lattice.shape[1] == 3 else lattice
        if len(places) > 0:
            return _in_image(places, hidden, depth, mask, at, lens, rows, cols, model)
    if lattice.shape[1] == 3:
        return _in_space(lattice, rows, cols, model)
    return lens[:0], np.inf, (0.0, 0.0, 0.0, 0.0)


@compiled
def flatness(measures: Measures, model: Any) -> float:
    """Return how far it may be believed that a sheet is spread out, 0...1; 0 if it is refused."""
    short, long, torn, turned = measures
    believed = _left(short, model.row_noise, model.max_short) * _left(long, model.row_noise, model.max_long)
    believed = believed * _left(torn, model.torn[0], model.torn[1]) * _left(turned, model.turned[0], model.turned[1])
    return math.sqrt(believed) if math.sqrt(believed) >= model.min_flat else 0.0


@compiled
def _left(share: float, ideal: float, most: float) -> float:
    """Return how much is left, 0...1, of the room between an ideal share and the most that is allowed."""
    return min(max((most - share) / (most - ideal), 0.0), 1.0)


def folded_reason(measures: Measures) -> str:
    """Return in words why a sheet is not spread out."""
    short, long, torn, turned = measures
    return (
        f"a part of the sheet lies over or beneath another: its rows or columns are {-short:.0%} to {long:+.0%} of "
        f"their usual length along the surface, depth steps within {torn:.0%} of them, and {turned:.0%} of a side "
        "turns away from the camera"
    )


@compiled
def _in_space(space: Array, rows: int, cols: int, model: Any) -> Isometry:
    """Return the isometry of a lattice in space, but for what only an image shows.

    Let w be the way along the surface from the begin of a row to node k of n, W' the row's whole length, and W the
    median of all rows. In the material no node lies farther from a side than the way to that side is long, so that node
    k is off by at least::

        max(0, k/n W - w, (1 - k/n) W - (W' - w))

    and where W' differs from W it is anywhere in between: |W' - W| / sqrt(12). Depth is smeared at a border: ways begin
    at the second node and end at the last but one.

    Args:
        space: ``(625, 3)`` metres; NaN for nodes without depth.
        rows: Of the shape.
        cols: The same.
        model: The constants, one ``LatticeModel``.
    """
    off, gap, short, long = np.zeros((FINE, FINE)), np.inf, 0.0, 0.0
    noise = model.row_noise
    for down in range(2):
        ways, lengths = np.full((FINE, FINE), np.nan), np.full(FINE, np.nan)
        for i in range(1, _LAST):
            last, way = 0, 0.0
            for k in range(1, _LAST):
                p, q = (k * FINE + i, last * FINE + i) if down else (i * FINE + k, i * FINE + last)
                if math.isfinite(space[p, 0]):
                    square = 0.0
                    for d in range(3):
                        square += (space[p, d] - space[q, d]) ** 2
                    way += math.sqrt(square) if last else 0.0
                    ways[i, k], last = way, k
            if last == _LAST - 1 and ways[i, 1] == 0:
                lengths[i] = way
        whole = np.nanmedian(lengths)
        if whole > 0:
            gap = min(gap, whole * (FINE - 1) / (FINE - 3) / (rows if down else cols))
        for i in range(1, _LAST):
            excess = lengths[i] / whole - 1
            if not math.isfinite(excess):
                continue
            short, long = max(short, -excess), max(long, excess)
            anywhere = max(abs(excess) - noise, 0.0) / math.sqrt(12)
            for k in range(1, _LAST):
                if math.isfinite(ways[i, k]):
                    share, way, row, col = (k - 1) / (FINE - 3), ways[i, k] / whole, k if down else i, i if down else k
                    least = max(share - way, 1 - share - (excess + 1 - way), 0.0)
                    off[row, col] += (least**2 + anywhere**2) * whole**2
    out = np.empty(FINE * FINE)
    for p in range(len(out)):
        square = off[min(max(p // FINE, 1), _LAST - 1), min(max(p % FINE, 1), _LAST - 1)]
        out[p] = max(math.sqrt(square) - model.node_noise * gap, 0.0)
    return out, gap, (short, long, 0.0, 0.0)


@compiled
def _in_image(
    lattice: Array, hidden: Flags, depth: DepthImages, mask: Mask, at: Place, lens: Array, rows: int, cols: int,
    model: Any,
) -> Isometry:  # fmt: skip
    """Return the isometry of a lattice in an image; steps are looked for along every other line of it.

    For the arguments see ``isometry``; ``lattice`` is in pixels.
    """
    space, focal, torn, turned, spacing = viewing_rays(lattice, lens), (lens[0] + lens[1]) / 2, 0.0, 0.0, 0.0
    steps, begins = np.zeros((2, FINE // 2, FINE)), np.empty(FINE, np.int64)
    trends, falls = np.zeros((2, FINE // 2, FINE)), np.zeros((2, FINE // 2, 2))
    z = _own_depths(lattice, depth, mask, at)
    for p in range(len(lattice)):
        for d in range(3):
            space[p, d] = np.nan if hidden[p] else space[p, d] * z[p]
    for down in range(2):
        for i in range(FINE // 2):
            first, step = (2 * i + 1, FINE) if down else ((2 * i + 1) * FINE, 1)
            nodes = np.arange(first, first + FINE * step, step)
            along = _profile(lattice, hidden, depth, mask, at, nodes, begins)
            last, wide = begins[_LAST], lattice[nodes[_LAST]] - lattice[nodes[0]]
            pixels = math.hypot(wide[0], wide[1])
            angle, margin = pixels / (last * focal), math.ceil(model.smeared * last / max(pixels, 1.0))
            flying = math.ceil(model.flying * last / max(pixels, 1.0))
            middle = along[begins[FINE // 2]] * angle
            spacing = max(spacing, middle if math.isfinite(middle) else 0.0)
            for k in range(1, _LAST - 1):
                trend = (along[begins[k + 2]] - along[begins[k - 1]]) / (begins[k + 2] - begins[k - 1])
                trend = trend if math.isfinite(trend) else 0.0
                trends[down, i, k] = abs(trend)
                for j in range(max(begins[k], margin), min(begins[k + 1], last - margin)):
                    rise = abs(along[j + 1] - along[j] - trend)
                    if rise > steps[down, i, k]:
                        steps[down, i, k] = rise
            ends = last - begins[_LAST - 1], last - begins[_LAST - 3]
            falls[down, i, 0] = _fall(along, flying, begins[1], begins[3], angle, model)
            falls[down, i, 1] = _fall(along[::-1], flying, ends[0], ends[1], angle, model)
    # A sample is read up to half a pixel from its place: on a slope that is a step too.
    slope = max(np.median(trends[0, :, 1 : _LAST - 1]), np.median(trends[1, :, 1 : _LAST - 1]))
    noise = np.median(steps[:, :, 1 : _LAST - 1])
    limit = max(model.step, model.step_noise * noise, model.step_slope * spacing) + slope
    for down in range(2):
        torn_lines, turned_lines = 0, np.zeros(2)
        for i in range(FINE // 2):
            torn_lines += (steps[down, i] - trends[down, i]).max() > limit
            for end in range(2):
                turned_lines[end] += falls[down, i, end] > model.fall_noise * noise
        torn, turned = max(torn, torn_lines / (FINE // 2)), max(turned, turned_lines.max() / (FINE // 2))
    off, gap, (short, long, _, _) = _in_space(space, rows, cols, model)
    return off, gap, (short, long, torn, turned)


@compiled
def _own_depths(places: Array, depth: DepthImages, mask: Mask, at: Place) -> Array:
    """Return the depth of pixels ``(P, 2)`` of the mask, metres ``(P,)``; NaN where it is unknown."""
    z = np.full(len(places), np.nan)
    if len(depth[0]) > 0:
        _read(places, depth[0], MILLIMETRE, mask, at, z)
    else:
        _read(places, depth[1], 1.0, mask, at, z)
    return z


@compiled
def _read(places: Array, depth: npt.NDArray[Any], unit: float, mask: Mask, at: Place, z: Array) -> None:
    """Fill ``_own_depths`` from one kind of image, which is several times as fast as ``depth_at`` pixel by pixel."""
    for p in range(len(places)):
        column, row = nearest_pixel(places[p, 0]), nearest_pixel(places[p, 1])
        x, y = column - at[0], row - at[1]
        if 0 <= y < mask.shape[0] and 0 <= x < mask.shape[1] and mask[y, x] != 0:
            metres = depth[row, column] * unit
            z[p] = metres if 0 < metres < FARTHEST else np.nan


@compiled
def _profile(
    lattice: Array, hidden: Flags, depth: DepthImages, mask: Mask, at: Place, nodes: Indices, begins: Indices
) -> Array:
    """Return the depth along a line of nodes, NaN where it is unknown; fill where each node begins."""
    count = 0
    for k in range(FINE):
        begins[k] = count
        if k < _LAST:
            p, q = nodes[k], nodes[k + 1]
            pixels = max(abs(lattice[q, 0] - lattice[p, 0]), abs(lattice[q, 1] - lattice[p, 1]))
            count += min(max(math.ceil(pixels), 1), _SAMPLES)
    places = np.full((count + 1, 2), np.nan)
    for k in range(FINE):
        p, q = nodes[k], nodes[min(k + 1, _LAST)]
        samples = begins[k + 1] - begins[k] if k < _LAST else 1
        for j in range(0 if hidden[p] else samples):
            for d in range(2):
                places[begins[k] + j, d] = lattice[p, d] + (lattice[q, d] - lattice[p, d]) / samples * j
    return _own_depths(places, depth, mask, at)


@compiled
def _fall(z: Array, flying: int, first: int, third: int, angle: float, model: Any) -> float:
    """Return by how many metres a surface falls away from the camera where its depth ``(P,)`` along a line begins.

    It is 0 for a surface that is not steep there, or as steep farther in.

    Args:
        z: Metres.
        flying: From where on it is the surface's own.
        first: Where the second node of the line is.
        third: Where the fourth is.
        angle: Radians from place to place, as the camera sees them.
        model: The constants, one ``LatticeModel``.
    """
    border = min(flying, first)
    while border < first and math.isnan(z[border]):
        border += 1
    inner, place = min(border + max(first // 2, 2), len(z) - 1), z[third] * angle  # metres from place to place
    steep = math.atan((z[border] - z[inner]) / (place * (inner - border)))
    farther_in = math.atan((z[first] - z[third]) / (place * (third - first)))
    turns = steep > model.steep and steep - farther_in > model.steeper
    return z[border] - z[inner] if turns else 0.0
