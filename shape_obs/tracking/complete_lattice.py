"""Put back the hidden part of a sheet's border.

What is seen of the border is found by its length along the outline from the visible corners; the known border is laid
over it (S. Umeyama, "Least-Squares Estimation of Transformation Parameters Between Two Point Patterns", 1991) and goes
on where it is hidden. With depth, an outline next to which something nearer is seen is that of what hides the object.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any, Final, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.frame import DEPTH_TYPE, FARTHEST, MILLIMETRE, DepthImages, unit_of
from shape_obs.geometry.coons import RIM, SIDE, folded_piece, stretched, unfold
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.geometry.rotation import fit
from shape_obs.image.connected_runs import nearest_pixel
from shape_obs.point_cloud.local_depth import SPARSE, bridged, gather_depth, middle_depth, room
from shape_obs.tracking.model import DepthLimits, LatticeModel

if TYPE_CHECKING:
    from shape_obs.camera import Intrinsics
    from shape_obs.image.region import Region
    from shape_obs.image.roi import Window

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
Edges = tuple[int, int, int, int]
Lens = tuple[float, float, float, float]
Pair = tuple[float, float]

_OUTSIDE: Final = 1.5  # pixels from an outline to the first place beyond it, whose pixel is not the object's own
_WINDOWS: Final = 96  # places along an outline at which depth is read, at least; half as many more at most


class Border(NamedTuple):
    """The border of a sheet, put back where it is hidden.

    Args:
        points: ``(96, D)``: from each corner, clockwise, to the next.
        seen: ``(96,)`` whether the outline shows it.
        folded: First and last point of each piece around a corner that is hidden though nothing lies over it.
    """

    points: Array
    seen: Mask
    folded: tuple[tuple[int, int], ...] = ()


def complete_border(
    expected: Array, known: Array, rim: Array, space: Array, corners: Indices, cut: Mask, kinks: Mask,
    sides: Array, slack: Array, bend: float, model: LatticeModel,
) -> Border | None:  # fmt: skip
    """Return the whole border of a sheet of which a part is seen; None if too little is known.

    Args:
        expected: ``(96, 2)`` pixels, the border where it is predicted or as it was, 24 points to a side.
        known: ``(96, D)`` the border as it was, wherever it lay.
        rim: ``(400, 2)`` pixels, the outline.
        space: ``(400, D)`` the same, in metres where it is known.
        corners: ``(4,)`` points of the rim; -1 for a hidden one.
        cut: ``(400,)`` whether something lies over what is behind this point.
        kinks: ``(400,)`` whether it turns there as no sheet's side does.
        sides: ``(4,)`` the known lengths.
        slack: ``(4,)`` by which a length may be off.
        bend: By how much of the way the border may be off its form.
        model: The constants.
    """
    trimmed = int(model.trimmed)
    lines = [np.ascontiguousarray(np.concatenate([points, points[:1]])) for points in (rim, space)]
    arc = arc_length(lines[1])
    visible = [k for k in range(4) if corners[k] >= 0]
    start = SIDE * np.array(visible)
    placed = fit(expected[start], rim[corners[visible]], scaled=True).apply(expected)
    found, seen = np.zeros((4 * SIDE, space.shape[1])), np.zeros(4 * SIDE, bool)
    for k, way in product(visible, (1, -1)):
        side, other = (k, (k + 1) % 4) if way > 0 else ((k - 1) % 4, (k - 1) % 4)
        length = sides[side]
        if corners[other] >= 0:
            between = way * (arc[corners[other]] - arc[corners[k]]) % arc[-1]
            length = between if abs(between - length) < model.own_length * slack[side] else length
        points = (SIDE * k + way * np.arange(SIDE + 1)) % (4 * SIDE)
        at = (arc[corners[k]] + way * np.linspace(0, length, SIDE + 1)) % arc[-1]
        pixels, places = (interpolate(line, arc, at) for line in lines)
        far = np.linalg.norm(placed[points] - placed[points[0]], axis=1)
        off = np.linalg.norm(pixels - pixels[0] - (placed[points] - placed[points[0]]), axis=1)
        covered = (cut | kinks)[np.searchsorted(arc, at, side="right").clip(1, RIM) - 1]
        wrong = (off > model.border_noise + bend * far) | covered
        good = points[: SIDE + 1 if not wrong.any() else max(int(np.argmax(wrong)) - trimmed, 0)]
        found[good], seen[good] = places[: len(good)], True
    if seen.mean() < model.min_seen:
        return None
    known = stretched(known, [k for k in range(4) if corners[k] < 0], sides)
    laid = fit(known[seen], found[seen], scaled=space.shape[1] == 2).apply(known)
    index = np.arange(4 * SIDE)
    sharp = seen & (abs((index + SIDE // 2) % SIDE - SIDE // 2) > trimmed)
    if not sharp.any():
        return None
    off = found - laid
    if np.sqrt((off[sharp] ** 2).sum(axis=1).mean()) > model.max_misfit * sides.mean():
        return None
    off = [np.interp(index, index[sharp], column[sharp], period=4 * SIDE) for column in off.T]
    points, folded = laid + np.stack(off, axis=1), []
    for k in range(4):
        if corners[k] < 0 and space.shape[1] == 3:
            piece = folded_piece(points, seen, k, space, cut, sides, slack)
            if piece is not None:
                unfold(points, *piece, SIDE * k, sides)
                folded.append(piece)
    return Border(points, seen, tuple(folded))


def look_around(
    region: Region, points: Array, depth: DepthImages, intrinsics: Intrinsics | None, edge: Window | None,
    limits: DepthLimits,
) -> tuple[Array | None, Mask]:  # fmt: skip
    """Return an outline ``(P, 2)`` in space, ``(P, 3)`` or None without depth, and where it is not the object's own.

    Args:
        region: The mask.
        points: ``(P, 2)`` pixels, clockwise as seen.
        depth: The frame's, see ``frame.depth_images``; both empty without depth or a camera.
        intrinsics: The projection; None if there is none.
        edge: The part of the image that is searched; None for the region's window.
        limits: See ``rim_depth``.
    """
    at = region.window.left, region.window.top
    searched = cast("Edges", tuple(edge or region.window))
    z, cut = rim_depth(depth, searched, region.mask, *at, points, region.width, limits)
    if intrinsics is None or np.isnan(z[0]):
        return None, cut
    lifted = intrinsics.deproject(points, z)
    return (lifted if np.isfinite(lifted).all() else None), cut


@compiled("(" + DEPTH_TYPE + ", UniTuple(i8, 4), u1[:,::1], i8, i8, f8[:,::1], f8, UniTuple(f8, 7))")
def rim_depth(
    depth: DepthImages, edge: Edges, mask: npt.NDArray[np.uint8], left: int, top: int, rim: Array, width: float,
    limits: DepthLimits,
) -> tuple[Array, Mask]:  # fmt: skip
    """Return the depth along an outline, and where the object may go on beyond it.

    Args:
        depth: The frame's, see ``frame.depth_images``; both empty without depth or a camera.
        edge: Left, top, width, height of what is searched: an outline that reaches its edge may be cut there.
        mask: ``(h, w)`` uint8, C-contiguous.
        left: Image column of its first pixel.
        top: Image row of its first pixel.
        rim: ``(P, 2)`` pixels, clockwise as seen.
        width: Of the object, pixels: depth is read within a share of it.
        limits: See ``DepthLimits``.

    Returns:
        ``(P,)`` metres, all NaN if less than half of the outline has depth; ``(P,)`` whether the outline is that of
        something nearer that lies over the object, or of what is searched.
    """
    nearer, at_edge, share, least, most, min_depth, edge_reach = limits
    every = max(len(rim) // _WINDOWS, 1)
    (millimetres, metres), count = depth, -(-len(rim) // every)
    known = millimetres.size > 0 or metres.size > 0
    z, cut, flags = np.full(len(rim), np.nan), np.zeros(len(rim), np.bool_), np.zeros(count, np.bool_)
    for k in range(count):
        u, v = rim[k * every, 0], rim[k * every, 1]
        inside = edge[0] + at_edge < u < edge[0] + edge[2] - 1 - at_edge
        flags[k] = not (inside and edge[1] + at_edge < v < edge[1] + edge[3] - 1 - at_edge)
    if known:
        reach = int(min(max(round(width * share), least), most))
        under = np.empty(count)
        _read(depth, mask, left, top, rim, every, reach, min_depth, under)
        if bridged(under):
            steps = int(edge_reach)
            if millimetres.size > 0:
                _look_over(millimetres, MILLIMETRE, mask, left, top, rim, every, under, nearer, steps, flags)
            else:
                _look_over(metres, 1.0, mask, left, top, rim, every, under, nearer, steps, flags)
            for k in range(count):
                near, far = 1 / under[k], 1 / under[(k + 1) % count]
                between = min(every, len(rim) - k * every)
                for i in range(between):
                    z[k * every + i] = 1 / (near + (far - near) * i / between)
    for k in range(count):
        if flags[k] and (flags[k - 1] or flags[(k + 1) % count]):  # a single one is noise
            for i in range(-every // 2, every // 2 + 1):
                cut[(k * every + i) % len(rim)] = True
    return z, cut


@compiled
def _read(
    depth: DepthImages, mask: npt.NDArray[np.uint8], left: int, top: int, rim: Array, every: int, reach: int,
    least: float, out: Array,
) -> None:  # fmt: skip
    """Fill the depth under every few points of an outline, metres."""
    step = 2 if reach >= SPARSE else 1
    size = (2 * reach + 1) ** 2 // step + 1
    near, x, y, w, spare = room(size), room(size), room(size), room(size), room(size)
    for k in range(len(out)):
        u, v = rim[k * every, 0], rim[k * every, 1]
        inside, known = gather_depth(depth, mask, left, top, u, v, reach, step, near, x, y)
        out[k] = middle_depth(near, x, y, w, spare, known, max(least * inside, 1), True) * unit_of(depth)


@compiled
def _look_over(
    depth: npt.NDArray[Any], unit: float, mask: npt.NDArray[np.uint8], left: int, top: int, rim: Array, every: int,
    under: Array, nearer: float, steps: int, flags: Mask,
) -> None:  # fmt: skip
    """Mark where the first depth that is seen outside of an outline is nearer than the object."""
    count = len(under)
    for k in range(count):
        before, after = (k - 1) % count * every, (k + 1) % count * every
        u, v = rim[after, 0] - rim[before, 0], rim[after, 1] - rim[before, 1]
        reach = max((u * u + v * v) ** 0.5, 1e-9)
        at = rim[k * every, 0], rim[k * every, 1]
        way = u / reach, v / reach
        flags[k] = flags[k] or _covered(depth, unit, mask, left, top, at, way, under[k], nearer, steps)


@compiled
def _covered(
    depth: npt.NDArray[Any],
    unit: float,
    mask: npt.NDArray[np.uint8],
    left: int,
    top: int,
    at: Pair,
    way: Pair,
    z: float,
    nearer: float,
    steps: int,
) -> bool:
    """Return whether the first depth that is seen outside of an outline, which runs along ``way``, is nearer than z.

    So many steps of a pixel are looked at.
    """
    u, v = at
    for step in range(steps):
        x, y = (step + _OUTSIDE) * way[1], -(step + _OUTSIDE) * way[0]
        column, row = nearest_pixel(u + x), nearest_pixel(v + y)
        if not (0 <= row < depth.shape[0] and 0 <= column < depth.shape[1]):
            return False
        inside = 0 <= row - top < mask.shape[0] and 0 <= column - left < mask.shape[1]
        metres = depth[row, column] * unit
        if (inside and mask[row - top, column - left] != 0) or not 0 < metres < FARTHEST:
            continue
        column, row = nearest_pixel(u - x), nearest_pixel(v - y)
        if 0 <= row < depth.shape[0] and 0 <= column < depth.shape[1]:
            across = depth[row, column] * unit  # the object's own, so far inside: a table aslant goes on as it does
            if 0 < across < FARTHEST and 2 / z > 1 / across:
                z = min(z, 1 / (2 / z - 1 / across))
        if abs(metres - z) > nearer:
            return metres < z
    return False
