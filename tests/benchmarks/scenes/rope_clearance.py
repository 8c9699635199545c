"""Find the crossings of the axes of ropes, and whether the ropes keep their distance everywhere else."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import cdist

from tests.benchmarks.scenes.rope_proposals import GAP, Meeting, Table
from tests.benchmarks.scenes.ropes import Curve

TIGHTEST: Final = 1.5  # the smallest bend radius in widths
_STRIDE: Final = 6  # points from one vertex to the next of the polylines that are intersected
_COARSE: Final = 3  # points from one to the next where distances are compared
# In widths:
_APART: Final = 2.0  # the smallest distance of crossings
_TIP: Final = 2.0  # the smallest distance of a tip from the axis of another strand


def intersections(one: Curve, other: Curve) -> list[tuple[float, float, Curve, float]]:
    """Return where two curves with steps of about a pixel intersect: both indices, the place and the acute angle.

    Of a curve with itself every intersection is returned once.
    """
    at, at_other = (np.append(np.arange(0, len(c) - 1, _STRIDE), len(c) - 1) for c in (one, other))
    start, begin = one[at[:-1]], other[at_other[:-1]]
    step, stride = np.diff(one[at], axis=0), np.diff(other[at_other], axis=0)
    offset = begin[None] - start[:, None]
    area = step[:, None, 0] * stride[None, :, 1] - step[:, None, 1] * stride[None, :, 0]
    area = np.where(np.abs(area) < 1e-12, np.inf, area)
    along = (offset[..., 0] * stride[None, :, 1] - offset[..., 1] * stride[None, :, 0]) / area
    along_other = (offset[..., 0] * step[:, None, 1] - offset[..., 1] * step[:, None, 0]) / area
    hit = (along >= 0) & (along < 1) & (along_other >= 0) & (along_other < 1)
    if one is other:
        hit = np.triu(hit, 2)
    result = []
    for i, j in zip(*np.nonzero(hit), strict=True):
        cosine = abs(step[i] @ stride[j]) / (np.linalg.norm(step[i]) * np.linalg.norm(stride[j]))
        a = float(at[i] + along[i, j] * (at[i + 1] - at[i]))
        b = float(at_other[j] + along_other[i, j] * (at_other[j + 1] - at_other[j]))
        result.append((a, b, start[i] + along[i, j] * step[i], float(np.arccos(np.clip(cosine, 0, 1)))))
    return result


def meetings(curve: Curve, others: Sequence[Curve]) -> list[Meeting]:
    """Return where a new curve crosses itself and those that are there; its own index is the next one."""
    own = len(others)
    found = [Meeting(own, a, own, b, p, angle) for a, b, p, angle in intersections(curve, curve)]
    for index, other in enumerate(others):
        found += [Meeting(own, a, index, b, p, angle) for a, b, p, angle in intersections(curve, other)]
    return found


def is_clear(curves: Sequence[Curve], found: Sequence[Meeting], touch: Meeting | None, table: Table) -> bool:
    """Return whether crossings keep their distances, and the last curve meets others and itself nowhere else."""
    width, new = table.width, len(curves) - 1
    own = [m for m in found if m.i == new]
    if not all(keeps_away(m, found[: len(found) - k], curves, table) for k, m in enumerate(reversed(own), 1)):
        return False
    curve = curves[new][::_COARSE]
    known = [*found, touch] if touch is not None else found
    for index, other in enumerate(curves):
        if len(close(curves[new], other, [m for m in known if (m.i, m.j) == (new, index)], table)[0]):
            return False
        distance = cdist(curve, other[::_COARSE])
        leans = touch is not None and (touch.i, touch.j, touch.a) == (new, index, 0.0)
        near = round(3 * _TIP * width / _COARSE) if index == new else 0
        tips = [
            distance[-1, : len(other[::_COARSE]) - near],
            distance[:, 0][near:],
            distance[:, -1][: len(curve) - near],
        ]
        if not leans:
            tips.append(distance[0, near:])
        if any(tip.min(initial=np.inf) < _TIP * width for tip in tips):
            return False
    return True


def close(
    one: Curve, other: Curve, known: Sequence[Meeting], table: Table
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the indices of points of two curves, or of one, that are too near to each other for no known reason."""
    near, own = table.width + GAP, one is other
    a, b = (at * _COARSE for at in np.nonzero(cdist(one[::_COARSE], other[::_COARSE]) < near))
    explained = (np.abs(a - b) <= np.pi / 2 * near + 2 * _COARSE) & own
    for m in known:
        reach = m.reach or 1.3 * near / (2 * np.sin(m.angle / 2)) + table.width / 2
        explained |= (np.abs(a - m.a) < reach) & (np.abs(b - m.b) < reach)
        explained |= (np.abs(b - m.a) < reach) & (np.abs(a - m.b) < reach) & own
    return a[~explained], b[~explained]


def keeps_away(m: Meeting, others: Sequence[Meeting], curves: Sequence[Curve], table: Table) -> bool:
    """Return whether a crossing is not too acute, too near to others, or too near to the image's border."""
    width = table.width
    if m.angle < table.smallest_angle or depth(m.place, table) < width + 4:
        return False
    for other in others:
        # The mean of half the lengths over which the strands overlap, along each of them.
        overlap = width / 4 * (1 / np.sin(m.angle / 2) + 1 / np.sin(other.angle / 2))
        if np.linalg.norm(m.place - other.place) < max(_APART * width, overlap):
            return False
        if (m.i, m.j) == (other.i, other.j) and max(abs(m.a - other.a), abs(m.b - other.b)) < 12 * width:
            # Both strands bound a hole, which must be visible.
            one, two = curves[m.i][round((m.a + other.a) / 2)], curves[m.j][round((m.b + other.b) / 2)]
            if np.linalg.norm(one - two) < width + GAP:
                return False
    return True


def turning(curve: Curve, width: float) -> npt.NDArray[np.float64]:
    """Return the turned angle from each point to the one a width further on, in radians."""
    step = np.diff(curve, axis=0)
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    reach = round(width)
    return np.abs(heading[reach:] - heading[:-reach])


def depth(curve: Curve, table: Table) -> npt.NDArray[np.float64]:
    """Return the distance of points from the image's border, ``(P,)`` pixels, negative outside."""
    return np.minimum(curve, np.array(table.size[::-1]) - 1.0 - curve).min(axis=-1)
