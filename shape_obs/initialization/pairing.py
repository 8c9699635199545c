"""Which strand ends belong together: the least-cost pairing of ends that compete, with all evidence in nats.

Strands meet at crossings, are cut by gaps in a mask, and run along shared branches, and each time the question is
which end goes on as which other one, and which ends there. All pairings of ends that compete are compared at once
(a minimum-cost matching); a pair is the more certain, the dearer the best pairing without it is.
"""

from __future__ import annotations

import math
from cmath import phase
from collections.abc import Iterable
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.image.connected_runs import find_root

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

CHORD: Final = 1.5  # widths of rope over which a direction is taken: less follows the pixels, more cuts the bends
END: Final = 2.2  # nats that a rope ends in a place where it could go on
ONTO: Final = 9.0  # nats that it ends right on another one
SURE: Final = 1.2  # nats by which all others are dearer if a way is sure: odds of 3 to 1
NARROW: Final = 1.0  # widths of a gap that cost a nat: what noise, or another rope, leaves out of a mask
_STIFFNESS: Final = 48.0  # nats that 1 rad^2 costs over one width: a right angle over five widths costs six
MOST: Final = 10  # ends, or pieces of a rope, of which all pairings are compared: the work doubles with each more


class Lead(NamedTuple):
    """How a strand leaves a zone or a gap, in the complex plane u + v i of pixels.

    Args:
        point: Where it is clear of the place.
        heading: Of length 1, away from the place.
    """

    point: complex
    heading: complex


def lead(curve: Array, width: float, chord: float = CHORD) -> Lead:
    """Return how a rope of a width, ``(P, 2)`` pixels, leaves its first point: the direction of its first chord.

    On a bend a chord is parallel to the tangent in its middle, so the two belong together.
    """
    return Lead(*first_chord(np.ascontiguousarray(curve), chord * width))


@compiled("(f8[:,::1], f8)")
def first_chord(curve: Array, reach: float) -> tuple[complex, complex]:
    """Return the point in the middle of the first ``reach`` pixels of a curve, and the direction of their chord."""
    arc = arc_length(curve)
    reach = min(reach, arc[-1])
    start, middle, end = interpolate(curve, arc, np.array([0.0, reach / 2, reach]))
    chord = complex(end[0] - start[0], end[1] - start[1])
    return complex(middle[0], middle[1]), chord / max(abs(chord), 1e-9)


def bending(before: Lead, after: Lead) -> float:
    """Return how much a smooth curve between two strands bends: bending energy times length over 4, rad^2.

    Both headings point away from the gap. Of a cubic that turns by a and b from its chord at its ends the energy is
    4 (a^2 - a b + b^2) over its length: an arc is cheaper than an S.
    """
    chord = after.point - before.point
    first, second = phase(-chord * before.heading.conjugate()), phase(after.heading * chord.conjugate())
    return first * first - first * second + second * second


def price_of(before: Lead, after: Lead, width: float) -> float:
    """Return what it costs that a strand goes on as another one, nats.

    The longer the way, the more a rope bends along it: the variance of the bend grows with the length.

    Args:
        before: How the one leaves the place.
        after: How the other one does.
        width: Of the rope, pixels.
    """
    return _STIFFNESS * bending(before, after) * width / (abs(after.point - before.point) + width)


@compiled("(f8[:,::1],)")
def cheapest_pairing(price: Array) -> tuple[Index, Array]:
    """Return the cheapest pairing of ends, and how certain each pair is.

    A pair that is dearer than two ends that stay alone, by what is sure, connects no ends that compete.

    Args:
        price: ``(E, E)`` nats of each pair, inf if it cannot be; in the diagonal what it costs that an end stays alone.

    Returns:
        ``(E,)`` the partner of each end, itself if it stays alone; ``(E,)`` by how many nats the best pairing without
        this pair is dearer, where more than ``MOST`` compete the cheapest other choice of one of the two.
    """
    count = len(price)
    partner, margin, group = np.arange(count), np.full(count, np.inf), np.arange(count)
    for i in range(count):
        for j in range(i):
            if price[i, j] < price[i, i] + price[j, j] + SURE:
                first, second = find_root(group, i), find_root(group, j)
                group[max(first, second)] = min(first, second)
    for root in range(count):
        ends = np.array([end for end in range(root, count) if find_root(group, end) == root])
        if len(ends) > MOST:
            alone, dearer = np.diag(price), np.full((count, count), np.inf)  # than if both stay alone
            alone = np.where(np.isinf(alone), 0.0, alone)  # one that may not
            for i in ends:
                for j in ends:
                    dearer[i, j] = price[i, j] - alone[i] - alone[j] * (i != j)
            _pair_in_turn(dearer, partner, margin, np.arange(count))
        elif len(ends) > 1:
            _solve(_pair, price, ends, partner, margin)
    return partner, margin


@compiled
def _solve(cheapest: Any, price: Array, ends: Index, partner: Index, margin: Array) -> None:
    """Write the cheapest choice of pairs into ``(E,)``, and by how much the best one without each pair is dearer.

    Args:
        cheapest: ``_pair`` or ``_order``.
        price: ``(E, E)``.
        ends: Those that are paired.
        partner: ``(E,)``.
        margin: ``(E,)``.
    """
    total, others = cheapest(price, ends, partner), partner.copy()
    for i in ends:
        j, kept = partner[i], price[i, partner[i]]
        if i <= j and kept < np.inf:
            price[i, j] = price[j, i] = np.inf
            margin[i] = margin[j] = cheapest(price, ends, others) - total
            price[i, j] = price[j, i] = kept


@compiled
def _pair(price: Array, ends: Index, partner: Index) -> float:
    """Write the cheapest pairing of some ends into ``(E,)`` and return its price, by that of every set of them."""
    best, chosen = np.zeros(1 << len(ends)), np.zeros(1 << len(ends), np.int64)
    last = 0  # the highest of a set: one of its pairs holds it
    for some in range(1, len(best)):
        last += some >> last > 1
        rest = some ^ 1 << last
        best[some], chosen[some] = price[ends[last], ends[last]] + best[rest], last
        for k in range(last):
            if rest >> k & 1 and price[ends[last], ends[k]] + best[rest ^ 1 << k] < best[some]:
                best[some], chosen[some] = price[ends[last], ends[k]] + best[rest ^ 1 << k], k
    some = len(best) - 1
    for last in range(len(ends) - 1, -1, -1):
        if some >> last & 1:
            first, second = ends[chosen[some]], ends[last]
            partner[first], partner[second] = second, first
            some &= ~(1 << last | 1 << chosen[some])
    return best[len(best) - 1]


@compiled
def _pair_in_turn(price: Array, partner: Index, margin: Array, far: Index) -> None:
    """Pair ends into ``(E,)``, each time the cheapest pair that is left, and write how clearly each was the cheapest.

    Args:
        price: ``(E, E)``, of an end that stays alone in the diagonal; overwritten.
        partner: ``(E,)``.
        margin: ``(E,)``, by how much each other choice of the two was dearer.
        far: ``(E,)`` the other end of the chain of pieces of each, which it is not joined with; itself if it may be
            joined with any; overwritten.
    """
    while True:
        first, second = divmod(int(np.argmin(price)), len(price))
        least = price[first, second]
        if math.isinf(least):
            return
        price[first, second] = price[second, first] = np.inf
        beyond = min(price[first].min(), price[second].min()) - least
        for end, other in ((first, second), (second, first)):
            partner[end], margin[end] = other, beyond
            price[end], price[:, end] = np.inf, np.inf
        if far[first] != first:
            one, other = far[first], far[second]
            far[one], far[other] = other, one
            price[one, other] = price[other, one] = np.inf


@compiled("(f8[:,::1],)")
def cheapest_order(price: Array) -> tuple[Index, Array]:
    """Return the cheapest way through all pieces of a rope, as ends that follow each other, and how certain each is.

    Args:
        price: ``(2n, 2n)`` of going on from each end to each other; end 2 i + e is of piece i; inf in the diagonal.

    Returns:
        ``(2n,)`` the end that each goes on as, itself at the two ends of the rope, and ``(2n,)`` the margin of that,
        see ``cheapest_pairing``.
    """
    size = len(price)
    partner, margin = np.arange(size), np.full(size, np.inf)
    if size > 2 * MOST:
        _pair_in_turn(price.copy(), partner, margin, np.arange(size) ^ 1)
    else:
        _solve(_order, price, np.arange(size), partner, margin)
    return partner, margin


@compiled
def _order(price: Array, ends: Index, partner: Index) -> float:
    """Write the cheapest way through all pieces into ``(2n,)`` and return its price (Held and Karp, 1962)."""
    size = len(ends)
    full = (1 << size // 2) - 1
    best, came = np.full((full + 1, size), np.inf), np.zeros((full + 1, size), np.int64)
    for end in range(size):
        best[1 << end // 2, end] = 0.0
    for done in range(1, full):
        for entry in range(size):
            if done >> entry // 2 & 1:
                continue
            then = done | 1 << entry // 2
            for end in range(size):
                if best[done, end] + price[end, entry] < best[then, entry ^ 1]:
                    best[then, entry ^ 1] = best[done, end] + price[end, entry]
                    came[then, entry ^ 1] = end
    end = int(np.argmin(best[full]))
    total, done = best[full, end], full
    partner[end] = end
    for _ in range(size // 2 - 1):
        before = came[done, end]
        done ^= 1 << end // 2
        partner[before], partner[end ^ 1] = end ^ 1, before
        end = before
    partner[end ^ 1] = end ^ 1
    return total


def routes(partner: Index, curves: Iterable[int]) -> list[list[int]]:
    """Return curves strung together: by which end each is entered. Strands with ends come first, then rings.

    Args:
        partner: ``(E,)`` which end goes on as which, itself if as none; ends 2 i and 2 i + 1 are those of curve i.
        curves: Those that are strung together.
    """
    found: list[list[int]] = []
    done: set[int] = set()
    for start in sorted((2 * i + e for i in curves for e in (0, 1)), key=lambda end: partner[end] != end):
        route, end = list[int](), start
        while end // 2 not in done:
            done.add(end // 2)
            route.append(end)
            end = int(partner[end ^ 1])
        if route:
            found.append(route)
    return found
