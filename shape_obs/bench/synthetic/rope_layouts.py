"""Lay the axes of several ropes on a table so that they cross a given number of times and touch nowhere else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.distance import cdist

from shape_obs.bench.synthetic.ropes import Curve, from_heading, place, resample, rotation

_SCENES: Final = 60  # started scenes until the generator gives up
_TRIES: Final = 200  # proposals for a rope until the scene is started again
_GAP: Final = 3.0  # pixels between the borders of strands that do not touch
_STRIDE: Final = 6  # points from one vertex to the next of the polylines that are intersected
_COARSE: Final = 3  # points from one to the next where distances are compared
_LENGTH: Final = (250.0, 900.0)  # pixels
_SHORTEST_SEEN: Final = 150.0  # pixels of a rope inside the image
# In widths:
_APART: Final = 2.0  # the smallest distance of crossings
_TIP: Final = 2.0  # the smallest distance of a tip from the axis of another strand
_TIGHTEST: Final = 1.5  # the smallest bend radius
_BEYOND: Final = 3.0  # length of a rope that is kept outside the image
_BESIDE: Final = (0.9, 1.1)  # distance of the axes of ropes in contact
_CONTACT: Final = (3.0, 16.0)  # length of the contact
_AGAINST: Final = (0.2, 0.6)  # distance of a tip from the axis of the rope on whose border it lies


@dataclass(frozen=True)
class Table:
    """What ropes are laid on, and how.

    Args:
        size: ``(H, W)`` of the image.
        width: Thickness of the ropes in pixels.
        leaving: Probability that a rope may leave the image.
        touching: Whether one of the ropes touches another one.
        smallest_angle: The smallest angle of crossings, in radians.
        narrowest: The smallest inner radius of loops, in widths.
    """

    size: tuple[int, int]
    width: float
    leaving: float
    touching: bool
    smallest_angle: float
    narrowest: float


class Meeting(NamedTuple):
    """A crossing of curves ``i`` and ``j`` at indices ``a`` and ``b``; or a contact, over ``reach`` points each way."""

    i: int
    a: float
    j: int
    b: float
    place: Curve
    angle: float
    reach: float = 0.0


def lay_ropes(
    rng: np.random.Generator, count: int, crossings: int, table: Table
) -> tuple[list[Curve], list[Meeting], Meeting | None]:
    """Return ``count`` axes with steps of a pixel, their crossings, and the contact if one is wanted."""
    for _ in range(_SCENES):
        curves: list[Curve] = []
        found: list[Meeting] = []
        touch = None
        leaning = int(rng.integers(1, count)) if table.touching and count > 1 else -1
        for index in range(count):
            left = crossings - len(found)
            share = 0.5 / count if index == 0 and count > 1 else 1 / (count - index)
            aim = left if index == count - 1 else int(rng.binomial(left, share))
            laid = _next(rng, curves, found, touch, (aim, left), table, leans=index == leaning)
            if laid is None:
                break
            curve, met, touch = laid
            curves.append(curve)
            found += met
        if len(curves) == count and len(found) == crossings:
            return curves, found, touch
    raise RuntimeError(f"no {count} ropes with {crossings} crossings found that fit {table.size} pixels.")


def _next(
    rng: np.random.Generator,
    curves: list[Curve],
    found: list[Meeting],
    touch: Meeting | None,
    wanted: tuple[int, int],
    table: Table,
    *,
    leans: bool,
) -> tuple[Curve, list[Meeting], Meeting | None] | None:
    """Return the next axis, its crossings and its contact; None if no room was found.

    ``wanted`` is the number of crossings that it should have, and the most that it may have.
    """
    aim, most = wanted
    leaves = bool(rng.random() < table.leaving)
    for attempt in range(_TRIES):
        loops = int(rng.binomial(min(aim, 4), 0.25 if curves else 1.0))
        flat = _axis(rng, table, loops)
        if leans:
            curve, touch = _leaning(rng, flat, curves, table)
        elif curves and aim > loops:
            curve = _across(rng, flat, curves, table)
        else:
            curve = _anywhere(rng, flat, table, leaves=leaves)
        if curve is not None:
            curve = _seen_part(curve, table, leaves=leaves)
        if curve is None or not _turns_gently(curve, table.width):
            continue
        met = _meetings(curve, curves)
        # Later a different number is fine as well.
        fits = len(met) == aim or (aim < most and attempt > _TRIES // 3 and len(met) <= most)
        if fits and _is_clear([*curves, curve], found + met, touch, table):
            return curve, met, touch
    return None


def _axis(rng: np.random.Generator, table: Table, loops: int) -> Curve:
    """Return a curve with slow waves, a steady curl and loops."""
    width = table.width
    n = int(rng.uniform(max(_LENGTH[0], min(200.0 * loops, 600.0)), _LENGTH[1]))
    t = np.linspace(0, 1, n)
    wild = rng.uniform(0.5, 2.0)
    waves = sum(rng.normal(0, wild / k) * np.sin(np.pi * k * t + rng.uniform(0, 2 * np.pi)) for k in range(1, 7))
    bend = np.gradient(np.asarray(waves) + rng.normal(0, 0.5 * np.pi) * t)
    for k in range(loops):
        radius = (rng.uniform(table.narrowest, table.narrowest + 4.0) + 0.5) * width
        turn = rng.uniform(7, 10) * np.pi / 6
        middle = (k + rng.uniform(0.3, 0.7)) / loops * n
        bend[np.abs(np.arange(n) - middle) < turn * radius / 2] = rng.choice([-1, 1]) / radius
    return from_heading(np.cumsum(gaussian_filter1d(bend, 0.7 * width)))


def _anywhere(rng: np.random.Generator, flat: Curve, table: Table, *, leaves: bool) -> Curve | None:
    """Turn and move a curve at random, into the image or partly into it."""
    if not leaves:
        return place(flat, rng, table.size, table.width)
    curve = flat @ rotation(rng.uniform(0, 2 * np.pi)).T
    return curve - curve[rng.integers(len(curve))] + rng.uniform(0, 1, 2) * table.size[::-1]


def _across(rng: np.random.Generator, flat: Curve, curves: Sequence[Curve], table: Table) -> Curve | None:
    """Lay a curve over one that is there, at a random angle and place."""
    under, edge = curves[rng.integers(len(curves))], round(4 * table.width)
    if min(len(under), len(flat)) <= 2 * edge + 2:
        return None
    a, b = int(rng.integers(edge, len(flat) - edge)), int(rng.integers(edge, len(under) - edge))
    angle = rng.uniform(table.smallest_angle, np.pi - table.smallest_angle) * rng.choice([-1, 1])
    return _moved(flat, a, under[b], _heading(under, b) + angle)


def _leaning(
    rng: np.random.Generator, flat: Curve, curves: Sequence[Curve], table: Table
) -> tuple[Curve | None, Meeting | None]:
    """Lay a curve down that touches another one: for some widths side by side, or with its tip."""
    width, other, side = table.width, int(rng.integers(len(curves))), int(rng.choice([-1, 1]))
    under = curves[other]
    reach = round(rng.uniform(*_CONTACT) * width / 2)
    edge = reach + round(3 * width)
    if len(under) <= 2 * edge:
        return None, None
    b = int(rng.integers(edge, len(under) - edge))
    along = np.gradient(under, axis=0)
    normal = side * np.stack([-along[:, 1], along[:, 0]], axis=1)
    if rng.integers(2):
        away = _heading(under, b) + side * rng.uniform(np.pi / 6, 5 * np.pi / 6)
        curve = _moved(flat, 0, under[b] + rng.uniform(*_AGAINST) * width * normal[b], away)
        return curve, Meeting(len(curves), 0.0, other, float(b), under[b], 0.0, 4 * width)
    stretch = slice(b - reach, b + reach + 1)
    beside = resample(under[stretch] + rng.uniform(*_BESIDE) * width * normal[stretch], 1.0)
    step = np.diff(beside, axis=0)
    course = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    # Beyond both ends of the contact it bends away, and then goes its own way.
    step = np.diff(flat, axis=0)
    bends = np.gradient(np.unwrap(np.arctan2(step[:, 1], step[:, 0])))
    k, turns = int(rng.integers(len(bends) // 4, 3 * len(bends) // 4)), []
    for rest in (bends[:k], bends[k:]):
        radius = rng.uniform(4, 9) * width
        first = np.full(round(radius * rng.uniform(0.5, 1.2)), 1 / radius)
        turns.append(side * np.cumsum(np.concatenate([first, rest])))
    curve = from_heading(np.concatenate([course[0] - turns[0][::-1], course, course[-1] + turns[1]]))
    middle = len(turns[0]) + len(course) // 2
    curve = curve - curve[middle] + beside[len(course) // 2]
    return curve, Meeting(len(curves), float(middle), other, float(b), under[b], 0.0, reach + 5 * width)


def _heading(curve: Curve, k: int) -> float:
    step = curve[min(k + 1, len(curve) - 1)] - curve[max(k - 1, 0)]
    return float(np.arctan2(step[1], step[0]))


def _moved(curve: Curve, k: int, to: Curve, heading: float) -> Curve:
    """Move point k of a curve to a place, and turn its direction there to a heading."""
    return (curve - curve[k]) @ rotation(heading - _heading(curve, k)).T + to


def _seen_part(curve: Curve, table: Table, *, leaves: bool) -> Curve | None:
    """Cut a curve a little outside the image; None if it leaves it against the wish, twice at an end, or along it."""
    sides = np.array(table.size[::-1])
    # Distance to the image's border, negative outside.
    deep = np.minimum(curve, sides - 1 - curve).min(axis=1)
    margin = table.width + 4
    if not leaves:
        return curve if deep.min() >= margin else None
    well = np.flatnonzero(deep >= margin)
    if len(well) < _SHORTEST_SEEN or well[-1] - well[0] + 1 != len(well):
        return None
    start, end = int(well[0]), int(well[-1]) + 1
    cut = []
    for rest in (deep[:start][::-1], deep[end:]):
        out = np.flatnonzero(rest < -_BEYOND * table.width)
        if len(rest) == 0:
            cut.append(0)
            continue
        if len(out) == 0 or out[0] > 4 * margin + _BEYOND * table.width or rest[out[0] :].max() > -table.width:
            return None
        cut.append(int(out[0]))
    return curve[start - cut[0] : end + cut[1]]


def _turns_gently(curve: Curve, width: float) -> bool:
    step = np.diff(curve, axis=0)
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    reach = round(width)
    return bool(np.abs(heading[reach:] - heading[:-reach]).max(initial=0.0) * _TIGHTEST <= 1.0)


def _meetings(curve: Curve, others: Sequence[Curve]) -> list[Meeting]:
    """Return where a new curve crosses itself and those that are there; its own index is the next one."""
    own = len(others)
    found = [Meeting(own, a, own, b, p, angle) for a, b, p, angle in intersections(curve, curve)]
    for index, other in enumerate(others):
        found += [Meeting(own, a, index, b, p, angle) for a, b, p, angle in intersections(curve, other)]
    return found


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


def _is_clear(curves: Sequence[Curve], found: Sequence[Meeting], touch: Meeting | None, table: Table) -> bool:
    """Return whether crossings keep their distances, and the last curve meets others and itself nowhere else."""
    if not _are_apart(curves, found, table):
        return False
    width, new = table.width, len(curves) - 1
    curve = curves[new][::_COARSE]
    explaining = [*found, touch] if touch is not None else found
    for index, other in enumerate(curves):
        distance = cdist(curve, other[::_COARSE])
        a, b = (at * _COARSE for at in np.nonzero(distance < width + _GAP))
        explained = (np.abs(a - b) <= np.pi / 2 * (width + _GAP) + 2 * _COARSE) & (index == new)
        for m in explaining:
            if (m.i, m.j) == (new, index):
                reach = m.reach or 1.3 * (width + _GAP) / (2 * np.sin(m.angle / 2)) + width / 2
                explained |= (np.abs(a - m.a) < reach) & (np.abs(b - m.b) < reach)
                explained |= (np.abs(b - m.a) < reach) & (np.abs(a - m.b) < reach) & (index == new)
        if not explained.all():
            return False
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


def _are_apart(curves: Sequence[Curve], found: Sequence[Meeting], table: Table) -> bool:
    """Return whether crossings are not too acute, too near to each other, or too near to the image's border."""
    width, sides = table.width, np.array(table.size[::-1])
    # Half the length over which the strands of a crossing overlap, along each of them.
    overlap = [width / (2 * np.sin(m.angle / 2) + 1e-9) for m in found]
    for k, m in enumerate(found):
        if m.angle < table.smallest_angle or min(m.place.min(), (sides - 1 - m.place).min()) < width + 4:
            return False
        for other, length in zip(found[:k], overlap, strict=False):
            if np.linalg.norm(m.place - other.place) < max(_APART * width, (overlap[k] + length) / 2):
                return False
            if (m.i, m.j) == (other.i, other.j) and max(abs(m.a - other.a), abs(m.b - other.b)) < 12 * width:
                # Both strands bound a hole, which must be visible.
                one, two = curves[m.i][round((m.a + other.a) / 2)], curves[m.j][round((m.b + other.b) / 2)]
                if np.linalg.norm(one - two) < width + _GAP:
                    return False
    return True
