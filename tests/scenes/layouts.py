"""Place the axes of ropes on a table so that they cross a given number of times and touch nowhere else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import cdist

from shape_obs.bench.scenes import from_heading
from tests.scenes.ropes import Curve, headings

_SCENES: Final = 15  # started scenes until the generator gives up
_TRIES: Final = 8  # started ropes until the scene is started again
_PIECES: Final = 120  # proposed pieces by which an axis grows
_REACH: Final = 300.0  # length of such a piece in pixels
_LONGEST: Final = 900  # pixels
_SHORTEST: Final = 250
_GAP: Final = 3.0  # pixels between the borders of strands
_STRIDE: Final = 6  # points from one vertex to the next of the polylines that are intersected
_COARSE: Final = 3  # points from one to the next where distances are compared
_TIGHTEST: Final = 1.5  # radius of the tightest bend in widths
_TIPS: Final = 2.0  # the smallest distance of a tip from other strands, in widths


@dataclass(frozen=True)
class Table:
    """How ropes lie on a table."""

    size: tuple[int, int]  # (H, W) of the image
    width: float  # thickness of the ropes in pixels
    leaving: float = 0.0  # probability that an end of a rope may leave the image
    smallest_angle: float = np.pi / 12  # the smallest angle of crossings, in radians
    apart: float = 2.0  # the smallest distance of crossings, in widths

    def depth(self, points: Curve) -> npt.NDArray[np.float64]:
        """Return the distance of points from the image's border, ``(P,)`` pixels, negative outside."""
        return np.minimum(points, np.array(self.size[::-1]) - 1.0 - points).min(axis=-1)


class Meeting(NamedTuple):
    """A crossing of the curves ``i`` and ``j`` at the indices ``a`` and ``b``, under an acute angle in radians."""

    i: int
    a: float
    j: int
    b: float
    place: Curve
    angle: float


def place_ropes(
    rng: np.random.Generator, count: int, crossings: int, table: Table
) -> tuple[list[Curve], list[Meeting]] | None:
    """Return ``count`` axes with steps of a pixel and their crossings; None if there is no room for so many."""
    for _ in range(_SCENES):
        curves: list[Curve] = []
        found: list[Meeting] = []
        for index in range(count):
            left = crossings - len(found)
            share = 0.5 / count if index == 0 and count > 1 else 1 / (count - index)
            aim = left if index == count - 1 else int(rng.binomial(left, share))
            grown = (_grown(rng, curves, found, aim, table) for _ in range(_TRIES))
            curve = next((each for each in grown if each is not None), None)
            if curve is None:
                break
            found += meetings(curve, curves)
            curves.append(curve)
        if len(curves) == count:
            return curves, found
    return None


def meetings(curve: Curve, others: Sequence[Curve]) -> list[Meeting]:
    """Return where a new curve crosses itself and others; its own index is the next one."""
    own, pairs = len(others), enumerate([*others, curve])
    return [Meeting(own, a, j, b, p, angle) for j, other in pairs for a, b, p, angle in intersections(curve, other)]


def intersections(one: Curve, other: Curve) -> list[tuple[float, float, Curve, float]]:
    """Return where two curves with steps of about a pixel intersect: both indices, the place and the acute angle.

    Every intersection of a curve with itself is returned once.
    """
    at, at_other = (np.append(np.arange(0, len(c) - 1, _STRIDE), len(c) - 1) for c in (one, other))
    start, begin = one[at[:-1]], other[at_other[:-1]]
    step, stride = np.diff(one[at], axis=0), np.diff(other[at_other], axis=0)
    offset = begin[None] - start[:, None]
    area = step[:, None, 0] * stride[None, :, 1] - step[:, None, 1] * stride[None, :, 0]
    area = np.where(np.abs(area) < 1e-9, np.nan, area)  # parallel ones have no crossing
    along = (offset[..., 0] * stride[None, :, 1] - offset[..., 1] * stride[None, :, 0]) / area
    along_other = (offset[..., 0] * step[:, None, 1] - offset[..., 1] * step[:, None, 0]) / area
    hit = (along >= 0) & (along < 1) & (along_other >= 0) & (along_other < 1)
    result = []
    for i, j in zip(*np.nonzero(np.triu(hit, 2) if one is other else hit), strict=True):
        cosine = abs(step[i] @ stride[j]) / (np.linalg.norm(step[i]) * np.linalg.norm(stride[j]))
        a = float(at[i] + along[i, j] * (at[i + 1] - at[i]))
        b = float(at_other[j] + along_other[i, j] * (at_other[j + 1] - at_other[j]))
        result.append((a, b, start[i] + along[i, j] * step[i], float(np.arccos(np.clip(cosine, 0, 1)))))
    return result


def is_clear(
    curve: Curve, others: Sequence[Curve], met: Sequence[Meeting], found: Sequence[Meeting], table: Table
) -> bool:
    """Return whether a new curve with the crossings ``met`` bends enough, and touches nothing but where it crosses."""
    every, near = [*others, curve], table.width + _GAP
    if is_tight(curve, table.width) or not all(
        _keeps_away(m, [*found, *met[:k]], every, table) for k, m in enumerate(met)
    ):
        return False
    for j, other in enumerate(every):
        distance, own = cdist(curve[::_COARSE], other[::_COARSE]), other is curve
        a, b = (at * _COARSE for at in np.nonzero(distance < near))
        explained = (np.abs(a - b) <= np.pi / 2 * near + 2 * _COARSE) & own
        for m in (m for m in met if m.j == j):
            reach = 1.3 * near / (2 * np.sin(m.angle / 2)) + table.width / 2
            explained |= (np.abs(a - m.a) < reach) & (np.abs(b - m.b) < reach)
            explained |= (np.abs(b - m.a) < reach) & (np.abs(a - m.b) < reach) & own
        rows, columns = distance.shape
        skipped = min(round(3 * _TIPS * table.width) // _COARSE, rows, columns) if own else 0
        tips = distance[-1, : columns - skipped], distance[0, skipped:]
        tips_of_other = distance[skipped:, 0], distance[: rows - skipped, -1]
        nearest = min(part.min(initial=np.inf) for part in (*tips, *tips_of_other))
        if not explained.all() or nearest < _TIPS * table.width:
            return False
    return True


def _keeps_away(m: Meeting, others: Sequence[Meeting], curves: Sequence[Curve], table: Table) -> bool:
    """Return whether a crossing is not too acute, too near to others, or too near to the image's border."""
    width = table.width
    if m.angle < table.smallest_angle or table.depth(m.place) < width + 4:
        return False
    for other in others:
        # The mean of half the lengths over which the strands overlap, along each of them.
        overlap = width / 4 * (1 / np.sin(m.angle / 2) + 1 / np.sin(other.angle / 2))
        if np.linalg.norm(m.place - other.place) < max(table.apart * width, overlap):
            return False
        if (m.i, m.j) == (other.i, other.j) and max(abs(m.a - other.a), abs(m.b - other.b)) < 12 * width:
            # Both strands bound a hole, which must be visible.
            one, two = curves[m.i][round((m.a + other.a) / 2)], curves[m.j][round((m.b + other.b) / 2)]
            if np.linalg.norm(one - two) < width + _GAP:
                return False
    return True


def is_tight(curve: Curve, width: float) -> bool:
    """Return whether a curve turns, over a width, by more than the tightest bend allows."""
    heading, reach = headings(curve), round(width)
    return bool(np.abs(heading[reach:] - heading[:-reach]).max(initial=0.0) * _TIGHTEST > 1)


def longest_run(flags: npt.NDArray[np.bool_]) -> slice:
    """Return the longest run of true flags, empty if there is none."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags, [0]])))
    k = 2 * int(np.argmax(edges[1::2] - edges[::2])) if len(edges) else 0
    return slice(int(edges[k]), int(edges[k + 1])) if len(edges) else slice(0, 0)


def _grown(
    rng: np.random.Generator, curves: Sequence[Curve], found: Sequence[Meeting], aim: int, table: Table
) -> Curve | None:
    """Grow an axis arc by arc, at either tip, until it is long and has ``aim`` crossings; None if it finds no room."""
    width, shortest = table.width, rng.uniform(_SHORTEST, 0.7 * _LONGEST)
    first = from_heading(np.full(round(4 * width), rng.uniform(0, 2 * np.pi)))
    curve = first - first[-1] + rng.uniform(0.1, 0.9, 2) * table.size[::-1]
    crossed, leaves = len(meetings(curve, curves)), bool(rng.random() < table.leaving)
    for _ in range(_PIECES):
        done = crossed == aim and len(curve) >= shortest
        if done and not leaves:
            return curve
        if rng.random() < 0.5:
            curve = curve[::-1]
        # It may branch off before the tip.
        kept = curve[: max(len(curve) - int(rng.exponential(4 * width)) * int(rng.integers(2)), len(first))]
        targets = np.concatenate([*curves, curve]) if crossed < aim and rng.random() < 0.8 else None
        piece = _arc(rng, kept, _beyond(rng, table)[None] if done else targets, width)
        longer, deep = np.concatenate([kept, piece]), table.depth(piece)
        if len(piece) == 0 or len(longer) > _LONGEST or is_tight(longer[-len(piece) - round(2 * width) :], width):
            continue
        gone = done and deep[-1] < -2 * width and bool(np.all(np.diff(deep[deep < width + 4]) < -0.2))
        if not gone and table.depth(longer).min() < width + 4:
            continue
        new = meetings(longer, curves)
        if len(new) <= aim and is_clear(longer, curves, new, found, table):
            curve, crossed = longer, len(new)
            if gone and crossed == aim:
                return curve
    return curve if crossed == aim and len(curve) >= shortest else None


def _beyond(rng: np.random.Generator, table: Table) -> Curve:
    """Return a place on the border of the image, ``(2,)``."""
    place, side = rng.uniform(0.1, 0.9, 2), int(rng.integers(2))
    place[side] = rng.integers(2)
    return place * table.size[::-1]


def _arc(rng: np.random.Generator, curve: Curve, targets: Curve | None, width: float) -> Curve:
    """Return an arc that goes on from a curve's end: anywhere, or some widths beyond one of many points."""
    end, length, turn = curve[-1] - curve[-2], rng.uniform(40, 160), rng.normal(0, 0.8)
    if targets is not None:
        target = targets[int(rng.integers(len(targets)))] - curve[-1]
        turn = 2 * np.arctan2(end[0] * target[1] - end[1] * target[0], target @ end)
        length = float(np.linalg.norm(target)) / np.sinc(turn / 2 / np.pi)
        if not 2 * width < length < _REACH or abs(turn) > 4.0:
            return np.zeros((0, 2))
        further = rng.uniform(3, 8) * width
        turn, length = turn * (1 + further / length), length + further
    heading = np.arctan2(end[1], end[0]) + turn * np.arange(1, int(length) + 1) / length
    return curve[-1] + from_heading(heading)
