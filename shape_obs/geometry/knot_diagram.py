"""Diagrams of strands: the moves that remove crossings, and arcs through the faces that close open strands."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Iterable, Sequence
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
    possible. In addition, an end that is held above is drawn back from the strands that it lies on, and an end that
    is held below from under those that lie on it.
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


def is_planar(diagram: Diagram) -> bool:
    """Return whether open strands with such passages can be drawn in the plane, by Euler's formula."""
    faces = _Faces(diagram)
    crossings, edges = diagram.count, sum(len(strand) + 1 for strand in diagram.strands)
    return crossings + 2 * len(diagram.strands) - edges + faces.count == 2 * _pieces(diagram)


def with_arc(diagram: Diagram, index: int) -> Diagram:
    """Return the diagram with an open strand closed by an arc above or below everything, as its ends are held.

    The arc takes a way through the faces that crosses as few strands as possible. Whichever way it takes, the knot
    or link is the same: V. Turaev, "Knotoids", 2012, section 2.4.
    """
    strand, level = diagram.strands[index], diagram.ends[index]
    faces, size = _Faces(diagram), len(diagram.levels)
    way = faces.way((index, len(strand)), (index, 0))
    strands = [list(each) for each in diagram.strands]
    levels, sides = list(diagram.levels), list(diagram.sides)
    for n, (_, _, from_left) in enumerate(way):
        levels += [level, -level]
        sides += [1, -1] if from_left else [-1, 1]
        strands[index].append(size + 2 * n)
    for n, (s, i, _) in sorted(enumerate(way), key=lambda item: -item[1][1]):
        strands[s].insert(i, size + 2 * n + 1)
    closed = tuple(flag or s == index for s, flag in enumerate(diagram.closed))
    return Diagram(tuple(map(tuple, strands)), tuple(levels), tuple(sides), closed, diagram.ends)


def _pieces(diagram: Diagram) -> int:
    """Return in how many pieces that share no crossing the diagram falls."""
    owner = {at: s for s, strand in enumerate(diagram.strands) for at in strand}
    groups = _Groups()
    for s, strand in enumerate(diagram.strands):
        groups.find(s)
        for at in strand:
            groups.join(s, owner[at ^ 1])
    return groups.count


class _Groups:
    """Sets that are joined step by step."""

    def __init__(self) -> None:
        self.parent: dict[Hashable, Hashable] = {}

    def find(self, item: Hashable) -> Hashable:
        """Return what stands for the set of an item, a new one if it is in none."""
        parent = self.parent.setdefault(item, item)
        while parent != item:
            item, parent = parent, self.parent[parent]
        return item

    def join(self, one: Hashable, other: Hashable) -> None:
        """Join the sets of two items."""
        self.parent[self.find(one)] = self.find(other)

    @property
    def count(self) -> int:
        """The number of sets."""
        return sum(item == parent for item, parent in self.parent.items())


class _Faces:
    """The faces of a diagram: each edge (strand, i), before passage i, has one on its left and one on its right."""

    def __init__(self, diagram: Diagram) -> None:
        self._groups = _Groups()
        self._edges: list[tuple[int, int]] = []
        after: dict[int, tuple[int, int]] = {}
        before: dict[int, tuple[int, int]] = {}
        for s, strand in enumerate(diagram.strands):
            size = len(strand)
            self._edges += [(s, i) for i in range(max(size, 1) if diagram.closed[s] else size + 1)]
            for i, at in enumerate(strand):
                before[at], after[at] = (s, i), (s, (i + 1) % size if diagram.closed[s] else i + 1)
            if not diagram.closed[s]:
                for end in ((s, 0), (s, size)):
                    self._groups.join((end, True), (end, False))
        for at in (at for strand in diagram.strands for at in strand if at % 2 == 0):
            across = at ^ 1
            # The other strand lies ahead of the one, or behind it, on either side: true is left.
            for left in (True, False):
                leaves = (diagram.sides[at] > 0) == left
                edge = after[across] if leaves else before[across]
                self._groups.join((after[at], left), (edge, left != leaves))
                self._groups.join((before[at], left), (edge, left == leaves))

    @property
    def count(self) -> int:
        """The number of faces, if the diagram is in one piece; else each piece has an outer one."""
        return self._groups.count

    def way(self, start: tuple[int, int], stop: tuple[int, int]) -> list[tuple[int, int, bool]]:
        """Return the edges to cross from one edge to another: strand, passage after, whether from its left."""
        first, last = self._groups.find((start, True)), self._groups.find((stop, True))
        came: dict[Hashable, tuple[Hashable, tuple[int, int, bool]]] = {}
        waiting = deque([first])
        while waiting and last not in came and first != last:
            face = waiting.popleft()
            for edge in self._edges:
                for left in (True, False):
                    beyond = self._groups.find((edge, not left))
                    if self._groups.find((edge, left)) == face and beyond != first and beyond not in came:
                        came[beyond] = face, (*edge, left)
                        waiting.append(beyond)
        way: list[tuple[int, int, bool]] = []
        while last != first:
            last, step = came[last]
            way.append(step)
        return way[::-1]
