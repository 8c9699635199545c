"""Where strands meet: the nodes of a skeleton gathered into zones that every rope passes straight through.

Strands that cross at a steep angle thin to nodes within one another's reach. At an acute angle, or side by side, they
share a branch for a while, from the node where they meet to the one where they part. A rope that passes through leaves
an even number of branches at a zone, so which odd zones share a branch is a matching (as in route inspection: Kwan,
"Graphic Programming Using Odd or Even Points", 1962).

Whether two strands run side by side along a branch that they share, or cross, is seen in the silhouette: side by side
they are as thick as two, and where one crosses the other they lie on top of each other and are as thick as one. Each
such waist is a crossing.
"""

from __future__ import annotations

from collections import Counter
from typing import Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.geometry.polyline import arc_length
from shape_obs.initialization.pairing import MOST, ONTO, Lead, cheapest_pairing
from shape_obs.initialization.skeleton import Branch, Skeleton, degrees

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

_ALONE: Final = 0.56  # radius over width: one strand has 0.5, and is thicker by noise alone
_ONE: Final = 0.76  # radius over width, below which strands lie on each other: in crossings it is 0.5 to 0.71
_TWO: Final = 0.84  # radius over width, above which they lie side by side: there it is 0.9 to 1
_BLOB: Final = 4.0  # widths: a shorter branch thicker than a strand lies where three or more cross in nearly one place
_JITTER: Final = 0.2  # widths within which the largest radius counts: a skeleton is a pixel off the axis at places
_PER_WIDTH: Final = (3.0, 0.2)  # nats that a width of a shared branch costs as thick as one strand, and as two


class Zones(NamedTuple):
    """Where strands meet.

    Args:
        kept: The branches that one strand runs along.
        shared: The branches that two run along.
        nodes: ``(2B,)`` the node of each end of a branch; ends 2 i and 2 i + 1 are those of branch i.
        of: ``(2B,)`` the zone of each.
        doubt: Why the shared branches may be others, in words; empty if they are not.
    """

    kept: tuple[int, ...]
    shared: tuple[int, ...]
    nodes: Index
    of: Index
    doubt: str


def merge_nodes(skeleton: Skeleton) -> Skeleton:
    """Make one node of those whose discs in the mask overlap; the branches between them are left out.

    Three strands that cross in nearly one place are thinned to four nodes, with short branches between them that no
    strand runs along.
    """
    degree = degrees(skeleton.branches)
    is_inner = [_is_inner(branch, degree, skeleton.width) for branch in skeleton.branches]
    inner = [branch for branch, inside in zip(skeleton.branches, is_inner, strict=True) if inside]
    node = connected(max(degree, default=-1) + 1, np.array([branch.nodes for branch in inner], int).reshape(-1, 2))
    kept = (branch for branch, inside in zip(skeleton.branches, is_inner, strict=True) if not inside)
    renamed = (Branch(each.points, each.radius, (int(node[each.nodes[0]]), int(node[each.nodes[1]]))) for each in kept)
    return skeleton._replace(branches=tuple(renamed))


def _is_inner(branch: Branch, degree: Counter[int], width: float) -> bool:
    if min(degree[node] for node in branch.nodes) < 3 or branch.nodes[0] == branch.nodes[1]:
        return False
    if branch.length < branch.radius[0] + branch.radius[-1]:
        return True
    if branch.length >= _BLOB * width:
        return False
    typical = float(np.sort(branch.radius)[len(branch.radius) // 5]) / width
    return _ALONE < typical < _ONE


def find_zones(skeleton: Skeleton) -> Zones:
    """Gather the nodes of a skeleton into zones: those at the two ends of a shared branch are one.

    Each odd node lies at one shared branch at most, or a rope ends there.
    """
    branches, degree = skeleton.branches, degrees(skeleton.branches)
    odd = {node: k for k, node in enumerate(sorted(node for node, n in degree.items() if n % 2 and n > 1))}
    price = np.full((len(odd), len(odd)), np.inf)
    np.fill_diagonal(price, ONTO)
    along: dict[tuple[int, int], int] = {}
    for i, branch in enumerate(branches):
        if len(set(branch.nodes)) == 2 and odd.keys() >= set(branch.nodes):
            first, last = (odd[node] for node in branch.nodes)
            cost = _price(branch, skeleton.width)
            if cost < min(2 * ONTO, price[first, last]):  # a dearer one is never shared
                price[first, last] = price[last, first] = cost
                along[first, last] = along[last, first] = i
    partner, _ = cheapest_pairing(price)
    shared = {along[k, other] for k, other in enumerate(partner.tolist()) if k != other}
    zone = connected(max(degree, default=-1) + 1, np.array([branches[i].nodes for i in shared], int).reshape(-1, 2))
    nodes = np.array([branch.nodes for branch in branches], int).reshape(-1)
    most = np.bincount(connected(len(odd), np.argwhere(np.isfinite(price))), minlength=1).max()
    crowded = f"strands meet in {len(odd)} places, too close together to tell them apart"
    kept = tuple(i for i in range(len(branches)) if i not in shared)
    return Zones(kept, tuple(sorted(shared)), nodes, zone[nodes], crowded if most > MOST else "")


def connected(count: int, pairs: Index) -> Index:
    """Return the component of each of ``count`` places, of which pairs ``(L, 2)`` are connected, as they appear."""
    label, before = np.arange(count), np.zeros(count, int)
    while not np.array_equal(label, before):  # the least number spreads; a joint has a few pixels
        before = label.copy()
        np.minimum.at(label, pairs, label[pairs].min(axis=1, keepdims=True))
    return np.unique(label, return_inverse=True)[1]


def _price(branch: Branch, width: float) -> float:
    """Return the cost of sharing a branch, nats: of its length, and more where it is slender."""
    return branch.length / width * float(np.interp(branch.radius / width, (_ALONE, _TWO), _PER_WIDTH).mean())


class Overlap(NamedTuple):
    """Two strands along a shared branch.

    Args:
        paths: By the end where a strand comes in and the one where it goes out, its centre on the way, ``(P, 2)``
            pixels; both ways.
        seen: Along so many widths the silhouette shows the two side by side, less where it is thinner than both.
    """

    paths: dict[tuple[int, int], Array]
    seen: float


def follow(branch: Branch, starts: list[int], ends: list[int], leads: dict[int, Lead], width: float) -> Overlap | None:
    """Follow two strands along the branch they share; None where it is too thin to decide.

    Where they lie on top of each other they change sides.

    Args:
        branch: With the skeleton's radii.
        starts: The two strands at its first node.
        ends: The two strands at its last node.
        leads: How they leave.
        width: Of one strand, pixels.
    """
    arc = arc_length(np.ascontiguousarray(branch.points))
    steps = round(_JITTER * width * (len(arc) - 1) / max(float(arc[-1]), 1e-9))
    thick = np.asarray(cv2.dilate(branch.radius[:, None], np.ones((2 * steps + 1, 1))), np.float64)[:, 0] / width
    if _ONE <= thick.min() < _TWO:
        return None
    waists, start = [0], -1
    for i, value in enumerate(thick):
        if start < 0 and value < _ONE:
            start = i
        if start >= 0 and (value > _TWO or i == len(arc) - 1):
            waists.append((start + i + 1) // 2)
            start = -1
    side = 1 - 2 * ((np.searchsorted(waists, np.arange(len(arc)), "right") - 1) % 2)  # of what begins on the right
    near, far = np.searchsorted(arc, (min(width, arc[-1]), max(arc[-1] - width, 0.0)))
    first = _by_side(starts, leads, branch.points[near], 1)
    last = _by_side(ends, leads, branch.points[far], -1)[:: side[-1]]
    tangent = np.gradient(branch.points, axis=0)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / np.maximum(np.hypot(*tangent.T), 1e-9)[:, None]
    offset = (side * np.maximum(branch.radius - width / 2, 0.0))[:, None] * normal
    paths: dict[tuple[int, int], Array] = {}
    for start, end, path in zip(first, last, (branch.points - offset, branch.points + offset), strict=True):
        paths |= {(start, end): path, (end, start): np.ascontiguousarray(path[::-1])}
    return Overlap(paths, float(np.interp(thick, (_TWO, 1.0), (0.0, 1.0)).mean() * arc[-1] / width))


def _by_side(ends: list[int], leads: dict[int, Lead], on: Array, way: int) -> list[int]:
    """Return ends from left to right, as seen along a shared branch with a point on it, which they enter or leave."""
    middle = sum(leads[end].point for end in ends) / len(ends)
    ahead = way * (complex(*on) - middle)
    return sorted(ends, key=lambda end: ((leads[end].point - middle) * ahead.conjugate()).imag)
