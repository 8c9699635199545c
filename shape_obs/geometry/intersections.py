"""Find where polylines cross each other and themselves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.crossings import Crossing

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

# As shares of the extent of all curves: vertices are moved by up to the first, so that no three lie on one line;
# strands that come this near to each other, or to a tip, touch without crossing.
_NUDGE: Final = 1e-9
_TOUCH: Final = 1e-5
_BLOCK: Final = 8  # pieces of a polyline with a common bounding box


def find_crossings(curves: Sequence[npt.ArrayLike], names: Sequence[str] | None = None) -> tuple[Crossing, ...]:
    """Return where polylines cross each other and themselves, by the first curve and the place on it.

    A crossing at a vertex is found once. Strands that touch without crossing, and tips that lie on a strand, are not
    crossings: vertices are moved by a millionth of a pixel, in an image of a thousand pixels, and crossings that
    cancel within a hundredth of a pixel are dropped. Where strands run exactly on each other, they cross an odd
    number of times somewhere on the common stretch if they leave it on other sides, else an even number of times.

    Args:
        curves: ``(P, 2)`` pixels each, open. A curve with fewer than two points crosses nothing.
        names: Of the shapes, as ``Crossing.slots`` holds them; their positions in ``curves`` by default.

    Raises:
        ValueError: A curve is not finite or not ``(P, 2)``, or ``names`` has another length.
    """
    lines = [np.ascontiguousarray(curve, dtype=np.float64) for curve in curves]
    names = [str(k) for k in range(len(lines))] if names is None else names
    if len(names) != len(lines):
        raise ValueError(f"names: expected {len(lines)}, one for each curve, got {len(names)}.")
    for name, line in zip(names, lines, strict=True):
        if line.ndim != 2 or line.shape[1] != 2 or not np.isfinite(line).all():
            raise ValueError(f"curve {name!r} must be finite, of shape (P, 2), got shape {line.shape}.")
    return crossings_of(lines, names) if lines else ()


def crossings_of(lines: Sequence[Array], names: Sequence[str]) -> tuple[Crossing, ...]:
    """Return what ``find_crossings`` does, of at least one curve, finite and stored row by row."""
    starts = [0]
    for line in lines:
        starts.append(starts[-1] + len(line))
    table = crossing_table(lines[0] if len(lines) == 1 else np.concatenate(lines), np.array(starts, np.int64))
    if not len(table):
        return ()
    return tuple(
        Crossing((names[int(i)], names[int(j)]), (first, second), (u, v), None, int(hand))
        for i, first, j, second, u, v, hand in sorted(table.tolist())
    )


@compiled("(f8[:,::1], i8[::1])")
def crossing_table(points: Array, starts: Indices) -> Array:
    """Return the crossings of polylines: curve, share, curve, share, u, v, handedness: ``(C, 7)``.

    Args:
        points: ``(P, 2)`` of all curves.
        starts: ``(K + 1,)`` where each curve begins in ``points``, and the end.
    """
    extent = 0.0
    for d in range(2):
        for p in range(len(points)):
            extent = max(extent, abs(points[p, d] - points[0, d]))
    node, arc, owner, length = _general_position(points, starts, extent)
    begin, end, box = _blocks(node, owner)
    found, size = np.empty((16, 7)), 0
    for a in range(len(begin)):
        for b in range(a, len(begin)):
            if box[a, 0] > box[b, 2] or box[b, 0] > box[a, 2] or box[a, 1] > box[b, 3] or box[b, 1] > box[a, 3]:
                continue
            p, q = owner[begin[a]], owner[begin[b]]
            for i in range(begin[a], end[a]):
                x, y = node[i, 0], node[i, 1]
                du, dv = node[i + 1, 0] - x, node[i + 1, 1] - y
                for j in range(max(begin[b], i + 2) if p == q else begin[b], end[b]):
                    # The sides of piece i on which the ends of piece j lie, then the other way round.
                    u, v = node[j, 0] - x, node[j, 1] - y
                    far_u, far_v = node[j + 1, 0] - x, node[j + 1, 1] - y
                    near, far = du * v - dv * u, du * far_v - dv * far_u
                    if (near > 0) == (far > 0):
                        continue
                    area = far - near
                    share = (u * (far_v - v) - v * (far_u - u)) / area
                    if not 0 <= share < 1:
                        continue
                    if size == len(found):
                        found = np.concatenate((found, np.empty_like(found)))
                    found[size, 0], found[size, 2] = p, q
                    found[size, 1] = (arc[i] + share * (arc[i + 1] - arc[i])) / length[p]
                    found[size, 3] = (arc[j] - near / area * (arc[j + 1] - arc[j])) / length[q]
                    found[size, 4], found[size, 5] = x + share * du, y + share * dv
                    found[size, 6] = 1.0 if area > 0 else -1.0
                    size += 1
    return _without_touches(found[:size], length, _TOUCH * extent)


@compiled
def _general_position(points: Array, starts: Indices, extent: float) -> tuple[Array, Array, Indices, Array]:
    """Return vertices in general position, their arc lengths and curves, and the length of each curve."""
    node, arc, owner = np.empty((len(points), 2)), np.empty(len(points)), np.empty(len(points), np.int64)
    length = np.zeros(len(starts) - 1)
    size, lot = 0, 1
    for k in range(len(length)):
        along = last = 0.0
        for p in range(starts[k], starts[k + 1]):
            if p > starts[k]:
                along += np.hypot(points[p, 0] - points[p - 1, 0], points[p, 1] - points[p - 1, 1])
                if along - last <= _TOUCH * extent:
                    continue
            for d in range(2):
                lot = (lot * 1103515245 + 12345) % 2147483648
                node[size, d] = points[p, d] + _NUDGE * extent * (lot / 2147483648)
            arc[size], owner[size], last = along, k, along
            size += 1
        length[k] = along
    return node[:size], arc[:size], owner[:size], length


@compiled
def _blocks(node: Array, owner: Indices) -> tuple[Indices, Indices, Array]:
    """Return the first pieces of each block, those after the last, and boxes: low u, low v, high u, high v."""
    begin, end = np.empty(len(node), np.int64), np.empty(len(node), np.int64)
    box = np.empty((len(node), 4))
    size = -1
    for p in range(len(node) - 1):
        if owner[p] != owner[p + 1]:
            continue
        if size < 0 or end[size] < p or p - begin[size] == _BLOCK:
            size += 1
            begin[size] = p
            for d in range(2):
                box[size, d] = box[size, 2 + d] = node[p, d]
        end[size] = p + 1
        for d in range(2):
            box[size, d] = min(box[size, d], node[p + 1, d])
            box[size, 2 + d] = max(box[size, 2 + d], node[p + 1, d])
    return begin[: size + 1], end[: size + 1], box[: size + 1]


@compiled
def _without_touches(found: Array, length: Array, near: float) -> Array:
    """Return the crossings without those at a tip and without pairs that cancel."""
    keep = np.ones(len(found), np.bool_)
    for c in range(len(found)):
        for side in (1, 3):
            whole = length[int(found[c, side - 1])]
            along = found[c, side] * whole
            keep[c] &= near < along < whole - near
    for c in range(len(found)):
        for d in range(c):
            if not keep[c] or not keep[d] or found[c, 6] == found[d, 6]:
                continue
            if found[c, 0] != found[d, 0] or found[c, 2] != found[d, 2]:
                continue
            first, second = length[int(found[c, 0])], length[int(found[c, 2])]
            if abs(found[c, 1] - found[d, 1]) * first < near and abs(found[c, 3] - found[d, 3]) * second < near:
                keep[c] = keep[d] = False
    return found[keep]
