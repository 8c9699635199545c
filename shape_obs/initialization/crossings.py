"""Which strand goes on where: a skeleton's branches strung together into ropes.

Where strands meet, the ends of branches are paired at the least cost, except that no strand may close upon itself while
another one passes through the same zone.
"""

from __future__ import annotations

from cmath import phase
from itertools import combinations
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.initialization.appearance import Look, Picture, looks_of_ends, misfit
from shape_obs.initialization.junctions import Overlap, Zones, find_zones, follow, merge_nodes
from shape_obs.initialization.pairing import END, ONTO, SURE, Index, Lead, cheapest_pairing, lead, price_of, routes
from shape_obs.initialization.skeleton import Branch, Skeleton, middle_value
from shape_obs.initialization.strand_curves import Strand, clear_part, smooth_branch, strand_curve

Array = npt.NDArray[np.float64]

_TOUCH: Final = 0.75  # nats for each of two strands that meet and do not cross
_DENIED: Final = 1.5  # nats for each width along which the silhouette shows that a strand goes on otherwise
_ITSELF: Final = 70.0  # nats that one rope ends on itself: only two ends are left then
_WIDE: Final = 3.0  # times a strand's median width: places where ropes meet are narrower, other things may be wider


def untangle(skeleton: Skeleton, picture: Picture | None = None, *, several: bool = False) -> list[Strand]:
    """String the branches of a skeleton together.

    Args:
        skeleton: Of one or several pieces of rope.
        picture: ``(H, W, 3)`` RGB, in which ropes may have colours of their own; None without one.
        several: Whether the strands are of several ropes, which may differ in width and colour and end on each other.

    Returns:
        Strands at steps of about a pixel, and why each may be wrong. Every branch is part of one of them, but the
        shared ones of two.
    """
    skeleton, width = merge_nodes(skeleton), skeleton.width
    branches = [smooth_branch(branch, width) for branch in skeleton.branches]
    zones = find_zones(skeleton)
    groups: dict[int, list[int]] = {}
    for end in (2 * i + e for i in zones.kept for e in (0, 1)):
        groups.setdefault(int(zones.of[end]), []).append(end)
    free = {group[0] for group in groups.values() if len(group) == 1}
    trimmed = {i: clear_part(branches[i], 2 * i in free, 2 * i + 1 in free, width) for i in zones.kept}
    leads = {2 * i + e: lead(trimmed[i][:: 1 - 2 * e], width) for i in zones.kept for e in (0, 1)}
    overlaps = _overlaps(branches, zones, groups, leads, width)
    met = [end for group in groups.values() if len(group) > 1 for end in group]
    looks = looks_of_ends(branches, met, free, picture) if several else dict.fromkeys(met, Look())
    price = np.full((2 * len(branches),) * 2, np.inf)
    np.fill_diagonal(price, ONTO if several else _ITSELF)
    for zone, group in groups.items():
        _set_prices(price, group, leads, looks, overlaps.get(zone), width)
    partner, margin = _paired(price, zones)
    ways = {pair: path for overlap in overlaps.values() for pair, path in overlap.paths.items()}
    strands = []
    for route in routes(partner, zones.kept):
        ends = route[0], route[-1] ^ 1
        inner = [end for at in route for end in (at, at ^ 1) if partner[end] != end]
        reasons = [zones.doubt] if zones.doubt else []
        if (margin[inner] < SURE).any():
            reasons.append("at a crossing, two ways to go on are about equally straight")
        radius = np.concatenate([skeleton.branches[end // 2].radius for end in route])
        half, most = middle_value(radius), float(radius.max())
        if several and any(_may_go_on(end, price, partner, margin) for end in ends):
            reasons.append("it ends on another rope, and may as well go on there")
        if several and most > _WIDE * half:
            reasons.append(f"it runs through something {most / half:.1f} times as wide")
        curve = strand_curve(route, trimmed, partner, ways, width)
        inside, closed = (ends[0] not in free, ends[1] not in free), bool(partner[route[0]] != route[0])
        strands.append(Strand(curve, max(2 * half, 1.0), inside, closed, tuple(reasons)))
    return strands


def _set_prices(
    price: Array,
    group: list[int],
    leads: dict[int, Lead],
    looks: dict[int, Look],
    overlap: Overlap | None,
    width: float,
) -> None:
    """Set the price of each pair of the ends that meet in a zone, nats.

    A strand passes between the others, as many to its left as to its right, or it touches some without crossing them.
    """
    middle = sum(leads[end].point for end in group) / len(group)
    around = sorted(group, key=lambda end: phase(leads[end].point - middle))
    for (k, a), (n, b) in combinations(enumerate(around), 2):
        cost = price_of(leads[a], leads[b], width) + misfit(looks[a], looks[b])
        cost += _TOUCH * (abs(len(group) - 2 * (n - k)) // 2)
        cost += _DENIED * overlap.seen if overlap is not None and (a, b) not in overlap.paths else 0.0
        price[a, b] = price[b, a] = cost


def _overlaps(
    branches: list[Branch], zones: Zones, groups: dict[int, list[int]], leads: dict[int, Lead], width: float
) -> dict[int, Overlap]:
    """Return what happens in the zones where two strands meet and part along one shared branch."""
    found = {}
    for i in zones.shared:
        group, nodes = groups.get(int(zones.of[2 * i]), []), zones.nodes[2 * i : 2 * i + 2]
        starts, ends = ([end for end in group if zones.nodes[end] == node] for node in nodes)
        if len(starts) == len(ends) == 2 and len(group) == 4:
            overlap = follow(branches[i], starts, ends, leads, width)
            if overlap is not None:
                found[int(zones.of[2 * i])] = overlap
    return found


def _paired(price: Array, zones: Zones) -> tuple[Index, Array]:
    """Return the cheapest pairing and its margins, without rings that another strand meets and that it can join.

    The pair of a ring is barred that is cheapest to bar, as long as that leaves fewer strands.
    """
    partner, margin = cheapest_pairing(price)
    strands = routes(partner, zones.kept)
    rings = [end for route in strands if partner[route[0]] != route[0] for end in route]
    for end in sorted(rings, key=lambda end: margin[end]):
        barred, other = [end, int(partner[end])], price.copy()
        other[np.ix_(barred, barred)] = np.inf
        opened, sure = cheapest_pairing(other)
        if len(routes(opened, zones.kept)) < len(strands):
            price, partner, margin, strands = other, opened, sure, routes(opened, zones.kept)
    return partner, margin


def _may_go_on(end: int, price: Array, partner: Index, margin: Array) -> bool:
    """Return whether a strand that ends on another one may go on along it, which on its own would be the cheaper."""
    others = np.delete(price[end], end)
    return partner[end] == end and bool(margin[end] < SURE or others.min() + END < price[end, end])
