"""The skeleton of a mask as a graph: strands thinned to curves, and the places where they meet.

Thinning after Guo and Hall ("Parallel Thinning with Two-Subiteration Algorithms", 1989), a look-up table over the
codes of the eight neighbours.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]
Index = npt.NDArray[np.intp]

# A thick rope is thinned on a coarser grid, this many cells across: its axis comes out just as well, much sooner.
_CELLS_ACROSS: Final = 20.0
# A branch that ends freely within this many radii of where it leaves is a corner of the outline, not a strand: the
# skeleton runs into a square corner for 1.4 radii.
_SPUR: Final = 1.7
# Holes no wider on average than this share of the thickest radius are noise, or the seam between strands side by side:
# each would make a loop, and strands that part are told by their thickness as well.
_SLIT: Final = 0.3

# More branches than this are noise all over, and pruning takes time with the square of their number.
_MOST_PRUNED: Final = 300


class Branch(NamedTuple):
    """A strand between two nodes.

    Args:
        points: (P,2) pixels, image coordinates, at steps of about a (coarse) pixel.
        radius: (P,) pixels, from there to the nearest background.
        nodes: Where it begins and where it ends.
    """

    points: Array
    radius: Array
    nodes: tuple[int, int]

    @property
    def length(self) -> float:
        """Pixels."""
        step = np.diff(self.points, axis=0)
        return float(np.hypot(step[:, 0], step[:, 1]).sum())

    def fused(self, other: Branch, node: int) -> Branch:
        """This branch and another that meets it at ``node``, as one."""
        first = self if self.nodes[1] == node else self.reversed()
        second = other if other.nodes[0] == node else other.reversed()
        return Branch(
            np.concatenate([first.points, second.points]),
            np.concatenate([first.radius, second.radius]),
            (first.nodes[0], second.nodes[1]),
        )

    def reversed(self) -> Branch:
        """The same branch from its end to its start."""
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
    """The skeleton of everything in a mask.

    Args:
        mask: (h,w) uint8, 0 = background.
        origin: Image coordinates of the mask's first pixel.

    Returns:
        Spurs pruned, no node between just two branches; without branches for a mask of specks; with hundreds, as they
        are, for noise.
    """
    left, top, width, height = cv2.boundingRect(mask)
    grid = _framed((mask[top : top + height, left : left + width] > 0).view(np.uint8), 1)
    radius = _radius(grid)
    cell = int(max(2 * radius.max(initial=0.0) / _CELLS_ACROSS, 1))
    if cell > 1:
        grid = _coarse(grid[1:-1, 1:-1], cell)
        radius = _radius(grid)
    if _fill_slits(grid, float(radius.max(initial=0.0))):
        radius = _radius(grid)
    thin = thinned(grid)
    # The frame is a cell wide, and a cell's middle lies between pixels where their number is even.
    shift = np.array([origin[0] + left, origin[1] + top]) - cell + (cell - 1) / 2
    found = _branches(thin, radius)
    typical = float(np.median(np.concatenate([b.radius for b in found]))) if found else 0.5
    branches = _pruned(found) if len(found) <= _MOST_PRUNED else found
    placed = [Branch(b.points * cell + shift, b.radius * cell, b.nodes) for b in branches]
    return Skeleton(tuple(placed), max(2 * typical * cell, 1.0))


def thinned(mask: Mask) -> Mask:
    """A mask of 0 and 1 with a border of 0, thinned to curves one pixel wide: (h,w) uint8."""
    thin, left = mask.copy(), -1
    while True:
        for table in _TABLES:
            code = cv2.filter2D(thin, cv2.CV_8U, _WEIGHTS, borderType=cv2.BORDER_CONSTANT)
            thin &= np.asarray(cv2.LUT(code, table), dtype=np.uint8)
        before, left = left, cv2.countNonZero(thin)
        if left == before:
            return thin


def _tables() -> tuple[Mask, Mask]:
    """Which of the 256 neighbourhoods keep their centre, for either half of a pass: (256,) uint8 each.

    Bit i of a code is the neighbour i of (N, NE, E, SE, S, SW, W, NW).
    """
    p = (np.arange(256)[:, None] >> np.arange(8)) & 1
    n, ne, e, se, s, sw, w, nw = (p[:, i].astype(bool) for i in range(8))
    pieces = sum((~a & (b | c)).astype(int) for a, b, c in ((n, ne, e), (e, se, s), (s, sw, w), (w, nw, n)))
    one = sum((a | b).astype(int) for a, b in ((nw, n), (ne, e), (se, s), (sw, w)))
    other = sum((a | b).astype(int) for a, b in ((n, ne), (e, se), (s, sw), (w, nw)))
    thick = np.minimum(one, other)
    removable = (pieces == 1) & (thick >= 2) & (thick <= 3)
    sides = ((s | sw | ~nw) & w, (n | ne | ~se) & e)
    first, second = (np.where(removable & ~side, 0, 1).astype(np.uint8) for side in sides)
    return first, second


_TABLES: Final = _tables()
# filter2D correlates: the weight at a neighbour's place is its bit.
_WEIGHTS: Final = np.array([[128, 1, 2], [64, 0, 4], [32, 16, 8]], np.float32)


def _framed(piece: Mask, edge: int, beyond: tuple[int, int] = (0, 0)) -> Mask:
    """A frame of background about a mask: what touches the border of the image ends there."""
    down, right = edge + beyond[0], edge + beyond[1]
    framed = cv2.copyMakeBorder(piece, edge, down, edge, right, cv2.BORDER_CONSTANT, value=(0.0,))
    return np.asarray(framed, dtype=np.uint8)


def _radius(piece: Mask) -> Array:
    """Distance from each cell of a framed mask to its outline, cells.

    The outline lies half a cell before the background's centre, and a cell of the skeleton a quarter beside the axis.
    """
    return np.maximum(np.asarray(cv2.distanceTransform(piece, cv2.DIST_L2, 5), dtype=np.float64) - 0.25, 0.0)


def _coarse(piece: Mask, cell: int) -> Mask:
    """A mask on a grid of ``cell`` x ``cell`` pixels, set where most of a cell is, and framed by one cell."""
    height, width = piece.shape
    framed = _framed(piece * np.uint8(255), cell, (-height % cell, -width % cell))
    size = (framed.shape[1] // cell, framed.shape[0] // cell)
    return (np.asarray(cv2.resize(framed, size, interpolation=cv2.INTER_AREA)) > 127).view(np.uint8)


def _fill_slits(grid: Mask, thickest: float) -> bool:
    """Fill narrow holes, in place; whether there were any."""
    contours, tree = cv2.findContours(grid, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    found = False
    for contour, (_, _, _, parent) in zip(contours, np.reshape(np.asarray(tree), (-1, 4)).tolist(), strict=True):
        # The outline of a hole runs through the pixels around it.
        if parent >= 0 and 2 * cv2.contourArea(contour) / len(contour) - 1 <= max(_SLIT * thickest, 1.0):
            cv2.drawContours(grid, [contour], 0, (1.0,), cv2.FILLED)
            found = True
    return found


def _branches(thin: Mask, radius: Array) -> list[Branch]:
    """The curves between the pixels of a skeleton that have one neighbour, or more than two."""
    rows, columns = np.nonzero(thin)
    if len(rows) == 0:
        return []
    first, second = _links(thin, rows, columns)
    count = len(rows)
    degree = np.bincount(np.concatenate([first, second]), minlength=count)
    # Neighbouring pixels with three neighbours each are one node.
    at_node = (degree[first] > 2) & (degree[second] > 2)
    joints = coo_array((np.ones(at_node.sum()), (first[at_node], second[at_node])), shape=(count, count))
    node = connected_components(joints, directed=False)[1]
    beside: list[list[int]] = [[] for _ in range(count)]
    for i, j in zip(first[~at_node].tolist(), second[~at_node].tolist(), strict=True):
        beside[i].append(j)
        beside[j].append(i)
    is_node = (degree != 2).tolist()
    chains = _chains(beside, is_node)
    pixels = np.stack([columns, rows], axis=1).astype(np.float64)
    wide = radius[rows, columns]
    return [Branch(pixels[chain], wide[chain], (int(node[chain[0]]), int(node[chain[-1]]))) for chain in chains]


def _links(thin: Mask, rows: Index, columns: Index) -> tuple[Index, Index]:
    """Pairs of neighbouring pixels; a diagonal counts only where no pixel beside it makes the same step."""
    index = np.full(thin.shape, -1)
    index[rows, columns] = np.arange(len(rows))
    pairs = []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        there = index[rows + down, columns + right]
        linked = there >= 0
        if down and right:
            linked &= (index[rows + down, columns] < 0) & (index[rows, columns + right] < 0)
        pairs.append((np.flatnonzero(linked), there[linked]))
    return np.concatenate([pair[0] for pair in pairs]), np.concatenate([pair[1] for pair in pairs])


def _chains(beside: list[list[int]], is_node: list[bool]) -> list[list[int]]:
    """Every chain of pixels from node to node once, then the rings that no node lies on, closed."""
    chains = []
    done = [False] * len(beside)
    for start in (i for i, node in enumerate(is_node) if node):
        for onward in beside[start]:
            if done[onward] or (is_node[onward] and onward < start):
                continue
            chain = [start, onward]
            while not is_node[chain[-1]]:
                done[chain[-1]] = True
                there = beside[chain[-1]]
                chain.append(there[0] if there[0] != chain[-2] else there[1])
            chains.append(chain)
    for start in (i for i, node in enumerate(is_node) if not node):
        if not done[start]:
            chain = [start, beside[start][0]]
            while chain[-1] != start:
                done[chain[-1]] = True
                there = beside[chain[-1]]
                chain.append(there[0] if there[0] != chain[-2] else there[1])
            chains.append(chain)
    return chains


def _pruned(branches: list[Branch]) -> list[Branch]:
    """Without spurs, shortest first: each that goes may turn the two that it left into one longer branch."""
    kept = list(branches)
    while True:
        degree: dict[int, int] = {}
        for branch in kept:
            for node in branch.nodes:
                degree[node] = degree.get(node, 0) + 1
        spurs = [(excess, i) for i, branch in enumerate(kept) if (excess := _excess(branch, degree)) < 0]
        if not spurs:
            return kept
        gone = kept.pop(min(spurs)[1])
        node = gone.nodes[0] if degree[gone.nodes[0]] > 1 else gone.nodes[1]
        left = [branch for branch in kept if node in branch.nodes]
        if len(left) == 2:
            kept = [branch for branch in kept if node not in branch.nodes] + [left[0].fused(left[1], node)]


def _excess(branch: Branch, degree: dict[int, int]) -> float:
    """How much longer a branch is than a spur may be there, pixels; no spur unless one end is free, the other not."""
    ends = [degree[node] for node in branch.nodes]
    if min(ends) > 1 or max(ends) < 3:
        return np.inf
    return branch.length - _SPUR * float(branch.radius[0] if ends[0] > 1 else branch.radius[-1])
