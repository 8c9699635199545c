"""Which strand goes on where: a skeleton's branches strung together into ropes.

Within a zone where strands meet, every way to pair them is tried and the least bent one taken, except that no strand
may close upon itself while another one passes through the same zone.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.initialization.appearance import Look, Picture, are_unlike, looks_of_arms
from shape_obs.initialization.gaps import MOST_ORDERED, Lead, bending, lead
from shape_obs.initialization.junctions import Arm, Overlap, Zones, find_zones, follow, is_bent, merge_nodes
from shape_obs.initialization.skeleton import Branch, Skeleton, middle_value
from shape_obs.initialization.strand_curves import Strand, clear_part, smooth_branch, strand_curve
from shape_obs.initialization.strand_doubts import margin_of, strand_doubts, zone_doubts

Array = npt.NDArray[np.float64]
Pairing = tuple[tuple[Arm, Arm], ...]
Options = dict[int, list[tuple[float, Pairing]]]  # of each zone: what a pairing bends, and the pairing; least first

_CHORD: Final = 1.2  # widths of a branch over which its direction is taken: less than of an end, as branches are short
_DENIED: Final = 5.0  # rad^2 that it costs to join two strands that the silhouette denies: as two U-turns bend
_PARTED: Final = 15.0  # rad^2 that it costs that two strands end because they are unlike: more than all that is denied


def untangle(skeleton: Skeleton, picture: Picture | None = None, *, several: bool = False) -> list[Strand]:
    """String the branches of a skeleton together.

    Args:
        skeleton: Of one or several pieces of rope.
        picture: ``(H, W, 3)`` RGB, in which ropes may have colours of their own; None without one.
        several: Whether the strands are of several ropes, which may differ in width and colour and end on each other.

    Returns:
        As few strands as the free ends allow, bent as little as possible, at steps of about a pixel. Every branch is
        part of one of them, but the shared ones of two.
    """
    skeleton, width = merge_nodes(skeleton), skeleton.width
    branches = [smooth_branch(branch, width) for branch in skeleton.branches]
    zones = find_zones(skeleton)
    groups: dict[int, list[Arm]] = {}
    for i in zones.kept:
        for end in (0, 1):
            groups.setdefault(zones.of[i, end], []).append((i, end))
    free = {group[0] for group in groups.values() if len(group) == 1}
    trimmed = {i: clear_part(branches[i], (i, 0) in free, (i, 1) in free, width) for i in zones.kept}
    leads = {(i, end): lead(trimmed[i][:: 1 - 2 * end], width, _CHORD) for i in zones.kept for end in (0, 1)}
    overlaps = _overlaps(branches, zones, groups, leads, width)
    if several:
        overlaps = {zone: each for zone, each in overlaps.items() if not is_bent(each, leads)}
    met = [arm for group in groups.values() if several and len(group) > 1 for arm in group]
    looks = looks_of_arms(branches, met, free, picture)
    options = {
        zone: _options(group, leads, overlaps.get(zone), looks) for zone, group in groups.items() if len(group) > 1
    }
    chosen = dict.fromkeys(options, 0)
    _open_rings(options, chosen, zones.kept)
    partner = _partners(options, chosen)
    routes = _routes(zones.kept, partner)
    ways = {pair: path for overlap in overlaps.values() for pair, path in _ways(overlap)}
    doubt_at, everywhere = dict(zone_doubts(options, chosen, overlaps)), (zones.doubt,) if zones.doubt else ()
    passed = [{zones.of[i, end] for i, _ in route for end in (0, 1)} for route in routes]
    curves = [strand_curve(route, trimmed, partner, ways, width) for route in routes]
    ends = [(route[0], (route[-1][0], 1 - route[-1][1])) for route in routes]
    inside = [(first not in free, last not in free) for first, last in ends]
    own: list[list[str]] = [[] for _ in routes]
    if several:
        margin = {zone: margin_of(row, chosen[zone]) for zone, row in options.items()}
        margins = [(margin.get(zones.of[a], np.inf), margin.get(zones.of[b], np.inf)) for a, b in ends]
        radii = [np.concatenate([skeleton.branches[i].radius for i, _ in route]) for route in routes]
        own = strand_doubts(curves, inside, margins, radii, width)
    return [
        Strand(
            curve,
            _width(skeleton.branches, route),
            lies_on_others,
            route[0] in partner,
            (*(doubt_at[zone] for zone in sorted(at & doubt_at.keys())), *more, *everywhere),
        )
        for curve, route, lies_on_others, at, more in zip(curves, routes, inside, passed, own, strict=True)
    ]


def _width(branches: tuple[Branch, ...], route: list[Arm]) -> float:
    """Return how wide a strand is, pixels: twice the median radius along its branches."""
    return max(2 * middle_value(np.concatenate([branches[i].radius for i, _ in route])), 1.0)


def _overlaps(
    branches: list[Branch], zones: Zones, groups: dict[int, list[Arm]], leads: dict[Arm, Lead], width: float
) -> dict[int, Overlap]:
    """Return what happens in the zones where two strands meet and part along one shared branch."""
    found = {}
    for i in zones.shared:
        zone = zones.of[i, 0]
        sides: list[list[Arm]] = [[], []]
        for arm in groups.get(zone, []):
            node = branches[arm[0]].nodes[arm[1]]
            if node in branches[i].nodes:
                sides[branches[i].nodes.index(node)].append(arm)
        if len(sides[0]) == len(sides[1]) == 2 and len(groups[zone]) == 4:
            overlap = follow(branches[i], sides[0], sides[1], leads, width)
            if overlap is not None:
                found[zone] = overlap
    return found


def _ways(overlap: Overlap) -> Iterator[tuple[tuple[Arm, Arm], Array]]:
    """Return the paths of an overlap, both ways."""
    for (first, last), path in zip(overlap.pairs, overlap.paths, strict=True):
        yield (first, last), path
        yield (last, first), np.ascontiguousarray(path[::-1])


def _options(
    group: list[Arm], leads: dict[Arm, Lead], overlap: Overlap | None, looks: dict[Arm, Look]
) -> list[tuple[float, Pairing]]:
    """Return all ways to pair the strands of a zone and their bend, least first; of an odd number one ends here.

    Strands that are unlike are not paired: both end here.
    """
    cost = {(a, b): bending(leads[a], leads[b]) for n, a in enumerate(group) for b in group[n + 1 :]}
    unlike = {pair for pair in cost if looks and are_unlike(looks[pair[0]], looks[pair[1]])}
    if len(group) > MOST_ORDERED:
        pairing: list[tuple[Arm, Arm]] = []
        for a, b in sorted(cost.keys() - unlike, key=lambda pair: (cost[pair], pair)):
            if not any({a, b} & set(pair) for pair in pairing):
                pairing.append((a, b))
        return [(sum(cost[pair] for pair in pairing), tuple(pairing))]
    denied = {frozenset(pair) for pair in overlap.denied} if overlap is not None else set()
    price = {pair: bend + _DENIED * (frozenset(pair) in denied) for pair, bend in cost.items()}
    price |= dict.fromkeys(unlike, _PARTED)
    kept: dict[Pairing, float] = {}
    for pairs in _pairings(group):
        joined = tuple(pair for pair in pairs if pair not in unlike)
        kept[joined] = min(sum(price[pair] for pair in pairs), kept.get(joined, np.inf))
    return sorted((total, joined) for joined, total in kept.items())


def _pairings(group: list[Arm]) -> Iterator[Pairing]:
    """Return every way to pair as many of a group as possible."""
    if len(group) < 2:
        yield ()
        return
    if len(group) % 2:
        for i in range(len(group)):
            yield from _pairings(group[:i] + group[i + 1 :])
        return
    for i in range(1, len(group)):
        for rest in _pairings(group[1:i] + group[i + 1 :]):
            yield (group[0], group[i]), *rest


def _partners(options: Options, chosen: dict[int, int]) -> dict[Arm, Arm]:
    """Return where each strand goes on."""
    pairs = [pair for zone, row in options.items() for pair in row[chosen[zone]][1]]
    return dict(pairs) | {b: a for a, b in pairs}


def _routes(kept: tuple[int, ...], partner: dict[Arm, Arm]) -> list[list[Arm]]:
    """Return the strands: by which arm each branch is entered. Those with ends first, rings after them."""
    arms = [(i, end) for i in kept for end in (0, 1)]
    routes, done = [], set()
    for start in sorted(arms, key=lambda arm: arm in partner):
        if start[0] in done:
            continue
        route, arm = [], start
        while arm is not None and arm[0] not in done:
            done.add(arm[0])
            route.append(arm)
            arm = partner.get((arm[0], 1 - arm[1]))
        routes.append(route)
    return routes


def _open_rings(options: Options, chosen: dict[int, int], kept: tuple[int, ...]) -> None:
    """Change the pairing where it costs least, and where a ring is then joined to another strand."""

    def count() -> tuple[int, int]:
        partner = _partners(options, chosen)
        routes = _routes(kept, partner)
        return sum(route[0] in partner for route in routes), len(routes)

    changes = [(row[k][0] - row[0][0], zone, k) for zone, row in options.items() for k in range(1, len(row))]
    rings, strands = count()
    for _, zone, k in sorted(changes) if rings else ():
        before, chosen[zone] = chosen[zone], k
        after = count()
        if after[0] < rings and after[1] < strands:
            rings, strands = after
        else:
            chosen[zone] = before
