"""The relief of a sheet: what depth shows of one that is folded or crumpled, and not laid out.

A sheet does not stretch, so that all rows of a sheet that is laid out are equally long along its surface, and all its
columns. A fold makes those shorter that skip what it hides. Where a piece lies over another its edge is a step in
depth, and where the sheet goes on beneath itself its surface turns away from the camera before it ends.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.camera import viewing_rays
from shape_obs.compiled import compiled
from shape_obs.frame import DEPTH_TYPE, FARTHEST, MILLIMETRE, DepthImages
from shape_obs.geometry.coons import FINE

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]
Mask = npt.NDArray[np.uint8]

_LAST: Final = FINE - 1
_MEASURED: Final = 0.8  # of the nodes of a line must have depth, so that its length is known
# A step from one pixel to the next: metres (two layers of a towel); the slope of a crease that is none; and how often
# the median over all gaps, which is noise.
_STEP: Final = 0.005
_STEP_SLOPE: Final = 1.5
_STEP_NOISE: Final = 4.0
# Radians: a surface that is so steep, and so much steeper than a twelfth of a side farther in, turns away.
_STEEP: Final = 0.9
_STEEPER: Final = 0.5
# Of simulated cloths that were dropped, dragged and folded: what is wrong has more, what is right has less.
_IDEAL: Final = 0.03, 0.15, 0.05
_MAX_SHORT: Final = 0.2
_MAX_TORN: Final = 0.4
_MAX_TURNED: Final = 0.25
_MAX_LONG: Final = 0.3


class Relief(NamedTuple):
    """What the depth under a lattice shows.

    Args:
        off: ``(625,)`` gaps by which nodes are off their material at least.
        short: By which share of the median the shortest row or column is shorter along the surface, inside the border.
        long: The same of the longest.
        torn: In which share of the rows or of the columns depth steps from one pixel to the next.
        turned: Over which share of a side the surface turns away from the camera.
    """

    off: Array
    short: float
    long: float
    torn: float
    turned: float

    def verdict(self) -> tuple[str, float]:
        """Return why this is no sheet that is laid out, empty if it is, and how far it may be believed, 0...1."""
        reason, beneath = "", "a part of the sheet is folded beneath"
        if self.short > _MAX_SHORT or self.long > _MAX_LONG:
            lengths = f"rows or columns from {1 - self.short:.0%} to {1 + self.long:.0%} of their usual length"
            reason = f"the surface has {lengths} (at least {1 - _MAX_SHORT:.0%}): {beneath}"
        elif self.torn > _MAX_TORN:
            reason = f"depth steps within {self.torn:.0%} of the rows or columns (at most {_MAX_TORN:.0%}): the sheet lies over itself"
        elif self.turned > _MAX_TURNED:
            reason = f"{self.turned:.0%} of a side turn away from the camera (at most {_MAX_TURNED:.0%}): {beneath}"
        if reason:
            return reason, 0.0
        worst = (self.short, _MAX_SHORT), (self.torn, _MAX_TORN), (self.turned, _MAX_TURNED)
        left = [1 - max(share - least, 0.0) / (most - least) for (share, most), least in zip(worst, _IDEAL, strict=True)]
        return "", math.prod(left) ** 0.5


@compiled("(f8[:,::1], b1[::1], " + DEPTH_TYPE + ", u1[:,::1], UniTuple(i8, 2), f8[::1], f8, f8)")
def see_relief(
    lattice: Array, hidden: Flags, depth: DepthImages, mask: Mask, at: tuple[int, int], lens: Array, rows: float,
    cols: float,
) -> tuple[Array, float, float, float, float]:  # fmt: skip
    """Return the fields of ``Relief``.

    Let w be the way along the surface from the begin of a row to node k of n, W' the row's whole length and W the
    median of all rows. In the material no node lies farther from a side than the way to it is long, so that it is off
    by at least::

        max(0, k/n W - w, (1 - k/n) W - (W' - w))

    Depth is smeared at the border: ways begin at the second node and end at the last but one.

    Args:
        lattice: ``(625, 2)`` pixels.
        hidden: ``(625,)`` nodes whose depth is not their own.
        depth: The frame's.
        mask: ``(h, w)`` of the sheet.
        at: Image column and row of its first pixel.
        lens: See ``Intrinsics.lens``.
        rows: Of the points that are asked for, whose gaps are the unit of ``off``.
        cols: The same.
    """
    rays, focal = viewing_rays(lattice, lens), (lens[0] + lens[1]) / 2
    off, short, long, torn, turned = np.zeros((FINE, FINE)), 0.0, 0.0, 0.0, 0.0
    steps, nodes, begins = np.empty((2, FINE, FINE)), np.empty(FINE, np.int64), np.empty(FINE, np.int64)
    ways, lengths, space = np.empty((FINE, FINE)), np.empty(FINE), np.empty(3)
    floor = np.inf
    for way in range(2):
        steps[way], lengths[:] = 0.0, np.nan
        away = np.zeros(2)
        for i in range(1, _LAST):
            for k in range(FINE):
                nodes[k] = k * FINE + i if way else i * FINE + k
            z = _profile(lattice, hidden, depth, mask, at, nodes, begins)
            last, seen, length = 0, 0, 0.0
            for k in range(1, _LAST):
                here = z[begins[k]]
                if math.isfinite(here):
                    square = 0.0
                    for d in range(3):
                        there = rays[nodes[k], d] * here
                        square += (there - space[d]) ** 2
                        space[d] = there
                    length += math.sqrt(square) if last else 0.0
                    seen, last = seen + 1, k
                    floor = min(floor, here)
                ways[i, k] = length if last == k else np.nan
            if seen >= _MEASURED * (FINE - 2) and last == _LAST - 1 and math.isfinite(z[begins[1]]):
                lengths[i] = length
            for k in range(1, _LAST - 1):
                trend = (z[begins[k + 2]] - z[begins[k - 1]]) / (begins[k + 2] - begins[k - 1])
                for j in range(begins[k], begins[k + 1]):
                    step = abs(z[j + 1] - z[j] - (trend if math.isfinite(trend) else 0.0))
                    steps[way, i, k] = max(steps[way, i, k], step if math.isfinite(step) else 0.0)
            for end in range(2):
                away[end] += _turns_away(z[::-1] if end else z, begins, end, lattice, nodes, focal)
        turned = max(turned, away.max() / (FINE - 2))
        whole = np.nanmedian(lengths)
        for i in range(1, _LAST):
            if lengths[i] > 0:
                short, long = max(short, 1 - lengths[i] / whole), max(long, lengths[i] / whole - 1)
                for k in range(1, _LAST):
                    if math.isnan(ways[i, k]):
                        continue
                    share, row, col = (k - 1) / (FINE - 3), k if way else i, i if way else k
                    behind, ahead = share * whole - ways[i, k], (1 - share) * whole - (lengths[i] - ways[i, k])
                    gap = whole * (FINE - 1) / (FINE - 3) / (rows if way else cols)
                    off[row, col] = math.hypot(off[row, col], max(behind, ahead, 0.0) / gap)
    limit = max(_STEP, _STEP_NOISE * np.median(steps[:, 1:-1, 1:-2]), _STEP_SLOPE * floor / focal)
    for way in range(2):
        lines = 0
        for i in range(1, _LAST):
            lines += steps[way, i].max() > limit
        torn = max(torn, lines / (FINE - 2))
    for i in range(FINE):
        inside = min(max(i, 1), _LAST - 1)
        off[0, i], off[_LAST, i] = off[1, inside], off[_LAST - 1, inside]
    for i in range(FINE):
        off[i, 0], off[i, _LAST] = off[i, 1], off[i, _LAST - 1]
    return off.reshape(FINE * FINE), short, long, torn, turned


@compiled
def _profile(
    lattice: Array, hidden: Flags, depth: DepthImages, mask: Mask, at: tuple[int, int], nodes: Indices, begins: Indices
) -> Array:  # fmt: skip
    """Return the depth along a line of nodes, pixel by pixel, NaN where there is none; fill where its nodes are."""
    count = 0
    for k in range(len(nodes)):
        begins[k] = count
        if k < len(nodes) - 1:
            a, b = lattice[nodes[k]], lattice[nodes[k + 1]]
            count += max(math.ceil(max(abs(b[0] - a[0]), abs(b[1] - a[1]))), 1)
    z = np.full(count + 1, np.nan)
    for k in range(len(nodes)):
        a, b = lattice[nodes[k]], lattice[nodes[min(k + 1, len(nodes) - 1)]]
        gap = begins[k + 1] - begins[k] if k < len(nodes) - 1 else 1
        if hidden[nodes[k]]:
            continue
        for j in range(gap):
            u, v = round(a[0] + (b[0] - a[0]) * j / gap), round(a[1] + (b[1] - a[1]) * j / gap)
            x, y = u - at[0], v - at[1]
            if 0 <= y < mask.shape[0] and 0 <= x < mask.shape[1] and mask[y, x] > 0:
                here = float(depth[1][v, u]) if len(depth[0]) == 0 else depth[0][v, u] * MILLIMETRE
                if 0 < here < FARTHEST:
                    z[begins[k] + j] = here
    return z


@compiled
def _turns_away(z: Array, begins: Indices, end: int, lattice: Array, nodes: Indices, focal: float) -> bool:
    """Return whether the surface turns away from the camera at the end of a line whose depth begins there."""
    first, third = (begins[-1] - begins[-2], begins[-1] - begins[-4]) if end else (begins[1], begins[3])
    rim = 0
    while rim < first // 2 and math.isnan(z[rim]):
        rim += 1
    inner = min(rim + max(first // 2, 2), len(z) - 1)
    a, b = lattice[nodes[-1 if end else 0]], lattice[nodes[-4 if end else 3]]
    pixel = z[third] / focal * math.hypot(b[0] - a[0], b[1] - a[1]) / third  # metres from one place to the next
    steep, before = math.atan((z[rim] - z[inner]) / (pixel * (inner - rim))), math.atan((z[first] - z[third]) / (pixel * (third - first)))
    return steep > _STEEP and steep - before > _STEEPER
