"""The skeleton of a mask as a graph: strands thinned to curves, and the places where they meet.

Thinning after Guo and Hall ("Parallel Thinning with Two-Subiteration Algorithms", 1989), eight pixels
at a time: as bits of a byte.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

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

_ONE: Final = np.uint8(1)
_SEVEN: Final = np.uint8(7)
_ROWS: Final = (slice(None, -2), slice(1, -1), slice(2, None))  # above, beside, below


@dataclass(frozen=True, eq=False)
class Branch:
    """A strand between two nodes.

    Args:
        points: (P,2) pixels, image coordinates, at steps of about a (coarse) pixel.
        radius: (P,) pixels, from there to the nearest background.
        nodes: Where it begins and where it ends.
    """

    points: Array
    radius: Array
    nodes: tuple[int, int]

    @cached_property
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
    grid = _framed((mask[top : top + height, left : left + width] > 0).view(np.uint8), 1)
    depth = _depth(grid)
    cell = int(max(2 * _radius(depth.max(initial=0.0)) / _CELLS_ACROSS, 1))
    if cell > 1:
        grid = _coarse(grid[1:-1, 1:-1], cell)
        depth = _depth(grid)
    if _fill_slits(grid, float(_radius(depth.max(initial=0.0)))):
        depth = _depth(grid)
    thin = thinned(grid)
    # The frame is a cell wide, and a cell's middle lies between pixels where their number is even.
    shift = np.array([origin[0] + left, origin[1] + top]) - cell + (cell - 1) / 2
    found = _branches(thin, depth)
    typical = float(np.median(np.concatenate([b.radius for b in found]))) if found else 0.5
    branches = _pruned(found) if len(found) <= _MOST_PRUNED else found
    placed = [Branch(b.points * cell + shift, b.radius * cell, b.nodes) for b in branches]
    return Skeleton(tuple(placed), max(2 * typical * cell, 1.0))


def thinned(mask: Mask) -> Mask:
    """Return a mask of 0 and 1 with a border of 0, thinned to curves one pixel wide: ``(h, w)`` uint8."""
    bits = np.packbits(mask, axis=1)
    while True:
        before = bits.copy()
        for half in (0, 1):
            bits[1:-1] &= ~_removable(bits, half)
        if np.array_equal(bits, before):
            return np.unpackbits(bits, axis=1, count=mask.shape[1])


def _removable(bits: Mask, half: int) -> Mask:
    """Return which pixels each half of a pass removes, but in the first and last row, packed as ``bits`` are."""
    flat = bits.reshape(-1)  # rows end in background, so that nothing is carried from one to the next
    left, right = flat >> _ONE, flat << _ONE
    left[1:] |= flat[:-1] << _SEVEN
    right[:-1] |= flat[1:] >> _SEVEN
    n, s = bits[:-2], bits[2:]
    nw, w, sw = (left.reshape(bits.shape)[row] for row in _ROWS)
    ne, e, se = (right.reshape(bits.shape)[row] for row in _ROWS)
    one = ne | e, se | s, sw | w, nw | n
    other = n | ne, e | se, s | sw, w | nw
    pieces = one[0] & ~n, one[1] & ~e, one[2] & ~s, one[3] & ~w
    side = (s | sw | ~nw) & w if half == 0 else (n | ne | ~se) & e
    return _exactly_one(*pieces) & _two(*one) & _two(*other) & ~(_all(*one) & _all(*other)) & ~side


def _exactly_one(a: Mask, b: Mask, c: Mask, d: Mask) -> Mask:
    return (a ^ b ^ c ^ d) & ~(a & b | c & d)


def _two(a: Mask, b: Mask, c: Mask, d: Mask) -> Mask:
    """Return where at least two of four are set."""
    return a & b | c & d | (a | b) & (c | d)


def _all(a: Mask, b: Mask, c: Mask, d: Mask) -> Mask:
    return a & b & c & d


def _framed(piece: Mask, edge: int, beyond: tuple[int, int] = (0, 0)) -> Mask:
    """Return a frame of background about a mask: what touches the border of the image ends there."""
    down, right = edge + beyond[0], edge + beyond[1]
    framed = cv2.copyMakeBorder(piece, edge, down, edge, right, cv2.BORDER_CONSTANT, value=(0.0,))
    return np.asarray(framed, dtype=np.uint8)


def _depth(piece: Mask) -> npt.NDArray[np.float32]:
    """Return the distance from each cell of a framed mask to the nearest centre of a cell of the background, cells."""
    return np.asarray(cv2.distanceTransform(piece, cv2.DIST_L2, 5), dtype=np.float32)


def _radius(depth: npt.ArrayLike) -> Array:
    """Return the distance to the outline, cells, of cells of the skeleton.

    The outline lies half a cell before the background's centre, and a cell of the skeleton a quarter beside the axis.
    """
    return np.maximum(np.asarray(depth, dtype=np.float64) - 0.25, 0.0)


def _coarse(piece: Mask, cell: int) -> Mask:
    """Return a mask on a grid of ``cell`` x ``cell`` pixels, set where most of a cell is, and framed by one cell."""
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


def _branches(thin: Mask, depth: npt.NDArray[np.float32]) -> list[Branch]:
    """Return the curves between the pixels of a skeleton that have one neighbour, or more than two."""
    at = np.flatnonzero(thin.view(bool))
    if len(at) == 0:
        return []
    first, second = _links(thin, at)
    count = len(at)
    degree = np.bincount(np.concatenate([first, second]), minlength=count)
    # Neighbouring pixels with three neighbours each are one node.
    at_node = (degree[first] > 2) & (degree[second] > 2)
    node = _connected(count, first[at_node], second[at_node])
    links = np.stack([first[~at_node], second[~at_node]], axis=1)
    chains = [np.array(chain) for chain in _chains(links, degree != 2)]
    pixels = np.stack([at % thin.shape[1], at // thin.shape[1]], axis=1).astype(np.float64)
    wide = _radius(depth.ravel()[at])
    return [Branch(pixels[chain], wide[chain], (int(node[chain[0]]), int(node[chain[-1]]))) for chain in chains]


def _connected(count: int, first: Index, second: Index) -> Index:
    """Return the component of each of ``count`` pixels, of which pairs are connected, numbered as they appear."""
    label = np.arange(count)
    while True:  # the least number spreads; a joint has a few pixels
        least, before = np.minimum(label[first], label[second]), label.copy()
        np.minimum.at(label, first, least)
        np.minimum.at(label, second, least)
        if np.array_equal(label, before):
            return np.unique(label, return_inverse=True)[1]


def _links(thin: Mask, at: Index) -> tuple[Index, Index]:
    """Return pairs of neighbouring pixels; a diagonal counts only where no pixel beside it makes the same step.

    Args:
        thin: With a border of 0.
        at: (P,) where it is set, row by row.
    """
    is_set, down = thin.view(bool).ravel(), thin.shape[1]
    pairs = []
    for row, right in ((0, 1), (down, 0), (down, 1), (down, -1)):
        linked = is_set[at + row + right]
        if row and right:
            linked &= ~(is_set[at + row] | is_set[at + right])
        first = np.flatnonzero(linked)
        pairs.append((first, np.searchsorted(at, at[first] + row + right)))
    return np.concatenate([pair[0] for pair in pairs]), np.concatenate([pair[1] for pair in pairs])


def _chains(links: Index, is_node: npt.NDArray[np.bool_]) -> list[list[int]]:
    """Return every chain of pixels from node to node once, then the rings that no node lies on, closed.

    Args:
        links: (L,2) neighbours; pixels that are no node have two.
        is_node: (P,).
    """
    near, far = links.ravel(), links[:, ::-1].ravel()
    # From one of a pixel's two neighbours to the other: both together, less the one.
    both = np.bincount(near, far, minlength=len(is_node)).astype(int).tolist()
    some = np.zeros(len(is_node), int)
    some[near[::-1]] = far[::-1]
    ends, done = is_node.tolist(), is_node.tolist()

    def walked(start: int, here: int) -> list[int]:
        chain, before = [start, here], start
        while not ends[here] and here != start:
            done[here] = True
            before, here = here, both[here] - before
            chain.append(here)
        return chain

    at = np.flatnonzero(is_node[near])
    at = at[np.argsort(near[at], kind="stable")]
    chains = []
    for start, onward in zip(near[at].tolist(), far[at].tolist(), strict=True):
        if onward >= start if ends[onward] else not done[onward]:
            chains.append(walked(start, onward))
    for start in np.flatnonzero(~is_node).tolist():
        if not done[start]:
            done[start] = True
            chains.append(walked(start, int(some[start])))
    return chains


def _pruned(branches: list[Branch]) -> list[Branch]:
    """Remove spurs, shortest first: each one removed may turn two others into one longer branch."""
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
    """Return how much longer a branch is than a spur may be, pixels; a spur has one free end and one that is not."""
    ends = [degree[node] for node in branch.nodes]
    if min(ends) > 1 or max(ends) < 3:
        return np.inf
    return branch.length - _SPUR * float(branch.radius[0] if ends[0] > 1 else branch.radius[-1])
