"""The skeleton of a mask as a graph: strands thinned to curves, and the places where they meet."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.polyline import arc_length
from shape_obs.image.connected_runs import find_components, find_root
from shape_obs.image.outline_tracing import fill_holes, trace_components
from shape_obs.initialization.thinning import smoothed, thinned

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]
Index = npt.NDArray[Any]

_CELLS_ACROSS: Final = 20.0  # cells: a thicker rope is thinned on a coarser grid, as exactly and much sooner
_SPUR: Final = 1.7  # radii: a shorter branch with a free end is no strand; into a square corner a skeleton runs for 1.4
_SLIT: Final = 0.3  # of the largest radius: a hole no wider on average is noise or a seam, and would make a loop
MOST_BRANCHES: Final = 60  # of ropes: one that crosses itself ten times has 31, and the time grows with their square
MOST_OF_NOISE: Final = 300  # holes, or branches before pruning: noise makes some, but more take too long to remove
_OFF_AXIS: Final = 0.25  # cells: the border lies 0.5 before the background, and a skeleton 0.25 off the axis


@dataclass(frozen=True, eq=False)
class Branch:
    """A strand between two nodes.

    Args:
        points: ``(P, 2)`` C-contiguous, pixels, image coordinates, at steps of about a (coarse) pixel.
        radius: ``(P,)`` pixels, from there to the nearest background.
        nodes: Where it begins and where it ends.
    """

    points: Array
    radius: Array
    nodes: tuple[int, int]

    @cached_property
    def length(self) -> float:
        """The length, pixels."""
        return arc_length(self.points).item(-1)

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
        return Branch(np.ascontiguousarray(self.points[::-1]), self.radius[::-1].copy(), (self.nodes[1], self.nodes[0]))


class Skeleton(NamedTuple):
    """Branches between nodes; a node with one branch is a free end.

    Args:
        branches: In no particular order or direction.
        width: Of the typical strand, pixels.
        excess: Why there are more branches than any rope has, in words; ``branches`` is empty then. Else empty.
    """

    branches: tuple[Branch, ...]
    width: float
    excess: str = ""


def skeleton_graph(mask: Mask, origin: tuple[float, float] = (0.0, 0.0), bump: float = 0.0) -> Skeleton:
    """Return the skeleton of everything in a mask.

    Args:
        mask: (h,w) uint8, 0 = background.
        origin: Image coordinates of the mask's first pixel.
        bump: How far a branch that is a bump of the border sticks out of its strand at most, in widths.

    Returns:
        Spurs pruned, no node between just two branches; without branches for a mask of specks.
    """
    left, top, width, height = cv2.boundingRect(mask)
    grid = np.pad((mask[top : top + height, left : left + width] > 0).view(np.uint8), 1)
    away = _distances(grid)
    cell = int(max(2 * _thickest(away) / _CELLS_ACROSS, 1))
    if cell > 1:
        grid = _coarse(grid[1:-1, 1:-1], cell)
        away = _distances(grid)
    smooth = smoothed(grid)
    holes, filled = _fill_slits(smooth, _thickest(away))
    if holes > MOST_BRANCHES:  # at least one branch for each
        return Skeleton((), 1.0, f"the mask has {holes} holes")
    if smooth is not grid or filled:
        grid, away = smooth, _distances(smooth)
    places, stops, nodes = trace_skeleton(*thinned(grid))
    if len(stops) > MOST_OF_NOISE:
        return Skeleton((), 1.0, f"the mask branches {len(stops)} times")
    # The frame is a cell wide, and a cell's middle lies between pixels where their number is even.
    shift = np.array([origin[0] + left, origin[1] + top]) - cell + (cell - 1) / 2
    pixels = np.stack([places % grid.shape[1], places // grid.shape[1]], axis=1) * float(cell) + shift
    radius = np.maximum(away.ravel()[places] - _OFF_AXIS, 0.0).astype(np.float64) * cell
    typical = middle_value(radius) if len(radius) else 0.5 * cell
    nodes = np.unique(nodes, return_inverse=True)[1].reshape(-1, 2)
    ends = zip([0, *stops.tolist()], stops.tolist(), nodes.tolist(), strict=False)
    found = (Branch(pixels[first:last], radius[first:last], (a, b)) for first, last, (a, b) in ends)
    branches = _pruned(found, 2 * bump * typical)
    if len(branches) > MOST_BRANCHES:
        return Skeleton((), 1.0, f"the mask branches {len(branches)} times")
    return Skeleton(tuple(branches), max(2 * typical, 1.0))


def _distances(grid: Mask) -> npt.NDArray[np.float32]:
    """Return the distance from each cell of a framed mask to the nearest of the background, cells."""
    return np.asarray(cv2.distanceTransform(grid, cv2.DIST_L2, 5), np.float32)


def _thickest(away: npt.NDArray[np.float32]) -> float:
    return max(float(away.max(initial=0.0)) - _OFF_AXIS, 0.0)


@compiled("(f8[::1],)")
def middle_value(values: Array) -> float:
    """Return the median of one value or more."""
    return np.median(values)


def _coarse(piece: Mask, cell: int) -> Mask:
    """Return a mask on a grid of ``cell`` x ``cell`` pixels, set where most of a cell is, and framed by one cell."""
    height, width = piece.shape
    framed = np.pad(piece * np.uint8(255), ((cell, cell + -height % cell), (cell, cell + -width % cell)))
    size = (framed.shape[1] // cell, framed.shape[0] // cell)
    return (np.asarray(cv2.resize(framed, size, interpolation=cv2.INTER_AREA)) > 127).view(np.uint8)


def _fill_slits(grid: Mask, thickest: float) -> tuple[int, bool]:
    """Fill narrow holes, in place; return how many holes are left, and whether any was filled."""
    _, runs, areas, _, _ = find_components(grid, 0, 0, 1, 1, 0.0)
    holes = trace_components(grid, runs, len(areas), 0, 0)[-1]
    left = fill_holes(grid, runs, holes, 0, 0, 0.0, max(_SLIT * thickest, 1.0))
    return left, left < len(holes)


@compiled("(u1[:,::1], i8[::1])")
def trace_skeleton(thin: Mask, pixels: Index) -> tuple[Index, Index, Index]:
    """Trace every chain of pixels from node to node once, then the rings that no node lies on, closed.

    A node is a pixel with one neighbour or more than two; neighbouring pixels with more than two are one node. A
    diagonal neighbour counts only where no shared neighbour connects the two.

    Args:
        thin: ``(h, w)`` 0 and 1, with a border of 0.
        pixels: ``(P,)`` flat places where it is 1.

    Returns:
        ``(P,)`` flat places of the pixels of all chains, end to end; ``(B,)`` where each chain ends; ``(B, 2)`` the
        nodes at its ends.
    """
    is_set, across = thin.reshape(-1), thin.shape[1]
    steps = (-1, 1, -across, across, -across - 1, across + 1, 1 - across, across - 1)
    shared = ((0, 0), (0, 0), (0, 0), (0, 0), (-across, -1), (across, 1), (-across, 1), (across, -1))
    degree, node = np.zeros(len(is_set), np.int8), np.empty(len(is_set), np.int64)
    linked, done = np.zeros(len(is_set), np.uint8), np.zeros(len(is_set), np.bool_)  # linked: a bit for each step
    for at in pixels:
        node[at] = at
        for k in range(8):
            if is_set[at + steps[k]] and (k < 4 or not (is_set[at + shared[k][0]] or is_set[at + shared[k][1]])):
                degree[at] += 1
                linked[at] |= 1 << k
    for at in pixels:
        if degree[at] > 2:
            for k in range(8):
                other = at + steps[k]
                if linked[at] >> k & 1 and degree[other] > 2:
                    a, b = find_root(node, at), find_root(node, other)
                    node[max(a, b)] = min(a, b)
    most = 9 * len(pixels)  # each pixel once, but the nodes, of up to eight branches
    places, held = np.empty(most, np.int64), 0
    stops, nodes, found = np.empty(most, np.int64), np.empty((most, 2), np.int64), 0
    for rings in range(2):
        for start in pixels:
            if (degree[start] == 2) != (rings == 1) or done[start]:
                continue
            for k in range(8):
                here = start + steps[k]
                if linked[start] >> k & 1 == 0 or done[here] or (degree[start] > 2 and degree[here] > 2):
                    continue
                if degree[here] != 2 and here < start:
                    continue
                done[start] = rings == 1
                places[held], places[held + 1], before = start, here, start
                held += 2
                while degree[here] == 2 and here != start:
                    done[here] = True
                    for onward in range(8):
                        if linked[here] >> onward & 1 and here + steps[onward] != before:
                            before, here = here, here + steps[onward]
                            break
                    places[held] = here
                    held += 1
                stops[found], nodes[found, 0], nodes[found, 1] = held, find_root(node, start), find_root(node, here)
                found += 1
                if rings == 1:
                    break
    return places[:held], stops[:found], nodes[:found]


def _pruned(branches: Iterable[Branch], bump: float) -> list[Branch]:
    """Remove spurs, shortest first: each one removed may turn two others into one longer branch."""
    kept = dict(enumerate(branches))
    degree, added = degrees(kept.values()), len(kept)
    excess = {i: _excess(branch, degree, bump) for i, branch in kept.items()}
    while excess and excess[shortest := min(excess, key=excess.__getitem__)] < 0:
        del excess[shortest]
        gone = kept.pop(shortest)
        degree.subtract(gone.nodes)
        node = gone.nodes[0] if degree[gone.nodes[0]] > 0 else gone.nodes[1]
        left = [i for i, branch in kept.items() if node in branch.nodes]
        if len(left) == 2:
            kept[added] = kept.pop(left[0]).fused(kept.pop(left[1]), node)
            degree[node] -= 2
            excess[added] = _excess(kept[added], degree, bump)
            excess[left[0]] = excess[left[1]] = np.inf
            added += 1
    return list(kept.values())


def degrees(branches: Iterable[Branch]) -> Counter[int]:
    """Return how many branches leave each node."""
    return Counter(node for branch in branches for node in branch.nodes)


def _excess(branch: Branch, degree: Counter[int], bump: float) -> float:
    """Return how much longer a branch is than a spur may be, pixels; a spur has one free end and one that is not."""
    ends = [degree[node] for node in branch.nodes]
    if min(ends) > 1 or max(ends) < 3:
        return np.inf
    radius = float(branch.radius[0] if ends[0] > 1 else branch.radius[-1])
    return branch.length - max(_SPUR * radius, radius + bump)
