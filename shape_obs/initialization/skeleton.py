"""The skeleton of a mask as a graph: strands thinned to curves, and the places where they meet.

Thinning after Guo and Hall, "Parallel Thinning with Two-Subiteration Algorithms", 1989.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.image.connected_runs import find_components
from shape_obs.image.outline_tracing import fill_holes

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]
Index = npt.NDArray[np.intp]

# A thick rope is thinned on a coarser grid, this many cells across: its axis comes out just as well, much sooner.
_CELLS_ACROSS: Final = 20.0
# A branch that ends freely within this many radii of where it leaves is a corner of the outline, not a strand: the
# skeleton runs into a square corner for 1.4 radii.
_SPUR: Final = 1.7
# Holes no wider on average than this share of the thickest radius are noise, or the seam between strands side by side:
# each would make a loop, and strands that part are recognised by their thickness as well.
_SLIT: Final = 0.3

# More branches than this are noise all over, and pruning takes time with the square of their number.
_MOST_PRUNED: Final = 300

# A pixel's neighbours as a byte: the lowest bit the one above it, then clockwise.
_NEIGHBOURS: Final = np.array([[128, 1, 2], [64, 0, 4], [32, 16, 8]], np.float32)


def _kept(half: int) -> Mask:
    """Return ``(256,)`` 1 for neighbours with which a pixel is kept in either half of a pass of thinning, else 0."""
    n, ne, e, se, s, sw, w, nw = (np.arange(256) >> np.arange(8)[:, None] & 1).astype(bool)
    one, other = np.stack([ne | e, se | s, sw | w, nw | n]), np.stack([n | ne, e | se, s | sw, w | nw])
    pieces = np.sum(one & ~np.stack([n, e, s, w]), axis=0)
    count = np.minimum(one.sum(axis=0), other.sum(axis=0))
    side = (s | sw | ~nw) & w if half == 0 else (n | ne | ~se) & e
    return 1 - ((pieces == 1) & (count >= 2) & (count <= 3) & ~side).astype(np.uint8)


_KEPT: Final = (_kept(0), _kept(1))


@dataclass(frozen=True, eq=False)
class Branch:
    """A strand between two nodes.

    Args:
        points: ``(P, 2)`` pixels, image coordinates, at steps of about a (coarse) pixel.
        radius: ``(P,)`` pixels, from there to the nearest background.
        nodes: Where it begins and where it ends.
    """

    points: Array
    radius: Array
    nodes: tuple[int, int]

    @cached_property
    def length(self) -> float:
        """The length, pixels."""
        step = np.diff(self.points, axis=0)
        return float(np.hypot(step[:, 0], step[:, 1]).sum())

    def fused(self, other: Branch, node: int) -> Branch:
        """Return this branch and another that meets it at ``node`` as one."""
        first = self if self.nodes[1] == node else self.reversed()
        second = other if other.nodes[0] == node else other.reversed()
        return Branch(
            np.concatenate([first.points, second.points]),
            np.concatenate([first.radius, second.radius]),
            (first.nodes[0], second.nodes[1]),
        )

    def reversed(self) -> Branch:
        """Return the same branch from its end to its start."""
        return Branch(self.points[::-1], self.radius[::-1], (self.nodes[1], self.nodes[0]))


class Skeleton(NamedTuple):
    """Branches between nodes; a node with one branch is a free end.

    Args:
        branches: In no particular order or direction.
        width: Of the typical strand, pixels.
    """

    branches: tuple[Branch, ...]
    width: float


def skeleton_graph(mask: Mask, origin: tuple[float, float] = (0.0, 0.0)) -> Skeleton:
    """Return the skeleton of everything in a mask.

    Args:
        mask: (h,w) uint8, 0 = background.
        origin: Image coordinates of the mask's first pixel.

    Returns:
        Spurs pruned, no node between just two branches; without branches for a mask of specks; with hundreds, as they
        are, for noise.
    """
    left, top, width, height = cv2.boundingRect(mask)
    grid = np.pad((mask[top : top + height, left : left + width] > 0).view(np.uint8), 1)
    depth = _depth(grid)
    cell = int(max(2 * _radius(depth.max(initial=0.0)) / _CELLS_ACROSS, 1))
    if cell > 1:
        grid = _coarse(grid[1:-1, 1:-1], cell)
        depth = _depth(grid)
    _fill_slits(grid, float(_radius(depth.max(initial=0.0))))
    # The frame is a cell wide, and a cell's middle lies between pixels where their number is even.
    shift = np.array([origin[0] + left, origin[1] + top]) - cell + (cell - 1) / 2
    found = _branches(thinned(grid), _depth(grid))
    typical = float(np.median(np.concatenate([b.radius for b in found]))) if found else 0.5
    branches = _pruned(found) if len(found) <= _MOST_PRUNED else found
    placed = [Branch(b.points * cell + shift, b.radius * cell, b.nodes) for b in branches]
    return Skeleton(tuple(placed), max(2 * typical * cell, 1.0))


def thinned(mask: Mask) -> Mask:
    """Return a mask of 0 and 1 with a border of 0, thinned to curves one pixel wide: ``(h, w)`` uint8."""
    thin, before = mask.copy(), np.zeros_like(mask)
    while not np.array_equal(thin, before):
        before = thin.copy()
        for kept in _KEPT:
            thin &= cv2.LUT(cv2.filter2D(thin, -1, _NEIGHBOURS), kept)
    return thin


def _depth(piece: Mask) -> npt.NDArray[np.float32]:
    """Return the distance from each cell of a framed mask to the nearest centre of a cell of the background, cells."""
    return np.asarray(cv2.distanceTransform(piece, cv2.DIST_L2, 5), dtype=np.float32)


def _radius(depth: npt.ArrayLike) -> Array:
    """Return the distance to the outline, cells, of cells of the skeleton.

    The outline lies half a cell before the background's centre, and a cell of the skeleton a quarter off the axis.
    """
    return np.maximum(np.asarray(depth, dtype=np.float64) - 0.25, 0.0)


def _coarse(piece: Mask, cell: int) -> Mask:
    """Return a mask on a grid of ``cell`` x ``cell`` pixels, set where most of a cell is, and framed by one cell."""
    height, width = piece.shape
    framed = np.pad(piece * np.uint8(255), ((cell, cell + -height % cell), (cell, cell + -width % cell)))
    size = (framed.shape[1] // cell, framed.shape[0] // cell)
    return (np.asarray(cv2.resize(framed, size, interpolation=cv2.INTER_AREA)) > 127).view(np.uint8)


def _fill_slits(grid: Mask, thickest: float) -> int:
    """Fill narrow holes, in place; return how many holes are left."""
    runs = find_components(grid, 0, 0, 1, 1, 0.0)[1]
    return fill_holes(grid, runs, 0, 0, 0.0, max(_SLIT * thickest, 1.0))


def _branches(thin: Mask, depth: npt.NDArray[np.float32]) -> list[Branch]:
    """Return the curves between the pixels of a skeleton that have one neighbour, or more than two."""
    at = np.flatnonzero(thin)
    links = _links(thin, at)
    degree = np.bincount(links.ravel(), minlength=len(at))
    # Neighbouring pixels with three neighbours each are one node.
    at_node = np.all(degree[links] > 2, axis=1)
    node = connected(len(at), links[at_node])
    pixels = np.stack([at % thin.shape[1], at // thin.shape[1]], axis=1).astype(np.float64)
    wide = _radius(depth.ravel()[at])
    return [
        Branch(pixels[chain], wide[chain], (int(node[chain[0]]), int(node[chain[-1]])))
        for chain in _chains(links[~at_node], degree != 2)
    ]


def connected(count: int, pairs: Index) -> Index:
    """Return the component of each of ``count`` places, of which pairs ``(L, 2)`` are connected, as they appear."""
    label, before = np.arange(count), np.zeros(count, int)
    while not np.array_equal(label, before):  # the least number spreads; a joint has a few pixels
        before = label.copy()
        np.minimum.at(label, pairs, label[pairs].min(axis=1, keepdims=True))
    return np.unique(label, return_inverse=True)[1]


def _links(thin: Mask, at: Index) -> Index:
    """Return ``(L, 2)`` neighbouring pixels; a diagonal counts only where no shared neighbour connects the two.

    Args:
        thin: With a border of 0.
        at: ``(P,)`` where it is set, row by row.
    """
    is_set, down = thin.ravel() > 0, thin.shape[1]
    pairs = []
    for row, right in ((0, 1), (down, 0), (down, 1), (down, -1)):
        linked = is_set[at + row + right]
        if row and right:
            linked &= ~(is_set[at + row] | is_set[at + right])
        first = np.flatnonzero(linked)
        pairs.append(np.stack([first, np.searchsorted(at, at[first] + row + right)], axis=1))
    return np.concatenate(pairs)


def _chains(links: Index, is_node: npt.NDArray[np.bool_]) -> Iterator[list[int]]:
    """Return every chain of pixels from node to node once, then the rings that no node lies on, closed.

    Args:
        links: ``(L, 2)`` neighbours; pixels that are no node have two.
        is_node: ``(P,)``.
    """
    neighbours: list[list[int]] = [[] for _ in is_node]
    for first, second in links.tolist():
        neighbours[first].append(second)
        neighbours[second].append(first)
    done: set[int] = set()

    def walked(start: int, here: int) -> list[int]:
        chain = [start, here]
        while not is_node[here] and here != start:
            done.add(here)
            here = next(pixel for pixel in neighbours[here] if pixel != chain[-2])
            chain.append(here)
        return chain

    for start in np.flatnonzero(is_node).tolist():
        for onward in neighbours[start]:
            if onward >= start if is_node[onward] else onward not in done:
                yield walked(start, onward)
    for start in np.flatnonzero(~is_node).tolist():
        if start not in done:
            done.add(start)
            yield walked(start, neighbours[start][0])


def _pruned(branches: list[Branch]) -> list[Branch]:
    """Remove spurs, shortest first: each one removed may turn two others into one longer branch."""
    kept = list(branches)
    while True:
        degree = degrees(kept)
        spurs = [(excess, i) for i, branch in enumerate(kept) if (excess := _excess(branch, degree)) < 0]
        if not spurs:
            return kept
        gone = kept.pop(min(spurs)[1])
        node = gone.nodes[0] if degree[gone.nodes[0]] > 1 else gone.nodes[1]
        left = [branch for branch in kept if node in branch.nodes]
        if len(left) == 2:
            kept = [branch for branch in kept if node not in branch.nodes] + [left[0].fused(left[1], node)]


def degrees(branches: Iterable[Branch]) -> Counter[int]:
    """Return how many branches leave each node."""
    return Counter(node for branch in branches for node in branch.nodes)


def _excess(branch: Branch, degree: Counter[int]) -> float:
    """Return how much longer a branch is than a spur may be, pixels; a spur has one free end and one that is not."""
    ends = [degree[node] for node in branch.nodes]
    if min(ends) > 1 or max(ends) < 3:
        return np.inf
    return branch.length - _SPUR * float(branch.radius[0] if ends[0] > 1 else branch.radius[-1])
