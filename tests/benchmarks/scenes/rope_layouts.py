"""Lay the axes of several ropes on a table so that they cross a given number of times and touch nowhere else."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from tests.benchmarks.scenes.rope_clearance import TIGHTEST, close, depth, is_clear, keeps_away, meetings, turning
from tests.benchmarks.scenes.rope_proposals import Meeting, Table, across, anywhere, axis, leaning, weaving
from tests.benchmarks.scenes.ropes import Curve, from_heading

_SCENES: Final = 15  # started scenes until the generator gives up
_TRIES: Final = 20  # proposals for a rope until the scene is started again
_CUTS: Final = 60  # stretches of a proposed axis that are looked at
_ROUNDS: Final = 3  # times that every rope may grow when all are laid
_GROWTH: Final = 60  # proposed pieces by which an axis grows
_REACH: Final = 250.0  # length of such a piece in pixels
_LONGEST: Final = 900  # pixels
_SHORTEST: Final = 250
_ROOM: Final = 30.0  # mean distance from the image's border in pixels
_BEYOND: Final = 3.0  # length of a rope that is kept outside the image, in widths

Laid = tuple[Curve, list[Meeting], Meeting | None]


def lay_ropes(
    rng: np.random.Generator, count: int, crossings: int, table: Table
) -> tuple[list[Curve], list[Meeting], Meeting | None] | None:
    """Return ``count`` axes with steps of a pixel, their crossings, and the contact if one is wanted.

    Returns None if no room was found for so many crossings.
    """
    for _ in range(_SCENES):
        curves: list[Curve] = []
        found: list[Meeting] = []
        touch = None
        leaning = int(rng.integers(1, count)) if table.touching and count > 1 else -1
        for index in range(count):
            left = crossings - len(found)
            share = 0.5 / count if index == 0 and count > 1 else 1 / (count - index)
            aim = left if index == count - 1 else int(rng.binomial(left, share))
            laid = _next(rng, (curves, found), aim, table, leans=index == leaning)
            if laid is None:
                break
            curve, met, new = laid
            touch = new or touch
            curves.append(curve)
            found += met
        if len(curves) < count:
            continue
        for _ in range(_ROUNDS * count if touch is None else 0):
            if len(found) < crossings:
                curves, found = _one_grown(rng, curves, found, crossings, table)
        if len(found) == crossings:
            return curves, found, touch
    return None


def _one_grown(
    rng: np.random.Generator, curves: list[Curve], found: list[Meeting], crossings: int, table: Table
) -> tuple[list[Curve], list[Meeting]]:
    """Lengthen one of the ropes towards the wanted number of crossings; it becomes the last one."""
    k = int(rng.integers(len(curves)))
    others = curves[:k] + curves[k + 1 :]
    rest = [m._replace(i=m.i - (m.i > k), j=m.j - (m.j > k)) for m in found if k not in (m.i, m.j)]
    laid = curves[k], meetings(curves[k], others), None
    curve, met, _ = _grown(rng, laid, (others, rest), crossings - len(rest), table)
    return [*others, curve], rest + met


def _next(
    rng: np.random.Generator,
    there: tuple[list[Curve], list[Meeting]],
    aim: int,
    table: Table,
    *,
    leans: bool,
) -> Laid | None:
    """Return the next axis with at most ``aim`` crossings, and its contact; None if no room was found."""
    curves = there[0]
    leaves = bool(rng.random() < table.leaving)
    for _ in range(_TRIES):
        loops, touch = int(rng.binomial(min(aim, 4), 0.25 if curves else 1.0)), None
        flat = axis(rng, table, loops)
        if leans:
            curve, touch = leaning(rng, flat, curves, table)
        elif curves and aim - loops > 2 and rng.random() < 0.5:
            curve = weaving(rng, flat, curves, aim, table)
        elif curves and aim > loops:
            curve = across(rng, flat, curves, table)
        else:
            curve = anywhere(rng, flat, table)
        if curve is None:
            continue
        start, end = _seen_part(curve, table, 0.0 if leaves else float(rng.exponential(_ROOM)), leaves=leaves)
        if touch is not None:
            touch = touch._replace(a=touch.a - start)
        laid = _cut(rng, curve[start:end], there, touch, aim, table)
        if laid is not None:
            return _grown(rng, laid, there, aim, table)
    return None


def _grown(
    rng: np.random.Generator, laid: Laid, there: tuple[list[Curve], list[Meeting]], aim: int, table: Table
) -> Laid:
    """Lengthen an axis at its tips until it has ``aim`` crossings, or no room is found."""
    curves, found = there
    for _ in range(_GROWTH):
        curve, met, touch = laid
        if len(met) == aim:
            break
        if touch is None and rng.random() < 0.5:
            curve = curve[::-1]
        # It may branch off before the tip.
        kept = len(curve) - int(rng.exponential(4 * table.width)) * int(rng.integers(2))
        if kept < _SHORTEST:
            continue
        curve = curve[:kept]
        piece = _arc_through(rng, curve, np.concatenate([*curves, curve]), table.width)
        longer = np.concatenate([curve, piece])[-_LONGEST:] if touch is None else np.concatenate([curve, piece])
        tail = longer[-len(piece) - round(2 * table.width) :]
        if len(longer) > _LONGEST or len(piece) == 0 or depth(tail, table).min() < table.width + 4:
            continue
        if (turning(tail, table.width) * TIGHTEST > 1).any():
            continue
        new = meetings(longer, curves)
        if len(met) < len(new) <= aim and is_clear([*curves, longer], found + new, touch, table):
            laid = longer, new, touch
    return laid


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


def _seen_part(curve: Curve, table: Table, room: float, *, leaves: bool) -> tuple[int, int]:
    """Return start and end of the longest part of a curve inside the image, or a little beyond if it may leave it.

    Otherwise it stays ``room`` pixels and its own thickness away from the border.
    """
    margin = table.width + 4 + room
    deep = depth(curve, table)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], deep >= margin, [0]])))
    if len(edges) == 0:
        return 0, 0
    k = 2 * int(np.argmax(edges[1::2] - edges[::2]))
    start, end = int(edges[k]), int(edges[k + 1])
    if leaves:
        # It has to leave the image straight away.
        reach = round(3 * margin + _BEYOND * table.width)
        before, after = deep[max(start - reach, 0) : start][::-1], deep[end : end + reach]
        out, far = (np.flatnonzero(rest < -_BEYOND * table.width) for rest in (before, after))
        start -= int(out[0]) + 1 if len(out) else 0
        end += int(far[0]) + 1 if len(far) else 0
    return start, end


def _cut(
    rng: np.random.Generator,
    curve: Curve,
    there: tuple[list[Curve], list[Meeting]],
    touch: Meeting | None,
    aim: int,
    table: Table,
) -> Laid | None:
    """Return a stretch of a curve with at most ``aim`` crossings that meets others and itself nowhere else.

    Args:
        rng: Draws the stretches that are looked at.
        curve: The curve.
        there: The curves that are there, and their crossings.
        touch: A wanted contact with one of them.
        aim: The most crossings; those with more are preferred.
        table: Where they lie.
    """
    curves, found = there
    if len(curve) < _SHORTEST:
        return None
    met = meetings(curve, curves)
    first = _free_from(curve, met, there, touch, table)
    end = rng.integers(_SHORTEST, len(curve) + 1, _CUTS)
    end[: _CUTS // 2] = len(curve)
    low = np.maximum(first[end - 1], end - _LONGEST)
    start = np.where(rng.random(_CUTS) < 0.5, low, low + rng.uniform(0, 1, _CUTS) * (end - _SHORTEST - low)).astype(int)
    inside = [(start <= m.a) & (m.a < end) & ((m.j != len(curves)) | (start <= m.b) & (m.b < end)) for m in met]
    many = np.sum(inside, axis=0) if inside else np.zeros(_CUTS, int)
    deep = depth(curve, table)
    fine = (start >= low) & (end - start >= _SHORTEST) & (many <= aim)
    # A tip lies inside the image or outside, not on the border.
    fine &= ((deep[np.minimum(start, end - 1)] > table.width) | (start == 0)) & (
        (deep[end - 1] > table.width) | (end == len(curve))
    )
    if touch is not None:
        fine &= (
            (start <= max(touch.a - touch.reach, 0)) & ((start == 0) | (touch.a > 0)) & (touch.a + touch.reach < end)
        )
    # Most crossings first; then, half of the time, the longest.
    best = np.lexsort(((start - end) * int(rng.integers(2)), -many))
    for k in best[fine[best]][:4]:
        part, at = curve[start[k] : end[k]], int(start[k])
        own = [m for m, counts in zip(met, inside, strict=True) if counts[k]]
        own = [m._replace(a=m.a - at, b=m.b - at if m.j == len(curves) else m.b) for m in own]
        moved = touch._replace(a=touch.a - at) if touch is not None else None
        if is_clear([*curves, part], found + own, moved, table):
            return part, own, moved
    return None


def _free_from(
    curve: Curve, met: list[Meeting], there: tuple[list[Curve], list[Meeting]], touch: Meeting | None, table: Table
) -> npt.NDArray[np.int64]:
    """Return for each index of a curve the smallest start from which it has no fault up to that index, ``(P,)``."""
    curves, found = there
    width, new = table.width, len(curves)
    first = np.zeros(len(curve), np.int64)
    good = []
    for m in met:
        at = sorted((int(m.a), int(m.b))) if m.j == new else [int(m.a)] * 2
        if keeps_away(m, found, curves, table):
            good.append(m)
        else:
            first[at[1]] = max(first[at[1]], at[0] + 1)
    a, b = close(curve, curve, [m for m in good if m.j == new], table)
    np.maximum.at(first, np.maximum(a, b), np.minimum(a, b) + 1)
    for index, other in enumerate(curves):
        known = [m for m in [*good, *([touch] if touch is not None else [])] if m.j == index]
        a, _ = close(curve, other, known, table)
        first[a] = a + 1
    turn = turning(curve, width) * TIGHTEST > 1
    first[: len(turn)][turn] = np.flatnonzero(turn) + 1
    return np.maximum.accumulate(first)
