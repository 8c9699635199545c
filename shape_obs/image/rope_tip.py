"""The tips of a rope in a mask: go on from the last nodes of a chain along its strand to where it ends."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.image.connected_runs import near_mask

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]

# Pixels: what lies farther is ahead; the pixel on which one stands is not, however sums are rounded.
_AHEAD: Final = 1e-6
# In widths: how far to the side a pixel may lie to belong to the strand, and how far ahead; the strand goes on where a
# pixel lies beyond the third.
SIDE: Final = 0.75
REACH: Final = 1.5
_BEYOND: Final = 0.6
# In widths: the slice ahead that a step moves to the centre of; the length of the last piece, and the rest below which
# there is none.
MAX_STEPS: Final = 24
STEP_FROM: Final = 0.2
STEP_TO: Final = 0.6
LAST: Final = 0.6
LAST_REST: Final = 0.5
_TIGHTEST: Final = 1.25  # widths: the least diameter of a bend; what seems to turn faster is the corner of a tip
_THINNEST: Final = 3.0  # pixels: the least width that can be measured
# A rope thinner than the thinnest that can be measured is treated as if it were that wide, or the slices above would
# hold nothing. In units of that width: the shortest rest.
SHORTEST: Final = 1 / 12


@compiled("(f8[:,::1], u1[:,::1], i8, i8, f8)")
def extend_chain(nodes: Array, mask: Mask, left: int, top: int, width: float) -> Array:
    """Cut a chain of nodes where it hangs over the ends of a mask, and lengthen it to the tips of the rope.

    From the last node the way goes on along the strand: to the middle of a slice ahead while there is more, then to the
    middle of the last piece, and on as far as the rest is long.

    Args:
        nodes: ``(K, 2)`` image pixels, K >= 3.
        mask: ``(h, w)`` uint8, C-contiguous.
        left: Image column of its first pixel.
        top: Image row of its first pixel.
        width: The rope's width, pixels.

    Returns:
        ``(K', 2)`` pixels; the first and the last point lie on the tips.
    """
    thin, width = width < _THINNEST, max(width, _THINNEST)
    on = near_mask(mask, left, top, nodes, 1)
    first, last = 0, len(nodes) - 1
    while first < last and not on[first]:
        first += 1
    while first < last and not on[last]:
        last -= 1
    if last - first < 2:  # fewer than three nodes on the mask give no direction: all are kept
        first, last = 0, len(nodes) - 1
    head = _march(mask, left, top, nodes, first, 1, width, thin)
    tail = _march(mask, left, top, nodes, last, -1, width, thin)
    out, count = np.empty((len(head) + last - first + 1 + len(tail), 2)), 0
    for way, begin, stop, step in ((head, len(head) - 1, -1, -1), (nodes, first, last + 1, 1), (tail, 0, len(tail), 1)):
        for p in range(begin, stop, step):
            out[count, 0], out[count, 1] = way[p, 0], way[p, 1]
            count += 1
    return out


@compiled
def _march(mask: Mask, left: int, top: int, nodes: Array, end: int, inwards: int, width: float, thin: bool) -> Array:
    """Return the way from the end of a chain along its strand to the tip: ``(S, 2)``; the next node is ``inwards``."""
    next_u, next_v = nodes[end + inwards, 0], nodes[end + inwards, 1]
    hx, hy = nodes[end, 0] - next_u, nodes[end, 1] - next_v
    gx, gy = next_u - nodes[end + 2 * inwards, 0], next_v - nodes[end + 2 * inwards, 1]
    norm, other = max(np.sqrt(hx * hx + hy * hy), 1e-9), max(np.sqrt(gx * gx + gy * gy), 1e-9)
    hx, hy = _bend(hx / norm, hy / norm, gx / other, gy / other, 0.5)
    u, v = nodes[end, 0] - left, nodes[end, 1] - top
    edge = int(2 * (REACH * width + 2)) + 4
    seen = np.empty((edge * edge, 4))
    path, steps, rest = np.empty((MAX_STEPS + 1, 2)), 0, 0.0
    breadth = max(width / 4, 0.5)
    for _ in range(MAX_STEPS):
        count = _strand(mask, u, v, hx, hy, width, seen)
        inside, farthest, beyond = 0, 0.0, False
        for p in range(count):
            beyond |= seen[p, 2] > _BEYOND * width
            if abs(seen[p, 3]) <= breadth:
                inside += 1
                farthest = max(farthest, seen[p, 2])
        rest = farthest + 0.5 if count else 0.0
        if not thin:
            rest = min(inside / (2 * breadth), rest)
        if beyond:
            low, high = STEP_FROM * width, STEP_TO * width
        elif rest > LAST_REST * width:
            low, high = rest - LAST * width, np.inf
        else:
            break
        x = y = 0.0
        held = 0
        for p in range(count):
            if low < seen[p, 2] <= high:
                x, y, held = x + seen[p, 0], y + seen[p, 1], held + 1
        if held == 0:
            break
        x, y = x / held, y / held
        norm = np.sqrt(x * x + y * y)
        cx, cy = _turned(hx, hy, x, y, norm / (_TIGHTEST * width))
        hx, hy = _bend(cx, cy, hx, hy, 0.5)
        u, v = u + x, v + y
        path[steps, 0], path[steps, 1] = u + left, v + top
        steps += 1
    rest = max(rest, SHORTEST * _THINNEST)
    path[steps, 0], path[steps, 1] = u + left + hx * rest, v + top + hy * rest
    return path[: steps + 1]


@compiled
def _strand(mask: Mask, u: float, v: float, hx: float, hy: float, width: float, out: Array) -> int:
    """Find the pixels ahead that are connected with (u, v), as (x, y, along, side) rows of ``out``; return how many."""
    reach, aside = REACH * width + 2, SIDE * width
    across, down = aside * abs(hy), aside * abs(hx)  # the box around the strip ahead, within a square about (u, v)
    left = max(int(u + max(min(hx * 2 * reach, 0.0) - across, -reach)), 0)
    top = max(int(v + max(min(hy * 2 * reach, 0.0) - down, -reach)), 0)
    right = min(int(u + min(max(hx * 2 * reach, 0.0) + across, reach)) + 2, mask.shape[1])
    bottom = min(int(v + min(max(hy * 2 * reach, 0.0) + down, reach)) + 2, mask.shape[0])
    if right <= left or bottom <= top:
        return 0
    state = np.zeros((bottom - top, right - left), np.uint8)
    nearest, seed_row, seed_column = np.inf, -1, -1
    count, begin, end, whole = 0, 0, right - left, True
    for row in range(bottom - top):
        y = row + (top - v)
        first, last = -1, -1
        for column in range(right - left):
            if mask[row + top, column + left] == 0:
                continue
            x = column + (left - u)
            along, side = x * hx + y * hy, y * hx - x * hy
            if along <= _AHEAD or abs(side) > aside:
                continue
            state[row, column] = 1
            out[count, 0], out[count, 1], out[count, 2], out[count, 3] = x, y, along, side
            count += 1
            whole &= first < 0 or last == column - 1
            first, last = column if first < 0 else first, column
            if x * x + y * y < nearest:
                nearest, seed_row, seed_column = x * x + y * y, row, column
        if first >= 0:
            whole &= first <= end and last >= begin - 1 and end > 0
            begin, end = first, last + 1
        elif count:
            end = 0  # a row without pixels: none may follow
    # One row of pixels below the other, each touching the last, are connected; anything else has to be looked at.
    return count if whole or count == 0 else _connected(state, seed_row, seed_column, left - u, top - v, hx, hy, out)


@compiled
def _connected(state: Mask, row: int, column: int, left: float, top: float, hx: float, hy: float, out: Array) -> int:
    """Find the pixels of ``state`` that are connected with one of them, as rows of ``out``; return how many."""
    height, width = state.shape
    stack = np.empty((state.size, 2), np.int32)
    stack[0, 0], stack[0, 1] = row, column
    state[row, column] = 2
    waiting, count = 1, 0
    while waiting:
        waiting -= 1
        row, column = stack[waiting, 0], stack[waiting, 1]
        x, y = column + left, row + top
        out[count, 0], out[count, 1] = x, y
        out[count, 2], out[count, 3] = x * hx + y * hy, y * hx - x * hy
        count += 1
        for r in range(max(row - 1, 0), min(row + 2, height)):
            for c in range(max(column - 1, 0), min(column + 2, width)):
                if state[r, c] == 1:
                    state[r, c] = 2
                    stack[waiting, 0], stack[waiting, 1] = r, c
                    waiting += 1
    return count


@compiled
def _turned(hx: float, hy: float, x: float, y: float, most: float) -> tuple[float, float]:
    """Return the unit vector h turned towards (x, y), by no more than an angle in radians."""
    along, side = hx * x + hy * y, hx * y - hy * x
    angle = min(max(math.atan2(side, along), -most), most)
    cosine, sine = math.cos(angle), math.sin(angle)
    return hx * cosine - hy * sine, hx * sine + hy * cosine


@compiled
def _bend(dx: float, dy: float, px: float, py: float, share: float) -> tuple[float, float]:
    """Return the unit vector of d + share (d - p), both unit vectors; d if that vanishes."""
    x, y = dx + share * (dx - px), dy + share * (dy - py)
    norm = np.sqrt(x * x + y * y)
    return (x / norm, y / norm) if norm > 1e-9 else (dx, dy)


@compiled
def rims_of(points: Array, arc: Array, log_depth: Array, width: float) -> tuple[float, float]:
    """Return how far the rims of both ends of a rope reach beyond the tips of its axis, pixels.

    The round end of a tube of width w that is k times as long in space as in the image reaches w/2 (1 - 1/k) farther.
    """
    last = len(arc) - 1
    inner, outer = last, 0
    while arc[inner] > width:
        inner -= 1
    while arc[outer] < arc[last] - width:
        outer += 1
    return _rim(points, log_depth, 0, inner, width), _rim(points, log_depth, last, outer, width)


@compiled
def _rim(points: Array, log_depth: Array, tip: int, inner: int, width: float) -> float:
    flat = math.hypot(points[inner, 0] - points[tip, 0], points[inner, 1] - points[tip, 1])
    return width / 2 * (1 - 1 / math.hypot(1.0, (log_depth[inner] - log_depth[tip]) / max(flat, 1e-9)))


@compiled
def without_ends(
    points: Array, arc: Array, flags: Flags, metres: Array, log_depth: Array, head: float, tail: float
) -> tuple[Array, Array, Flags, Array, Array]:
    """Return a curve without so much of both of its ends, in units of its arc length in the image.

    What is cut off is as long in metres as it is where the curve is seen least aslant, or less.

    Args:
        points: ``(P, 2)``.
        arc: ``(P,)`` its arc length.
        flags: ``(P,)``.
        metres: ``(P,)`` its arc length in space.
        log_depth: ``(P,)``.
        head: Off the start.
        tail: Off the end.
    """
    last, first, stop = len(arc) - 1, 1, len(arc) - 1
    while first < last and arc[first] <= head:
        first += 1
    while stop > first and arc[stop - 1] >= arc[last] - tail:
        stop -= 1
    count, least = stop - first + 2, np.inf
    at, line, kept = np.empty(count), np.empty((len(arc), 4)), np.empty(count, np.bool_)
    for p in range(len(arc)):
        line[p, 0], line[p, 1], line[p, 2], line[p, 3] = points[p, 0], points[p, 1], metres[p], log_depth[p]
        if p > 0:
            least = min(least, (metres[p] - metres[p - 1]) / max(arc[p] - arc[p - 1], 1e-9))
    at[0], at[count - 1], kept[0], kept[count - 1] = head, arc[last] - tail, flags[0], flags[last]
    for p in range(first, stop):
        at[p - first + 1], kept[p - first + 1] = arc[p], flags[p]
    found = interpolate(line, arc, at)
    found[0, 2] = min(head * least, found[0, 2])
    found[count - 1, 2] = max(metres[last] - tail * least, found[count - 1, 2])
    shorter, along, deep = np.empty((count, 2)), np.empty(count), np.empty(count)
    for p in range(count):
        shorter[p, 0], shorter[p, 1], deep[p] = found[p, 0], found[p, 1], found[p, 3]
        along[p] = found[p, 2] - found[0, 2]
    return shorter, arc_length(shorter), kept, along, deep
