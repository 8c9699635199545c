"""Topologies of self-organising maps: which nodes are connected, and what averaging along them does.

The same classes describe how a shape's points are connected: a chain, a ring, or a lattice.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Final, TypeVar

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled

Array = npt.NDArray[np.float64]
_SWEEPS: Final = 60  # over the unknown values of a lattice
_OVER: Final = 1.6  # how far a sweep takes a value towards the mean of its neighbours
Values = TypeVar("Values", bound=npt.NDArray[np.floating[Any]])


class Topology(ABC):
    """How nodes or points are connected."""

    @property
    @abstractmethod
    def size(self) -> int:
        """How many nodes."""

    @abstractmethod
    def offsets(self) -> Array:
        """Return ``(P, K, K)`` the way from node k to node j in each lattice direction, node units."""

    @abstractmethod
    def edges(self) -> npt.NDArray[np.intp]:
        """Return ``(E, 2)`` pairs of neighbours, the lower index first but where a ring closes."""

    @abstractmethod
    def unshrink(self, nodes: Array, sigma: float) -> Array:
        """Undo the pull of averaging with a kernel of width ``sigma`` towards the inside of a bend: (K,D) -> (K,D)."""

    @abstractmethod
    def interpolate(self, values: Values, known: npt.NDArray[np.bool_]) -> Values:
        """Fill the unknown of ``(K, D)`` values from their known neighbours; at least one must be known."""


@dataclass(frozen=True)
class _Line(Topology):
    """``count`` nodes, one after another."""

    count: int
    closed: ClassVar[bool] = False

    @property
    def size(self) -> int:
        """How many nodes."""
        return self.count

    def offsets(self) -> Array:
        """Return ``(1, K, K)``, around a ring the shorter way."""
        at = np.arange(self.count, dtype=np.float64)
        away, half = at[None, :] - at[:, None], self.count // 2
        return ((away + half) % self.count - half if self.closed else away)[None]

    def edges(self) -> npt.NDArray[np.intp]:
        """Return ``(E, 2)``; the last pair closes a ring."""
        at = np.arange(self.count)
        pairs = np.stack([at, np.roll(at, -1)], axis=1)
        return pairs if self.closed else pairs[:-1]

    def unshrink(self, nodes: Array, sigma: float) -> Array:
        """Undo the pull; the second difference stands for the bend, at an end its neighbour's."""
        return undo_shrinkage(nodes, shrinkage(sigma), self.closed)

    def interpolate(self, values: Values, known: npt.NDArray[np.bool_]) -> Values:
        """Interpolate linearly along the index; the ends of a chain are repeated."""
        at, filled = np.arange(len(values)), values.copy()
        period = self.count if self.closed else None
        for d in range(values.shape[1]):
            filled[~known, d] = np.interp(at[~known], at[known], values[known, d], period=period)
        return filled


@dataclass(frozen=True)
class Chain(_Line):
    """An open chain of ``count`` nodes."""


@dataclass(frozen=True)
class Ring(_Line):
    """A closed ring of ``count`` nodes."""

    closed = True


@dataclass(frozen=True)
class Grid(Topology):
    """A lattice of ``rows`` x ``cols`` nodes, row by row."""

    rows: int
    cols: int

    @property
    def size(self) -> int:
        """How many nodes."""
        return self.rows * self.cols

    def lattice(self, nodes: Array) -> Array:
        """Return ``(K, D)`` nodes as ``(rows, cols, D)``."""
        return nodes.reshape(self.rows, self.cols, nodes.shape[1])

    def places(self) -> Array:
        """Return ``(K, 2)`` row and column of each node."""
        row, column = np.divmod(np.arange(self.size), self.cols)
        return np.stack([row, column], axis=1).astype(np.float64)

    def offsets(self) -> Array:
        """Return ``(2, K, K)`` along the rows' and the columns' index."""
        at = self.places().T
        return at[:, None, :] - at[:, :, None]

    def edges(self) -> npt.NDArray[np.intp]:
        """Return ``(E, 2)`` to the right and down."""
        at = np.arange(self.size).reshape(self.rows, self.cols)
        right = np.stack([at[:, :-1].ravel(), at[:, 1:].ravel()], axis=1)
        down = np.stack([at[:-1].ravel(), at[1:].ravel()], axis=1)
        return np.concatenate([right, down])

    def unshrink(self, nodes: Array, sigma: float) -> Array:
        """Undo the pull as along a chain, down every column and along every row."""
        lattice = np.ascontiguousarray(self.lattice(nodes), dtype=np.float64)
        return undo_lattice_shrinkage(lattice, shrinkage(sigma)).reshape(nodes.shape)

    def interpolate(self, values: Values, known: npt.NDArray[np.bool_]) -> Values:
        """Interpolate smoothly over the lattice: each unknown value is the mean of its neighbours'."""
        lattice = values.reshape(self.rows, self.cols, -1).astype(np.float64)
        filled = values.copy()
        filled[...] = fill_lattice(lattice, np.ascontiguousarray(known).reshape(self.rows, self.cols)).reshape(
            values.shape
        )
        return filled


@compiled("(f8[:,:,::1], b1[:,::1])")
def fill_lattice(values: Array, known: npt.NDArray[np.bool_]) -> Array:
    """Return ``(R, C, D)`` values, each that is not known the mean of its neighbours', at least one known.

    What is not known begins as the nearest known value; successive over-relaxation (D. M. Young, "Iterative methods for
    solving partial difference equations of elliptic type", 1954) takes it to the solution of Laplace's equation.
    """
    rows, cols, dimension = values.shape
    out, done = values.copy(), known.copy()
    waiting = rows * cols - np.count_nonzero(known)
    while 0 < waiting < rows * cols:  # outwards from what is known, a neighbour in each round
        before = done.copy()
        for r in range(rows):
            for c in range(cols):
                for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                    i, j = r + down, c + right
                    if not done[r, c] and 0 <= i < rows and 0 <= j < cols and before[i, j]:
                        done[r, c] = True
                        for d in range(dimension):
                            out[r, c, d] = out[i, j, d]
                        waiting -= 1
    for _ in range(_SWEEPS if not known.all() else 0):
        for r in range(rows):
            for c in range(cols):
                if known[r, c]:
                    continue
                for d in range(dimension):
                    total, count = 0.0, 0
                    for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                        i, j = r + down, c + right
                        if 0 <= i < rows and 0 <= j < cols:
                            total += out[i, j, d]
                            count += 1
                    out[r, c, d] += _OVER * (total / count - out[r, c, d])
    return out


def shrinkage(sigma: float) -> float:
    """Return how far averaging pulls the nodes of a line from their curve, to second order, as a share of their bend.

    The mean over a unit cell of a curve C is C + C''/24, and the kernel mean over both neighbours adds h/(1+2h) C''
    with h = exp(-1/2 sigma^2).
    """
    h = math.exp(-0.5 / sigma**2)
    return 1 / 24 + h / (1 + 2 * h)


#: ``shrinkage`` in compiled code.
pull_of = compiled(shrinkage)


@compiled("(f8[:,::1], f8, b1)")
def undo_shrinkage(nodes: Array, share: float, closed: bool) -> Array:
    """Move the nodes ``(K, D)`` of a line, K >= 3, against their bend, by a share of their second difference.

    The ends of an open line move by 1/24 of their neighbour's.
    """
    size, dimension = nodes.shape
    out = np.empty_like(nodes)
    for k in range(size):
        end = not closed and (k == 0 or k == size - 1)
        at = min(max(k, 1), size - 2) if end else k
        by = 1 / 24 if end else share
        for d in range(dimension):
            bend = nodes[(at + 1) % size, d] - 2 * nodes[at, d] + nodes[at - 1, d]
            out[k, d] = nodes[k, d] - by * bend
    return out


@compiled("(f8[:,:,::1], f8)")
def undo_lattice_shrinkage(lattice: Array, share: float) -> Array:
    """Move the nodes of a lattice ``(R, C, D)`` as ``undo_shrinkage`` does those of its columns and of its rows."""
    rows, cols, _ = lattice.shape
    out = lattice.copy()
    for c in range(cols if rows > 2 else 0):
        line = np.ascontiguousarray(lattice[:, c])
        out[:, c] += undo_shrinkage(line, share, False) - line
    for r in range(rows if cols > 2 else 0):
        out[r] += undo_shrinkage(lattice[r], share, False) - lattice[r]
    return out


@compiled
def from_tip_to_tip(nodes: Array) -> tuple[Array, Array]:
    """Return nodes at the centres of equal pieces with the tips, ``(K + 2, D)``, and where they lie, 0...1."""
    count, size = nodes.shape
    points, share = np.empty((count + 2, size)), np.empty(count + 2)
    for d in range(size):
        points[0, d] = 1.5 * nodes[0, d] - 0.5 * nodes[1, d]
        points[count + 1, d] = 1.5 * nodes[count - 1, d] - 0.5 * nodes[count - 2, d]
        for k in range(count):
            points[k + 1, d] = nodes[k, d]
    for k in range(count):
        share[k + 1] = (k + 0.5) / count
    share[0], share[count + 1] = 0.0, 1.0
    return points, share
