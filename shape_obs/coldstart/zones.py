"""Where strands meet: the nodes of a skeleton gathered into zones that every rope passes straight through.

Strands that cross at a steep angle thin to nodes within one another's reach. At an acute angle, or side by side, they
share a branch for a while, from the node where they meet to the one where they part. A rope that passes through leaves
an even number of branches at a zone, so which odd zones share a branch is a matching (as in route inspection: Kwan,
"Graphic Programming Using Odd or Even Points", 1962).
"""

from __future__ import annotations

from functools import cache
from typing import Final, NamedTuple

import numpy as np

from shape_obs.coldstart.skeleton import Branch, Skeleton

Arm = tuple[int, int]  # a branch, and which of its ends

# What it costs that a rope ends in the middle of a mask, as widths of a shared branch: two such ends are dearer than
# any crossing's shared branch, and cheaper than a rope lying on itself for this far.
_END: Final = 8.0
# The price of a width of a shared branch where its radius is that of one strand, and of two side by side, in widths.
_THICK: Final = (0.55, 0.8)
_PER_WIDTH: Final = (3.0, 0.2)
# Of the sum of both radii.
_WITHIN: Final = 0.5
_MOST_ODD: Final = 16  # the matching is found by trying all; beyond, each zone takes its nearest


class Zones(NamedTuple):
    """Where strands meet.

    Args:
        kept: The branches that one strand runs along.
        shared: The branches that two run along.
        of: The zone of either end of every kept and shared branch.
    """

    kept: tuple[int, ...]
    shared: tuple[int, ...]
    of: dict[Arm, int]


def find_zones(skeleton: Skeleton) -> Zones:
    """Gather the nodes of a skeleton into zones."""
    branches = skeleton.branches
    parent = {node: node for branch in branches for node in branch.nodes}
    shared = _matching(branches, skeleton.width)
    for i in shared:
        _union(parent, *branches[i].nodes)
    degree = _degrees(branches)
    within = [i for i, branch in enumerate(branches) if i not in shared and _is_within(branch, degree)]
    for i in within:
        _union(parent, *branches[i].nodes)
    of = {(i, end): _find(parent, branch.nodes[end]) for i, branch in enumerate(branches) for end in (0, 1)}
    kept = tuple(i for i in range(len(branches)) if i not in {*shared, *within})
    return Zones(kept, tuple(shared), of)


def _is_within(branch: Branch, degree: dict[int, int]) -> bool:
    """Whether a branch joins two nodes that are one: either lies well inside the largest disc about the other."""
    first, second = branch.nodes
    joins = first != second and min(degree[first], degree[second]) > 1
    return joins and branch.length <= _WITHIN * (branch.radius[0] + branch.radius[-1])


def _matching(branches: tuple[Branch, ...], width: float) -> list[int]:
    """The branches that two strands share: each odd zone lies at one of them at most, or holds the end of a rope."""
    degree = _degrees(branches)
    odd = sorted(zone for zone, count in degree.items() if count % 2 and count > 1)
    place = {zone: bit for bit, zone in enumerate(odd)}
    links: list[list[tuple[float, int, int]]] = [[] for _ in odd]
    for i, branch in enumerate(branches):
        first, second = (place.get(node) for node in branch.nodes)
        if first is not None and second is not None and first != second:
            low, high = sorted((first, second))
            links[low].append((_price(branch, width), high, i))

    @cache
    def best(left: int) -> tuple[float, tuple[int, ...]]:
        """The cheapest way to match the zones in a set of bits."""
        if not left:
            return 0.0, ()
        low = (left & -left).bit_length() - 1
        rest = left & ~(1 << low)
        options = [(_END + best(rest)[0], best(rest)[1])]
        for price, high, i in links[low]:
            if rest >> high & 1:
                cost, chosen = best(rest & ~(1 << high))
                options.append((price + cost, (*chosen, i)))
        return min(options)

    if len(odd) <= _MOST_ODD:
        return list(best((1 << len(odd)) - 1)[1])
    matched: set[int] = set()
    chosen = []
    for price, low, high, i in sorted((p, low, high, i) for low, row in enumerate(links) for p, high, i in row):
        if price < 2 * _END and not {low, high} & matched:
            matched |= {low, high}
            chosen.append(i)
    return chosen


def _price(branch: Branch, width: float) -> float:
    """Of sharing a branch: its length in widths, counted more where it is slender."""
    slender = np.interp(branch.radius / width, _THICK, _PER_WIDTH)
    return branch.length / width * float(slender.mean())


def _degrees(branches: tuple[Branch, ...]) -> dict[int, int]:
    """How many branches leave each node."""
    degree: dict[int, int] = {}
    for branch in branches:
        for node in branch.nodes:
            degree[node] = degree.get(node, 0) + 1
    return degree


def _find(parent: dict[int, int], node: int) -> int:
    while parent[node] != node:
        node = parent[node]
    return node


def _union(parent: dict[int, int], first: int, second: int) -> None:
    parent[_find(parent, second)] = _find(parent, first)
