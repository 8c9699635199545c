"""The depth under a point: the median of the object's pixels around it, measured from a plane where it slopes."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.frame import DEPTH_TYPE, FARTHEST, DepthImages, unit_of
from shape_obs.image.connected_runs import nearest_pixel

Array = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]
Mask = npt.NDArray[np.uint8]

MIN_SHARE: Final = 0.25  # of the mask pixels around a point, that must carry depth
MAX_REACH: Final = 6  # pixels: what is wider is no rope, and its depth is its own at every place
SPARSE: Final = 4  # pixels: from this reach on every second pixel is enough
_ENOUGH: Final = 6  # pixels with depth that make a plane
_IN_LINE: Final = 0.01  # of the squared spread: below it pixels lie in a line
_ROUNDS: Final = 3
_OFF_PLANE: Final = 3.0  # median distances from the plane: what lies farther off belongs to something else
_ABSURD: Final = 1e3  # times nearer than the median: products of greater numbers would overflow
_LANES: Final = 64  # numbers that a processor compares at once, or a multiple of that
_ROUGHLY: Final = 1 << 18  # steps of the last bit: 3 %
_NEARLY: Final = 1 << 6  # 1e-5
_MOST: Final = np.int32(2**31 - 1)
_ONE: Final = np.float32(1)


@compiled("(" + DEPTH_TYPE + ", u1[:,::1], i8, i8, f8[:,::1], i8, f8, b1)")
def median_depth(
    depth: DepthImages,
    mask: Mask,
    left: int,
    top: int,
    points: Array,
    reach: int,
    min_share: float,
    sloped: bool,
) -> tuple[Array, Array]:
    """Return the median depth of the mask around each point, and where it was measured.

    At a border the mask lies on one side of the point, and the median of a tilted sheet would be the depth some pixels
    inside: it is measured from a plane through the depth there. The slope comes from the least squares of the inverse
    depth, which is linear in the pixel on a plane, without what lies far off it.

    Args:
        depth: The frame's, see ``frame.depth_images``; 0, negative, non-finite or absurd = invalid.
        mask: ``(h, w)`` uint8, C-contiguous.
        left: Image column of its first pixel.
        top: Image row of its first pixel.
        points: ``(N, 2)`` image pixels.
        reach: How far around a point is looked, pixels; for a slope, from 4 on, at every second one as on a chessboard.
        min_share: Of the mask's pixels there, that must have a valid depth.
        sloped: Whether the depth is measured from a plane; a rope is too narrow to have one.

    Returns:
        ``(N,)`` metres, NaN where too few have; ``(N, 2)`` image pixels, the mean place of those that have depth, and
        the point itself if the depth is measured from a plane.
    """
    step, size = 2 if sloped and reach >= SPARSE else 1, (2 * reach + 1) ** 2
    size = size // step + 1
    out, places = np.empty(len(points)), np.empty_like(points)
    near, x, y, w, spare = room(size), room(size), room(size), room(size), room(size)
    for n in range(len(points)):
        places[n, 0], places[n, 1] = points[n, 0], points[n, 1]
        inside, known = gather_depth(depth, mask, left, top, points[n, 0], points[n, 1], reach, step, near, x, y)
        out[n] = middle_depth(near, x, y, w, spare, known, max(min_share * inside, 1), sloped) * unit_of(depth)
        if not sloped and out[n] > 0:
            for k in range(known):
                places[n, 0] += x[k] / known
                places[n, 1] += y[k] / known
    return out, places


@compiled
def gather_depth(
    depth: DepthImages, mask: Mask, left: int, top: int, at_u: float, at_v: float, reach: int, step: int,
    near: Floats, x: Floats, y: Floats,
) -> tuple[int, int]:  # fmt: skip
    """Gather the valid depth of a mask around a point, and where it lies from there.

    Args:
        depth: As ``median_depth`` takes it, and the next three.
        mask: Uint8.
        left: Image column.
        top: Image row.
        at_u: Of the point, image pixels.
        at_v: The same.
        reach: Pixels.
        step: 1 for every pixel, 2 for every second one as on a chessboard.
        near: In ``room``, is filled with the depth as it is stored, whose median is found sooner than that of metres.
        x: Is filled with pixels from the point.
        y: The same.

    Returns:
        How many pixels of the mask there are, and how many of them have depth.
    """
    height, width = mask.shape
    column, row, (millimetres, metric) = nearest_pixel(at_u) - left, nearest_pixel(at_v) - top, depth
    whole, unit = len(millimetres) > 0, np.float32(unit_of(depth))
    inside = known = 0
    for v in range(max(row - reach, 0), min(row + reach + 1, height)):
        y_here = np.float32(v + top - at_v)
        for u in range(column - reach + (v - row & 1) * (step - 1), min(column + reach + 1, width), step):
            if u >= 0 and mask[v, u] != 0:
                inside += 1
                near[known] = np.float32(millimetres[v + top, u + left]) if whole else metric[v + top, u + left]
                x[known], y[known] = u + left - at_u, y_here
                known += 0 < near[known] * unit < FARTHEST  # the next one overwrites what is not valid
    return inside, known


@compiled
def middle_depth(
    near: Floats, x: Floats, y: Floats, w: Floats, spare: Floats, known: int, least: float, sloped: bool
) -> float:
    """Return the depth at a point by the depth around it, in its unit; NaN if less than ``least`` pixels have any.

    Args:
        near: What ``gather_depth`` has filled, as are the next two.
        x: Pixels.
        y: Pixels.
        w: In ``room``, is overwritten.
        spare: The same.
        known: How many pixels have depth.
        least: How many must have.
        sloped: Whether the depth is measured from a plane.
    """
    if known < least:
        return np.nan
    middle = median(near, known)
    if not sloped or known < _ENOUGH:
        return middle
    for k in range(known):
        w[k] = min(middle / near[k] - 1, _ABSURD)
    return middle / _over_plane(x, y, w, spare, known)


@compiled
def _over_plane(x: Floats, y: Floats, w: Floats, spare: Floats, count: int) -> float:
    """Return the inverse depth at the origin of a plane through some depths, as a share of that of their median.

    Args:
        x: ``(K,)`` pixels, in ``room``; numbers behind the first ``count`` are of no account.
        y: ``(K,)`` pixels.
        w: ``(K,)`` how much greater the inverse depths are than that of the median, as a share of it.
        spare: ``(K,)`` is overwritten.
        count: How many are known.
    """
    slope_x = slope_y = level = np.float32(0)
    lanes, before = -(-count // _LANES) * _LANES, -1.0
    for step in range(_ROUNDS):
        _plane_misses(x, y, w, spare, lanes, slope_x, slope_y, level)
        limit = np.float32(max(_OFF_PLANE * median(spare, count, _ROUGHLY), 1e-6))
        n, u, v, away, xx, xy, yy, xw, yw = _moments(x, y, w, spare, count, limit)
        if step == 0 and _is_line(n, xx, xy, yy):  # the next column of pixels on a steep plane lies as far off
            n, u, v, away, xx, xy, yy, xw, yw = _moments(x, y, w, spare, count, np.float32(np.inf))
        if _is_line(n, xx, xy, yy):  # no slope across it, but that of the step before
            break
        spread = xx * yy - xy * xy
        slope_x, slope_y = np.float32((xw * yy - yw * xy) / spread), np.float32((yw * xx - xw * xy) / spread)
        level = np.float32(away - slope_x * u - slope_y * v)
        if n == before:  # the same pixels lie on it
            break
        before = n
    for k in range(count):
        spare[k] = max(w[k] + _ONE - slope_x * x[k] - slope_y * y[k], np.float32(0))
    return max(median(spare, count, _NEARLY), 0.5)


@compiled(reassociate=True)
def _plane_misses(
    x: Floats, y: Floats, w: Floats, out: Floats, count: int, slope_x: np.float32, slope_y: np.float32,
    level: np.float32,
) -> None:  # fmt: skip
    for k in range(count):
        out[k] = abs(w[k] - level - slope_x * x[k] - slope_y * y[k])


@compiled(reassociate=True)
def _moments(x: Floats, y: Floats, w: Floats, misses: Floats, count: int, limit: np.float32) -> tuple[float, ...]:
    """Return how many points miss a plane by no more, their means of x, y, w, and the sums of xx, xy, yy, xw, yw."""
    n = sx = sy = sxx = sxy = syy = sw = sxw = syw = np.float32(0)
    for k in range(count):
        one = _ONE if misses[k] <= limit else np.float32(0)
        n, sx, sy, sw = n + one, sx + one * x[k], sy + one * y[k], sw + one * w[k]
        sxx, sxy, syy = sxx + one * x[k] * x[k], sxy + one * x[k] * y[k], syy + one * y[k] * y[k]
        sxw, syw = sxw + one * x[k] * w[k], syw + one * y[k] * w[k]
    some = max(float(n), 1.0)
    u, v, away = sx / some, sy / some, sw / some
    return float(n), u, v, away, sxx - sx * u, sxy - sx * v, syy - sy * v, sxw - u * sw, syw - v * sw


@compiled
def _is_line(n: float, xx: float, xy: float, yy: float) -> bool:
    """Return whether points are too few for a plane, or lie in a line."""
    return n < _ENOUGH or xx * yy - xy * xy <= _IN_LINE * (xx + yy) ** 2


@compiled
def room(count: int) -> Floats:
    """Return room for ``count`` numbers and what ``median`` needs in addition, zeros."""
    return np.zeros((count // _LANES + 2) * _LANES, np.float32)


@compiled
def median(values: Floats, count: int, within: int = 1) -> float:
    """Return the median of the first ``count`` values, by halving the interval in which it lies.

    Numbers that are not negative are ordered as their bits are, read as whole numbers. Each step counts how many lie
    below, which a processor does for many at once. Depth in whole units leaves the last bits zero: fewer steps.

    Args:
        values: ``(K,)`` single precision, not negative, in ``room``; what is behind the first ``count`` is overwritten.
        count: At least 1.
        within: Steps of the last bit by which the result may be off; with 1 the median is exact.
    """
    bits, last = values.view(np.int32), len(values) - 1
    some = bits[: -(-count // _LANES) * _LANES]
    low, high, used = bits[0], bits[0], bits[0]
    for k in range(count):
        low, high, used = min(low, bits[k]), max(high, bits[k]), used | bits[k]
    for k in range(count, len(some)):
        some[k] = _MOST
    step, most = max(used & -used, within), count
    while high - low >= step:
        middle = low + (high - low) // 2
        below = _at_most(some, middle)
        if 2 * below >= count:
            high, most = middle, below
        else:
            low = middle + 1
    high = high // step * step
    above = high
    if 2 * most == count:  # half of them: the mean of the two in the middle
        above = _MOST
        for k in range(count):
            if bits[k] > high:
                above = min(above, bits[k])
    bits[last] = high
    lower = float(values[last])
    bits[last] = above
    return (lower + float(values[last])) / 2


@compiled
def _at_most(bits: npt.NDArray[np.int32], limit: int) -> int:
    count = np.int32(0)
    for k in range(len(bits)):
        count += np.int32(bits[k] <= limit)
    return int(count)


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
