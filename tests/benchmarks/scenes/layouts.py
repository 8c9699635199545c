"""Lay the axes of ropes on a table so that they cross a given number of times and touch nowhere else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.distance import cdist

from shape_obs.bench.scenes import from_heading, rotation
from tests.benchmarks.scenes.ropes import Curve, headings

_SCENES: Final = 15  # started scenes until the generator gives up
_TRIES: Final = 20  # proposals for a rope until the scene is started again
_CUTS: Final = 60  # stretches of a proposed axis that are compared
_GROWTH: Final = 60  # proposed pieces by which an axis grows
_REACH: Final = 250.0  # length of such a piece in pixels
_PROPOSED: Final = (350.0, 1100.0)  # length of a proposed axis in pixels
_LONGEST: Final = 900
_SHORTEST: Final = 250
_ROOM: Final = 30.0  # mean distance from the image's border in pixels
_GAP: Final = 3.0  # pixels between the borders of strands
_STRIDE: Final = 6  # points from one vertex to the next of the polylines that are intersected
_COARSE: Final = 3  # points from one to the next where distances are compared
# In widths: the radius of the tightest bend, the distance of a tip from other strands, and the length of a rope that is
# kept outside the image.
_TIGHTEST: Final = 1.5
_TIP: Final = 2.0
_BEYOND: Final = 3.0


@dataclass(frozen=True)
class Table:
    """How ropes lie on a table."""

    size: tuple[int, int]  # (H, W) of the image
    width: float  # thickness of the ropes in pixels
    leaving: float = 0.0  # probability that a rope may leave the image
    smallest_angle: float = np.pi / 12  # the smallest angle of crossings, in radians
    narrowest: float = 2.0  # the smallest inner radius of loops, in widths
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


def lay_ropes(
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
            curve = _next(rng, curves, found, aim, table)
            if curve is None:
                break
            found += meetings(curve, curves)
            curves.append(curve)
        if len(curves) == count and len(found) == crossings:
            return curves, found
    return None


def intersections(one: Curve, other: Curve) -> list[tuple[float, float, Curve, float]]:
    """Return where two curves with steps of about a pixel intersect: both indices, the place and the acute angle.

    Every intersection of a curve with itself is returned once.
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
    result = []
    for i, j in zip(*np.nonzero(np.triu(hit, 2) if one is other else hit), strict=True):
        cosine = abs(step[i] @ stride[j]) / (np.linalg.norm(step[i]) * np.linalg.norm(stride[j]))
        a = float(at[i] + along[i, j] * (at[i + 1] - at[i]))
        b = float(at_other[j] + along_other[i, j] * (at_other[j + 1] - at_other[j]))
        result.append((a, b, start[i] + along[i, j] * step[i], float(np.arccos(np.clip(cosine, 0, 1)))))
    return result


def meetings(curve: Curve, others: Sequence[Curve]) -> list[Meeting]:
    """Return where a new curve crosses itself and others; its own index is the next one."""
    own, pairs = len(others), enumerate([*others, curve])
    return [Meeting(own, a, j, b, p, angle) for j, other in pairs for a, b, p, angle in intersections(curve, other)]


def is_clear(curve: Curve, others: Sequence[Curve], met: Sequence[Meeting], found: list[Meeting], table: Table) -> bool:
    """Return whether a new curve and its crossings ``met`` keep their distance from others and from each other."""
    every = [*others, curve]
    if len(_faults(curve, others, met, found, table)):
        return False
    if not all(keeps_away(m, met[:k], every, table) for k, m in enumerate(met)):
        return False
    for other in every:
        distance = cdist(curve, other[::_COARSE])
        near = round(3 * _TIP * table.width) if other is curve else 0
        tips = distance[-1, : distance.shape[1] - near // _COARSE], distance[0, near // _COARSE :]
        tips_of_other = distance[near:, 0], distance[: len(curve) - near, -1]
        if min(part.min(initial=np.inf) for part in (*tips, *tips_of_other)) < _TIP * table.width:
            return False
    return True


def _faults(
    curve: Curve, others: Sequence[Curve], met: Sequence[Meeting], found: Sequence[Meeting], table: Table
) -> npt.NDArray[np.int64]:
    """Return what is wrong with a new curve: pairs of indices, lower first, that may not both be in use, ``(F, 2)``.

    It bends too tightly, crosses at a wrong place, or comes too near to itself or others without crossing.
    """
    good = [m for m in met if keeps_away(m, found, [*others, curve], table)]
    turn = np.flatnonzero(_bends(curve, table.width))
    pairs = [np.stack([turn, turn], axis=1).astype(float)]
    pairs += [np.array([[m.a, m.b if m.j == m.i else m.a]]) for m in met if not any(m is each for each in good)]
    for j, other in enumerate([*others, curve]):
        a, b = unexplained(curve, other, [m for m in good if m.j == j], table)
        pairs.append(np.stack([a, b if other is curve else a], axis=1))
    return np.sort(np.concatenate(pairs).astype(np.int64), axis=1)


def unexplained(
    one: Curve, other: Curve, known: Sequence[Meeting], table: Table
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the indices of points of two curves, or of one, that are near to each other away from known crossings."""
    near, own = table.width + _GAP, one is other
    a, b = (at * _COARSE for at in np.nonzero(cdist(one[::_COARSE], other[::_COARSE]) < near))
    explained = (np.abs(a - b) <= np.pi / 2 * near + 2 * _COARSE) & own
    for m in known:
        reach = 1.3 * near / (2 * np.sin(m.angle / 2)) + table.width / 2
        explained |= (np.abs(a - m.a) < reach) & (np.abs(b - m.b) < reach)
        explained |= (np.abs(b - m.a) < reach) & (np.abs(a - m.b) < reach) & own
    return a[~explained], b[~explained]


def keeps_away(m: Meeting, others: Sequence[Meeting], curves: Sequence[Curve], table: Table) -> bool:
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


def turning(curve: Curve, width: float) -> npt.NDArray[np.float64]:
    """Return the angle between the headings of each point and of the one a width further on, in radians."""
    heading, reach = headings(curve), round(width)
    return np.abs(heading[reach:] - heading[:-reach])


def _bends(curve: Curve, width: float) -> npt.NDArray[np.bool_]:
    return turning(curve, width) * _TIGHTEST > 1


def longest_run(flags: npt.NDArray[np.bool_]) -> slice:
    """Return the longest run of true flags, empty if there is none."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags, [0]])))
    k = 2 * int(np.argmax(edges[1::2] - edges[::2])) if len(edges) else 0
    return slice(int(edges[k]), int(edges[k + 1])) if len(edges) else slice(0, 0)


def _next(rng: np.random.Generator, curves: list[Curve], found: list[Meeting], aim: int, table: Table) -> Curve | None:
    """Return the next axis with at most ``aim`` crossings; None if no room was found."""
    leaves = bool(rng.random() < table.leaving)
    for _ in range(_TRIES):
        loops = int(rng.binomial(min(aim, 4), 0.25 if curves else 1.0))
        curve = _placed(rng, _axis(rng, table, loops), curves if aim > loops else [], table)
        curve = _seen_part(curve, table, 0.0 if leaves else float(rng.exponential(_ROOM)), leaves=leaves)
        part = _cut(rng, curve, curves, found, aim, table)
        if part is not None:
            return _grown(rng, part, curves, found, aim, table)
    return None


def _axis(rng: np.random.Generator, table: Table, loops: int) -> Curve:
    """Return a curve with slow waves, a steady curl and loops."""
    n = int(rng.uniform(max(_PROPOSED[0], min(200.0 * loops, 600.0)), _PROPOSED[1]))
    t = np.linspace(0, 1, n)
    wild = rng.uniform(0.5, 2.0)
    waves = sum(rng.normal(0, wild / k) * np.sin(np.pi * k * t + rng.uniform(0, 2 * np.pi)) for k in range(1, 7))
    bend = np.gradient(np.asarray(waves) + rng.normal(0, 0.5 * np.pi) * t)
    for k in range(loops):
        radius = (rng.uniform(table.narrowest, table.narrowest + 4.0) + 0.5) * table.width
        turn = rng.uniform(7, 10) * np.pi / 6
        middle = (k + rng.uniform(0.3, 0.7)) / loops * n
        bend[np.abs(np.arange(n) - middle) < turn * radius / 2] = int(rng.choice([-1, 1])) / radius
    return from_heading(np.cumsum(gaussian_filter1d(bend, 0.7 * table.width)))


def _placed(rng: np.random.Generator, flat: Curve, curves: Sequence[Curve], table: Table) -> Curve:
    """Move a curve across one of the others, at a random angle and place; anywhere if there are none."""
    edge = round(4 * table.width)
    under = curves[int(rng.integers(len(curves)))] if curves else np.zeros((0, 2))
    if min(len(under), len(flat)) <= 2 * edge + 2:
        k, to, heading = (
            int(rng.integers(len(flat))),
            rng.uniform(0, 1, 2) * table.size[::-1],
            rng.uniform(0, 2 * np.pi),
        )
    else:
        k, b = int(rng.integers(edge, len(flat) - edge)), int(rng.integers(edge, len(under) - edge))
        # Acute angles find less room; they are proposed more often.
        angle = table.smallest_angle + (np.pi / 2 - table.smallest_angle) * rng.random() ** 2
        to, heading = under[b], headings(under)[b] + angle * rng.choice([-1, 1]) + np.pi * rng.integers(2)
    return (flat - flat[k]) @ rotation(heading - headings(flat)[min(k, len(flat) - 2)]).T + to


def _seen_part(curve: Curve, table: Table, room: float, *, leaves: bool) -> Curve:
    """Return the longest part of a curve inside the image, or a little beyond if it may leave it.

    Otherwise it stays ``room`` pixels and its own thickness away from the border.
    """
    margin, deep = table.width + 4 + room, table.depth(curve)
    part = longest_run(deep >= margin)
    start, end = part.start, part.stop
    if leaves and end:
        # It has to leave the image straight away.
        reach = round(3 * margin + _BEYOND * table.width)
        before, after = deep[max(start - reach, 0) : start][::-1], deep[end : end + reach]
        out, far = (np.flatnonzero(rest < -_BEYOND * table.width) for rest in (before, after))
        start -= int(out[0]) + 1 if len(out) else 0
        end += int(far[0]) + 1 if len(far) else 0
    return curve[start:end]


def _cut(
    rng: np.random.Generator, curve: Curve, curves: list[Curve], found: list[Meeting], aim: int, table: Table
) -> Curve | None:
    """Return a stretch of a curve with at most ``aim`` crossings, as many as possible, that is clear of others."""
    if len(curve) < _SHORTEST:
        return None
    met, deep = meetings(curve, curves), table.depth(curve)
    first = np.zeros(len(curve), np.int64)  # the smallest start without a fault up to each index
    faults = _faults(curve, curves, met, found, table)
    np.maximum.at(first, faults[:, 1], faults[:, 0] + 1)
    first = np.maximum.accumulate(first)
    end = rng.integers(_SHORTEST, len(curve) + 1, _CUTS)
    end[: _CUTS // 2] = len(curve)
    low = np.maximum(first[end - 1], end - _LONGEST)
    start = np.where(rng.random(_CUTS) < 0.5, low, low + rng.uniform(0, 1, _CUTS) * (end - _SHORTEST - low)).astype(int)
    inside = [(start <= m.a) & (m.a < end) & ((m.j != m.i) | (start <= m.b) & (m.b < end)) for m in met]
    many = np.sum(inside, axis=0) if inside else np.zeros(_CUTS, int)
    fine = (start >= low) & (end - start >= _SHORTEST) & (many <= aim)
    # A tip lies inside the image or outside, not on the border.
    fine &= (deep[np.minimum(start, end - 1)] > table.width) | (start == 0)
    fine &= (deep[end - 1] > table.width) | (end == len(curve))
    # Most crossings first; then, half of the time, the longest.
    best = np.lexsort(((start - end) * int(rng.integers(2)), -many))
    for k in best[fine[best]][:4]:
        part = curve[start[k] : end[k]]
        if is_clear(part, curves, meetings(part, curves), found, table):
            return part
    return None


def _grown(
    rng: np.random.Generator, curve: Curve, curves: list[Curve], found: list[Meeting], aim: int, table: Table
) -> Curve:
    """Lengthen an axis at its tips until it has ``aim`` crossings, or no room is found."""
    met = meetings(curve, curves)
    for _ in range(_GROWTH):
        if len(met) == aim:
            break
        if rng.random() < 0.5:
            curve = curve[::-1]
        # It may branch off before the tip.
        kept = len(curve) - int(rng.exponential(4 * table.width)) * int(rng.integers(2))
        if kept < _SHORTEST:
            continue
        piece = _arc_through(rng, curve[:kept], np.concatenate([*curves, curve]), table.width)
        longer = np.concatenate([curve[:kept], piece])[-_LONGEST:]
        tail = longer[-len(piece) - round(2 * table.width) :]
        if len(piece) == 0 or table.depth(tail).min() < table.width + 4 or _bends(tail, table.width).any():
            continue
        new = meetings(longer, curves)
        if len(met) < len(new) <= aim and is_clear(longer, curves, new, found, table):
            curve, met = longer, new
    return curve


def _arc_through(rng: np.random.Generator, curve: Curve, targets: Curve, width: float) -> Curve:
    """Return an arc that goes on from a curve's end through one of many points, and some widths beyond."""
    end = curve[-1] - curve[-3]
    target = targets[int(rng.integers(len(targets)))] - curve[-1]
    along, aside = target @ end, end[0] * target[1] - end[1] * target[0]
    heading, turn = np.arctan2(end[1], end[0]), 2 * np.arctan2(aside, along)
    reach = float(np.linalg.norm(target))
    length = reach * (turn / 2) / np.sin(turn / 2) if abs(turn) > 1e-3 else reach
    if not 2 * width < length < _REACH or abs(turn) > 4.0:
        return np.zeros((0, 2))
    bend = np.full(int(length + rng.uniform(3, 8) * width), turn / length)
    return curve[-1] + from_heading(heading + np.cumsum(bend))
