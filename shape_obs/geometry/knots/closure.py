"""Close open strands of a diagram by arcs through its faces."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable

from shape_obs.geometry.knots.diagram import Diagram


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
