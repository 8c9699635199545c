"""From pixels to metres: robust local depth under each point."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs.compiled import compiled
from shape_obs.frame import FARTHEST, readable_depth
from shape_obs.geometry.curve import FittedCurve, FittedForm
from shape_obs.geometry.lattice import FittedLattice
from shape_obs.image.connected_runs import nearest_pixel
from shape_obs.image.region import Region

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]

MIN_SHARE: Final = 0.25  # of the mask pixels around a point, that must carry depth
SMEARED: Final = 2.5  # widths next to a hidden piece, in which depth may be that of what hides it
COMPARED: Final = 6.0  # widths within which the rope's own depth is looked for
STEP: Final = 0.015  # metres: no rope on a table comes nearer by this much within a few widths
_SPARSE: Final = 4  # pixels: from this reach on every second pixel is enough
_ENOUGH: Final = 6  # pixels with depth that make a plane
_IN_LINE: Final = 0.01  # of the squared spread: below it pixels lie in a line
_ROUNDS: Final = 3
_OFF_PLANE: Final = 3.0  # median distances from the plane: what lies farther off belongs to something else
MAX_REACH: Final = 6  # pixels: what is wider is no rope, and its depth is its own at every place


def form_depth(form: FittedForm, depth: npt.NDArray[Any], region: Region, width: float) -> Array:
    """Return ``(P,)`` metres under a form, NaN where it is not known or belongs to something that lies over it.

    Under a lattice every third row and column is read.

    Looks at the middle half of the object's width (13 pixels at most), so that a round rope's flanks do not pull the
    median down, and at mask pixels only, so that the table does not either. Where fewer than a quarter of these carry
    depth, a hole stays a hole.

    Args:
        form: ``(P, 2)`` pixels.
        depth: ``(H, W)`` the frame's depth.
        region: The mask.
        width: The object's width, pixels.
    """
    readable, unit = readable_depth(depth)
    left, top = region.window[:2]
    reach = min(max(round(width / 4), 1), MAX_REACH)
    points = np.ascontiguousarray(form.points, dtype=np.float64)
    where = readable, unit, region.mask, left, top
    if isinstance(form, FittedLattice):
        (rows, down), (cols, right) = _some(form.rows), _some(len(points) // form.rows)
        some = np.ascontiguousarray(form.lattice[np.ix_(rows, cols)].reshape(-1, 2))
        read = median_depth(*where, some, reach, MIN_SHARE, True).reshape(len(rows), -1)
        known = np.isfinite(read)
        share = down @ known @ right.T
        z = down @ np.where(known, read, 0) @ right.T / np.maximum(share, 1e-9)
        return np.where(share > 0.5, z, np.nan).ravel()
    z = median_depth(*where, points, reach, MIN_SHARE, not is_rope(form))
    if isinstance(form, FittedCurve) and not form.whole:
        z[form.interpolated | overlaid(form, z, width)] = np.nan
    return z


@lru_cache(maxsize=16)
def _some(count: int) -> tuple[npt.NDArray[np.int64], Array]:
    """Return every third row of ``count`` and the last, ``(S,)``, and how all follow from them, ``(count, S)``."""
    nodes = np.unique(np.append(np.arange(0, count, 3), count - 1))
    return nodes, np.stack([np.interp(np.arange(count), nodes, each) for each in np.eye(len(nodes))], axis=1)


def is_rope(form: FittedForm) -> bool:
    """Return whether a form is an open curve: the depth under it does not slope across it."""
    return isinstance(form, FittedCurve) and not form.closed


def lift_form(form: FittedForm, z: Array, intrinsics: Intrinsics) -> Array | None:
    """Return a whole form in space, for measuring distances in metres.

    Holes are bridged and the depth is smoothed over a few points (millimetre steps would make the form longer than it
    is); the points that leave the detector are lifted again.

    Args:
        form: ``(P, 2)`` pixels.
        z: ``(P,)`` metres, as ``form_depth`` gives them.
        intrinsics: The projection.

    Returns:
        ``(P, 3)`` metres, or None where less than half of the form has depth, or the lens has no ray to some of it.
    """
    known = np.isfinite(z)
    if known.mean() < 0.5:
        return None
    points = intrinsics.deproject(form.points, form.smoothed(z, known))
    return points if np.isfinite(points).all() else None


def overlaid(curve: FittedCurve, metres: Array, width: float) -> npt.NDArray[np.bool_]:
    """Return where the depth next to a hidden piece is that of what hides it, and not the curve's own.

    The camera's two eyes see past an edge differently, and depth is smeared there: it is compared with that of the
    curve a little further away.

    Args:
        curve: ``(P, D)`` pixels, with hidden pieces.
        metres: ``(P,)`` depth under it; NaN where it is not known.
        width: Of the rope, pixels.

    Returns:
        ``(P,)`` bool.
    """
    arc = curve.arc[: len(metres)]
    away = arc[:, None] - arc
    if curve.closed:
        away = (away + curve.size / 2) % curve.size - curve.size / 2
    apart = np.abs(away)
    nearby = apart[:, curve.interpolated].min(axis=1) <= SMEARED * width
    own = np.where(nearby | curve.interpolated, np.nan, metres)
    over = np.zeros(len(metres), bool)
    for at in np.flatnonzero(nearby & ~curve.interpolated & np.isfinite(metres)):
        near = (apart[at] <= COMPARED * width) & np.isfinite(own)
        if near.any():
            over[at] = metres[at] < nearest_expected(-away[at, near], own[near], 0.0) - STEP
        elif np.isfinite(own).any():
            over[at] = metres[at] < np.nanmedian(own) - STEP
    return over


@compiled("(f8[::1], f8[::1], f8)")
def nearest_expected(arc: Array, metres: Array, at: float) -> float:
    """Return the least depth that a rope may have at a place, by its depth a little further away.

    Args:
        arc: ``(K,)`` arc positions, pixels; at least one.
        metres: ``(K,)`` depth there.
        at: The place. The rope may go on as level as it is, or as steeply.
    """
    level, middle, mean = median_of(metres.copy(), len(metres)), arc.mean(), metres.mean()
    spread = slope = 0.0
    for k in range(len(arc)):
        spread += (arc[k] - middle) ** 2
        slope += (arc[k] - middle) * (metres[k] - mean)
    return min(level, mean + slope / spread * (at - middle)) if spread > 0 else level


@compiled(
    "(Array(u2, 2, 'C', readonly=True), f8, u1[:,::1], i8, i8, f8[:,::1], i8, f8, b1)",
    "(Array(f4, 2, 'C', readonly=True), f8, u1[:,::1], i8, i8, f8[:,::1], i8, f8, b1)",
)
def median_depth(
    depth: npt.NDArray[Any],
    unit: float,
    mask: Mask,
    left: int,
    top: int,
    points: Array,
    reach: int,
    min_share: float,
    sloped: bool,
) -> Array:
    """Return the median depth of the mask around each point, measured from a plane through the depth there.

    At a border the mask lies on one side of the point, and the median of a tilted sheet would be the depth some pixels
    inside. The slope comes from the least squares of the inverse depth, which is linear in the pixel on a plane,
    without what lies far off it.

    Args:
        depth: ``(H, W)`` read-only, uint16 or float32; 0, negative, non-finite or absurd = invalid.
        unit: Metres in a unit of depth.
        mask: ``(h, w)`` uint8, C-contiguous.
        left: Image column of its first pixel.
        top: Image row of its first pixel.
        points: ``(N, 2)`` image pixels.
        reach: How far around a point is looked, pixels; for a slope, from 4 on, at every second one as on a chessboard.
        min_share: Of the mask's pixels there, that must have a valid depth.
        sloped: Whether the depth may slope; a rope is too narrow for that, and lies on both sides of its points.

    Returns:
        ``(N,)`` metres, NaN where too few have.
    """
    height, width = mask.shape
    step = 2 if sloped and reach >= _SPARSE else 1
    out, near = np.empty(len(points)), np.empty((2 * reach + 1) ** 2)
    x, y, z = np.empty_like(near), np.empty_like(near), np.empty_like(near)
    for n in range(len(points)):
        out[n] = np.nan
        column, row = nearest_pixel(points[n, 0]) - left, nearest_pixel(points[n, 1]) - top
        inside = known = 0
        for v in range(max(row - reach, 0), min(row + reach + 1, height)):
            for u in range(column - reach + (v - row & 1) * (step - 1), min(column + reach + 1, width), step):
                if u >= 0 and mask[v, u] != 0:
                    inside += 1
                    metres = depth[v + top, u + left] * unit
                    if 0 < metres < FARTHEST:
                        x[known], y[known] = u + left - points[n, 0], v + top - points[n, 1]
                        z[known] = near[known] = metres
                        known += 1
        if known >= max(min_share * inside, 1):
            middle = median_of(near, known)
            out[n] = _over_plane(x, y, z, near, known, middle) if sloped and known >= _ENOUGH else middle
    return out


@compiled
def _over_plane(x: Array, y: Array, z: Array, spare: Array, count: int, middle: float) -> float:
    """Return the depth at the origin of a plane through the first ``count`` of some depths: their median above it.

    Args:
        x: ``(K,)`` pixels.
        y: ``(K,)`` pixels.
        z: ``(K,)`` metres.
        spare: ``(K,)`` is overwritten.
        count: How many are known.
        middle: Their median.
    """
    slope_x = slope_y = level = 0.0
    for _ in range(_ROUNDS):
        for k in range(count):
            spare[k] = abs(middle / z[k] - 1 - level - slope_x * x[k] - slope_y * y[k])
        limit = max(_OFF_PLANE * median_of(spare, count), 1e-6)
        n = sx = sy = sxx = sxy = syy = sw = sxw = syw = 0.0
        for k in range(count):
            w = middle / z[k] - 1
            if abs(w - level - slope_x * x[k] - slope_y * y[k]) <= limit:
                n += 1
                sx += x[k]
                sy += y[k]
                sxx += x[k] * x[k]
                sxy += x[k] * y[k]
                syy += y[k] * y[k]
                sw += w
                sxw += x[k] * w
                syw += y[k] * w
        if n < _ENOUGH:
            return middle
        sxx, sxy, syy = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
        sxw, syw = sxw - sx * sw / n, syw - sy * sw / n
        spread = sxx * syy - sxy * sxy
        if spread <= _IN_LINE * (sxx + syy) ** 2:
            return middle  # no slope across a line of pixels
        slope_x, slope_y = (sxw * syy - syw * sxy) / spread, (syw * sxx - sxw * sxy) / spread
        level = (sw - slope_x * sx - slope_y * sy) / n
    for k in range(count):
        spare[k] = middle / z[k] - slope_x * x[k] - slope_y * y[k]
    return middle / max(median_of(spare, count), 0.5)


@compiled
def median_of(values: Array, count: int) -> float:
    """Return the median of the first ``count`` values, which are reordered (C. A. R. Hoare, "Find", CACM 4, 1961)."""
    low, high, half = 0, count - 1, count // 2
    while low < high:
        pivot, i, j = values[half], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        low, high = (i if j < half else low), (j if half < i else high)
    if count % 2:
        return values[half]
    below = values[0]
    for k in range(1, half):
        below = max(below, values[k])
    return (below + values[half]) / 2


@compiled
def bridged(z: Array) -> bool:
    """Fill the gaps of values around a ring by straight lines of their inverse; return False if most are unknown."""
    count, first, known = len(z), -1, 0
    for k in range(count):
        if z[k] > 0:
            first, known = k if first < 0 else first, known + 1
    if known < 0.5 * count:
        return False
    last = first
    for step in range(1, count + 1):
        k = (first + step) % count
        if z[k] > 0:
            gap = (k - last - 1) % count + 1
            for i in range(1, gap):
                z[(last + i) % count] = 1 / (1 / z[last] + (1 / z[k] - 1 / z[last]) * i / gap)
            last = k
    return True
