"""The isometry of a sheet: whether depth shows that it is folded or crumpled.

A sheet does not stretch: if it is spread out, all of its rows are equally long along the surface, and so are its
columns.
A fold makes those shorter that skip what it hides. Where a piece lies over another, its edge is a step in depth, and
where the sheet goes on beneath itself, its surface turns away from the camera before it ends.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.camera import viewing_rays
from shape_obs.compiled import compiled
from shape_obs.frame import DEPTH_TYPE, FARTHEST, MILLIMETRE, DepthImages
from shape_obs.geometry.coons import FINE

if TYPE_CHECKING:
    from shape_obs.camera import Intrinsics
    from shape_obs.image.region import Region

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]
Mask = npt.NDArray[np.uint8]
Place = tuple[int, int]

_LAST: Final = FINE - 1
_MEASURED: Final = 0.8  # of the nodes of a line have depth, so that its length is known
_FLYING: Final = 2.0  # pixels from the border that may fly between the sheet and what lies behind
_SMEARED: Final = 3.0  # pixels from the border in which depth may be that of what lies behind
_SAMPLES: Final = 6  # of depth from a node of a line to the next, at most
_STEP: Final = 0.005  # metres between two samples: two layers of a towel, five times a D455's noise at 0.7 m
_STEP_SLOPE: Final = 1.5  # metres of depth per metre: steeper than any crease of a cloth in waves (1.0)
_STEP_NOISE: Final = 4.0  # times the median of the largest steps of all gaps, which is noise
_FALL_NOISE: Final = 2.0  # times the same: what falls by less at a border may be noise
_STEEP: Final = 0.55  # radians by which a surface leans at its border, where it may turn away
_STEEPER: Final = 0.4  # radians more than an eighth of a side farther in
# Shares that noise and waves explain, and shares from which a sheet is refused. Of 170 simulated cloths that were
# dropped, dragged and folded, seen at 640 x 480, all with less lay within half a cell of their material on average; of
# 60 in waves one had more, under 2 mm of noise (``tests.benchmarks sheets.crumpled``).
_IDEAL: Final = 0.03  # of a row's length, shorter or longer than the median
_MAX_SHORT: Final = 0.18
_MAX_LONG: Final = 0.5
_IDEAL_TORN: Final = 0.25  # of the rows or columns
_MAX_TORN: Final = 0.4
_IDEAL_TURNED: Final = 0.2  # of a side
_MAX_TURNED: Final = 0.3
_LEAST: Final = 0.5  # of belief: the shares together are evidence where none of them is alone
_NOISE: Final = 0.1  # of a gap: nodes that are off by less are not
_UNCERTAIN: Final = 0.2  # of a gap, beyond that: nodes that are off by more are uncertain


class Isometry(NamedTuple):
    """What the depth under a lattice shows.

    Args:
        off: ``(625,)`` metres by which a node may be off its material, 0 for less than a tenth of a gap.
        gap: Between two points of the shape, metres.
        short: By which share of the median the shortest row or column is shorter along the surface.
        long: The same of the longest.
        torn: Over which share of the rows, or of the columns, depth steps within the sheet.
        turned: Over which share of a side the surface turns away from the camera.
    """

    off: Array
    gap: float
    short: float
    long: float
    torn: float = 0.0
    turned: float = 0.0

    @classmethod
    def in_image(
        cls, lattice: Array, hidden: Flags, region: Region, images: DepthImages, camera: Intrinsics, size: Place
    ) -> Isometry:
        """Return the isometry of a lattice of ``(625, 2)`` pixels.

        Args:
            lattice: Row by row.
            hidden: ``(625,)`` nodes whose depth is not their own.
            region: The sheet's mask.
            images: The frame's depth.
            camera: The projection.
            size: Rows and columns of the shape.
        """
        return cls(*_in_image(lattice, hidden, images, region.mask, region.window[:2], camera.lens, *size))

    @classmethod
    def in_space(cls, lattice: Array, size: Place) -> Isometry:
        """Return the isometry of a lattice of ``(625, 3)`` points on a surface without an image."""
        return cls(*_compare_ways(np.ascontiguousarray(lattice), *size))

    @property
    def uncertain(self) -> Flags:
        """``(625,)`` nodes that may be off by too much of a gap."""
        return self.off > _UNCERTAIN * self.gap

    def verdict(self) -> tuple[str, float]:
        """Return why the sheet is not spread out, empty if it is, and how far that may be believed, 0...1."""
        shares = (
            _left(self.short, _IDEAL, _MAX_SHORT), _left(self.long, _IDEAL, _MAX_LONG),
            _left(self.torn, _IDEAL_TORN, _MAX_TORN), _left(self.turned, _IDEAL_TURNED, _MAX_TURNED),
        )  # fmt: skip
        believed = math.prod(shares) ** 0.5
        if believed >= _LEAST:
            return "", believed
        return (
            f"a part of the sheet lies over or beneath another: its rows or columns are {-self.short:.0%} to "
            f"{self.long:+.0%} of their usual length along the surface, depth steps within {self.torn:.0%} of them, "
            f"and {self.turned:.0%} of a side turns away from the camera"
        ), 0.0


def _left(share: float, ideal: float, most: float) -> float:
    """Return how far a share is from its limit, 1 for what is ideal, 0 at the limit."""
    return min(max((most - share) / (most - ideal), 0.0), 1.0)


@compiled("(f8[:,::1], i8, i8)")
def _compare_ways(space: Array, rows: int, cols: int) -> tuple[Array, float, float, float]:
    """Return the first four fields of ``Isometry``.

    Let w be the way along the surface from the begin of a row to node k of n, W' the row's whole length, and W the
    median of all rows. In the material no node lies farther from a side than the way to that side is long, so that node
    k is off by at least::

        max(0, k/n W - w, (1 - k/n) W - (W' - w))

    and where W' differs from W it is anywhere in between: |W' - W| / sqrt(12). Depth is smeared at a border: ways begin
    at the second node and end at the last but one.

    Args:
        space: ``(625, 3)`` metres; NaN for nodes without depth.
        rows: See ``Isometry.in_image``.
        cols: The same.
    """
    off, gap, short, long = np.zeros((FINE, FINE)), np.inf, 0.0, 0.0
    for down in range(2):
        ways, lengths = np.full((FINE, FINE), np.nan), np.full(FINE, np.nan)
        for i in range(1, _LAST):
            last, seen, way = 0, 0, 0.0
            for k in range(1, _LAST):
                p, q = (k * FINE + i, last * FINE + i) if down else (i * FINE + k, i * FINE + last)
                if math.isfinite(space[p, 0]):
                    square = 0.0
                    for d in range(3):
                        square += (space[p, d] - space[q, d]) ** 2
                    way += math.sqrt(square) if last else 0.0
                    ways[i, k], last, seen = way, k, seen + 1
            if seen >= _MEASURED * (FINE - 2) and last == _LAST - 1 and ways[i, 1] == 0:
                lengths[i] = way
        whole = np.nanmedian(lengths)
        if whole > 0:
            gap = min(gap, whole * (FINE - 1) / (FINE - 3) / (rows if down else cols))
        for i in range(1, _LAST):
            excess = lengths[i] / whole - 1
            if not math.isfinite(excess):
                continue
            short, long = max(short, -excess), max(long, excess)
            anywhere = max(abs(excess) - _IDEAL, 0.0) / math.sqrt(12)
            for k in range(1, _LAST):
                if math.isfinite(ways[i, k]):
                    share, way, row, col = (k - 1) / (FINE - 3), ways[i, k] / whole, k if down else i, i if down else k
                    least = max(share - way, 1 - share - (excess + 1 - way), 0.0)
                    off[row, col] = math.hypot(off[row, col], math.hypot(least, anywhere) * whole)
    for i in range(FINE * FINE):
        row, col = i // FINE, i % FINE
        off[row, col] = off[min(max(row, 1), _LAST - 1), min(max(col, 1), _LAST - 1)]
    return np.maximum(off - _NOISE * gap, 0.0).reshape(FINE * FINE), gap, short, long


@compiled("(f8[:,::1], b1[::1], " + DEPTH_TYPE + ", u1[:,::1], UniTuple(i8, 2), f8[::1], i8, i8)")
def _in_image(
    lattice: Array, hidden: Flags, depth: DepthImages, mask: Mask, at: Place, lens: Array, rows: int, cols: int
) -> tuple[Array, float, float, float, float, float]:
    """Return the fields of ``Isometry`` as ``Isometry.in_image`` takes the lattice."""
    if len(depth[0]) > 0:
        return _look(lattice, hidden, depth[0], MILLIMETRE, mask, at, lens, rows, cols)
    return _look(lattice, hidden, depth[1], 1.0, mask, at, lens, rows, cols)


@compiled
def _look(
    lattice: Array, hidden: Flags, depth: npt.NDArray[Any], unit: float, mask: Mask, at: Place, lens: Array, rows: int,
    cols: int,
) -> tuple[Array, float, float, float, float, float]:  # fmt: skip
    """Return the fields of ``Isometry``; steps are looked for along every other line of the lattice."""
    space, focal, torn, turned, spacing = viewing_rays(lattice, lens), (lens[0] + lens[1]) / 2, 0.0, 0.0, 0.0
    steps, begins = np.zeros((2, FINE // 2, FINE)), np.empty(FINE, np.int64)
    trends, falls = np.zeros((2, FINE // 2, FINE)), np.zeros((2, FINE // 2, 2))
    for p in range(len(lattice)):
        z = np.nan if hidden[p] else _depth_at(lattice[p, 0], lattice[p, 1], depth, unit, mask, at)
        for d in range(3):
            space[p, d] *= z
    for down in range(2):
        for i in range(FINE // 2):
            first, step = (2 * i + 1, FINE) if down else ((2 * i + 1) * FINE, 1)
            nodes = np.arange(first, first + FINE * step, step)
            along = _profile(lattice, hidden, depth, unit, mask, at, nodes, begins)
            last, wide = begins[_LAST], lattice[nodes[_LAST]] - lattice[nodes[0]]
            pixels = math.hypot(wide[0], wide[1])
            angle, margin = pixels / (last * focal), math.ceil(_SMEARED * last / max(pixels, 1.0))
            flying = math.ceil(_FLYING * last / max(pixels, 1.0))
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
            falls[down, i, 0] = _fall(along, flying, begins[1], begins[3], angle)
            falls[down, i, 1] = _fall(along[::-1], flying, ends[0], ends[1], angle)
    # A sample is read up to half a pixel from its place: on a slope that is a step too.
    slope = max(np.median(trends[0, :, 1 : _LAST - 1]), np.median(trends[1, :, 1 : _LAST - 1]))
    noise = np.median(steps[:, :, 1 : _LAST - 1])
    limit = max(_STEP, _STEP_NOISE * noise, _STEP_SLOPE * spacing) + slope
    for down in range(2):
        torn_lines, turned_lines = 0, np.zeros(2)
        for i in range(FINE // 2):
            torn_lines += (steps[down, i] - trends[down, i]).max() > limit
            for end in range(2):
                turned_lines[end] += falls[down, i, end] > _FALL_NOISE * noise
        torn, turned = max(torn, torn_lines / (FINE // 2)), max(turned, turned_lines.max() / (FINE // 2))
    off, gap, short, long = _compare_ways(space, rows, cols)
    return off, gap, short, long, torn, turned


@compiled(inline=True)
def _depth_at(u: float, v: float, depth: npt.NDArray[Any], unit: float, mask: Mask, at: Place) -> float:
    """Return the depth of a pixel of the mask, metres; NaN where it is unknown."""
    column, row = int(u + 0.5), int(v + 0.5)
    x, y = column - at[0], row - at[1]
    if not (0 <= y < mask.shape[0] and 0 <= x < mask.shape[1]) or mask[y, x] == 0:
        return np.nan
    z = depth[row, column] * unit
    return z if 0 < z < FARTHEST else np.nan


@compiled
def _profile(
    lattice: Array, hidden: Flags, depth: npt.NDArray[Any], unit: float, mask: Mask, at: Place, nodes: Indices,
    begins: Indices,
) -> Array:  # fmt: skip
    """Return the depth along a line of nodes, NaN where it is unknown; fill where each node begins."""
    count = 0
    for k in range(FINE):
        begins[k] = count
        if k < _LAST:
            p, q = nodes[k], nodes[k + 1]
            pixels = max(abs(lattice[q, 0] - lattice[p, 0]), abs(lattice[q, 1] - lattice[p, 1]))
            count += min(max(math.ceil(pixels), 1), _SAMPLES)
    z = np.full(count + 1, np.nan)
    for k in range(FINE):
        p, q = nodes[k], nodes[min(k + 1, _LAST)]
        samples = begins[k + 1] - begins[k] if k < _LAST else 1
        if not hidden[p]:
            across, down = (lattice[q, 0] - lattice[p, 0]) / samples, (lattice[q, 1] - lattice[p, 1]) / samples
            for j in range(samples):
                z[begins[k] + j] = _depth_at(
                    lattice[p, 0] + across * j, lattice[p, 1] + down * j, depth, unit, mask, at
                )
    return z


@compiled
def _fall(z: Array, flying: int, first: int, third: int, angle: float) -> float:
    """Return by how many metres a surface falls away from the camera where its depth ``(P,)`` along a line begins.

    It is 0 for a surface that is not steep there, or as steep farther in.

    Args:
        z: Metres.
        flying: From where on it is the surface's own.
        first: Where the second node of the line is.
        third: Where the fourth is.
        angle: Radians from place to place, as the camera sees them.
    """
    border = min(flying, first)
    while border < first and math.isnan(z[border]):
        border += 1
    inner, place = min(border + max(first // 2, 2), len(z) - 1), z[third] * angle  # metres from place to place
    steep = math.atan((z[border] - z[inner]) / (place * (inner - border)))
    turns = steep > _STEEP and steep - math.atan((z[first] - z[third]) / (place * (third - first))) > _STEEPER
    return z[border] - z[inner] if turns else 0.0


ISOMETRY_FUNCTIONS: Final = _in_image, _compare_ways
