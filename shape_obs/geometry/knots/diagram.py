"""Diagrams of strands, and the moves that remove crossings from them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

from shape_obs.geometry.crossings import Crossing, passages

Strands = tuple[tuple[int, ...], ...]

# How many diagrams with as many crossings are looked at for one from which a crossing can be removed.
_DIAGRAMS: Final = 300

ABOVE: Final = 1
BELOW: Final = -1


@dataclass(frozen=True)
class Diagram:
    """Strands that cross each other, as Gauss codes: what remains of a drawing when the plane may be bent.

    Passages ``2 c`` and ``2 c + 1`` are those of both strands through crossing c.

    Args:
        strands: The passages along each strand.
        levels: Of each passage: 1 over the other strand, -1 under it, 0 if unknown.
        sides: Of each passage: 1 if the other strand comes from the right, as seen, and leaves to the left; else -1.
        closed: Of each strand, whether its last passage is followed by its first.
        ends: Of each open strand: where its ends are held, ``ABOVE`` or ``BELOW`` everything.
    """

    strands: Strands
    levels: tuple[int, ...]
    sides: tuple[int, ...]
    closed: tuple[bool, ...]
    ends: tuple[int, ...]

    @classmethod
    def of(cls, crossings: Sequence[Crossing], names: Sequence[str], ends: Sequence[int]) -> Diagram:
        """Return the diagram of some ropes, without their crossings with others."""
        levels, sides = [], []
        for crossing in crossings:
            level = 0 if crossing.above is None else 1 - 2 * crossing.above
            levels += [level, -level]
            sides += [-crossing.handedness, crossing.handedness]
        strands = tuple(map(tuple, passages(crossings, names)))
        return cls(strands, tuple(levels), tuple(sides), (False,) * len(strands), tuple(ends))

    @property
    def count(self) -> int:
        """The number of crossings."""
        return sum(map(len, self.strands)) // 2

    def unknown(self) -> int | None:
        """Return a passage at a crossing of which the upper strand is unknown; None if all are known."""
        return next((at for strand in self.strands for at in strand if self.levels[at] == 0), None)

    def decided(self, at: int, level: int) -> Diagram:
        """Return the diagram in which a passage has a level."""
        levels = list(self.levels)
        levels[at], levels[at ^ 1] = level, -level
        return replace(self, levels=tuple(levels))

    def only(self, index: int) -> Diagram:
        """Return the diagram of one strand, without the others."""
        own = set(self.strands[index])
        strand = tuple(at for at in self.strands[index] if at ^ 1 in own)
        return replace(self, strands=(strand,), closed=(self.closed[index],), ends=(self.ends[index],))


def reduced(diagram: Diagram) -> Diagram:
    """Return a diagram of open strands after moves that keep what it describes, with as few crossings as were found.

    The moves of K. Reidemeister, "Elementare Begruendung der Knotentheorie", 1927: a loop is untwisted (first move)
    and a strand is drawn from under or over another (second move) wherever possible; among the diagrams that third
    moves reach, a strand over or under a crossing of two others is shifted across it until one of the first kinds is
    possible. Besides, an end that is held above is drawn back over the strands that it lies on, and an end that is
    held below from under those that lie on it.
    """
    diagram = replace(diagram, strands=_simplified(diagram, diagram.strands))
    seen, waiting = {diagram.strands}, deque([diagram.strands])
    while waiting and diagram.count > 0 and len(seen) < _DIAGRAMS:
        for strands in _third_moves(diagram, waiting.popleft()):
            if strands in seen:
                continue
            simple = _simplified(diagram, strands)
            if sum(map(len, simple)) < sum(map(len, strands)):
                diagram = replace(diagram, strands=simple)
                seen, waiting = {simple}, deque([simple])
                break
            seen.add(strands)
            waiting.append(strands)
    return diagram


def _simplified(diagram: Diagram, strands: Strands) -> Strands:
    """Return the passages after all first and second moves and the moves of ends."""
    while gone := _removable(diagram, strands):
        strands = tuple(tuple(at for at in strand if at not in gone and at ^ 1 not in gone) for strand in strands)
    return strands


def _removable(diagram: Diagram, strands: Strands) -> tuple[int, ...]:
    """Return a passage at each crossing that one move removes; empty if there is none."""
    levels, sides = diagram.levels, diagram.sides
    where = {at: (s, i) for s, strand in enumerate(strands) for i, at in enumerate(strand)}
    for strand, end in zip(strands, diagram.ends, strict=True):
        for at in strand[:1] + strand[-1:]:
            if levels[at] == end:
                return (at,)
        for at, after in pairwise(strand):
            if after == at ^ 1:
                return (at,)
            if levels[at] == 0 or levels[at] != levels[after] or sides[at] == sides[after]:
                continue
            (s, i), (t, j) = where[at ^ 1], where[after ^ 1]
            if s == t and abs(i - j) == 1:  # the sides are those of a face, which both strands bound
                return at, after
    return ()


def _third_moves(diagram: Diagram, strands: Strands) -> Iterable[Strands]:
    """Yield the passages after each possible third move."""
    levels, sides = diagram.levels, diagram.sides
    where = {at: (s, i) for s, strand in enumerate(strands) for i, at in enumerate(strand)}
    for strand in strands:
        for a, b in pairwise(strand):
            if levels[a] == 0 or levels[a] != levels[b]:
                continue
            s, i = where[a ^ 1]
            for k in (i - 1, i + 1):
                # The strand through a and b lies over, or under, both strands through a third crossing.
                c = strands[s][k] if 0 <= k < len(strands[s]) else a
                if c >> 1 in (a >> 1, b >> 1) or where[c ^ 1][0] != where[b ^ 1][0]:
                    continue
                j, m = where[b ^ 1][1], where[c ^ 1][1]
                if abs(j - m) != 1:
                    continue
                pieces = ((a, b), (a ^ 1, c), (b ^ 1, c ^ 1))
                # Whether each strand leaves the crossing along its piece (1) or arrives along it (-1).
                leaves = {a: 1, b: -1, a ^ 1: k - i, c: i - k, b ^ 1: m - j, c ^ 1: j - m}
                # The three pieces bound a face if both others leave each of them towards the same side.
                if all(sides[p] * leaves[p ^ 1] == sides[q] * leaves[q ^ 1] for p, q in pieces):
                    rows = [list(strand) for strand in strands]
                    for p, q in pieces:
                        (r, x), (_, y) = where[p], where[q]
                        rows[r][x], rows[r][y] = q, p
                    yield tuple(map(tuple, rows))
