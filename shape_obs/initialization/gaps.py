"""The pieces of an interrupted rope joined end to end: what a rope bends over a gap, and the smooth curve it takes."""

from __future__ import annotations

import math
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.polyline import arc_length, interpolate

Array = npt.NDArray[np.float64]

CHORD: Final = 1.5  # widths of rope over which a direction is taken: less follows the pixels, more cuts the bends
NOISE: Final = 0.08  # rad^2, see ``bending``: what noise makes two strands bend, or one way to go on more than another
CLEAR: Final = 0.35  # rad^2: a rope bends less over a gap; what meets another rope at 70 degrees bends 0.37 more
DEARER: Final = 1.15  # times: another way to join that is dearer by less is about as likely
MOST_ORDERED: Final = 8  # pieces or strands of which all orders or pairs are tried: the work doubles with each more
_SHARP: Final = math.radians(75)  # between two chords; in a circle two widths in diameter they turn by 43 degrees
_RAGGED: Final = 0.7  # widths of a piece cut off at a gap: at a slanting cut an axis runs into the sharper corner
STIFFNESS: Final = 24.0  # widths of gap that 1 rad^2 costs over one width: a right angle over five widths costs three
NEAR: Final = 5.0  # widths between ends in one place: two ropes that end there may be one, and one may turn back there


class Bridged(NamedTuple):
    """Pieces joined into one curve.

    Args:
        curve: ``(P, 2)`` pixels.
        bridged: ``(P,)`` bool, the points in the gaps.
        next_best: Price of the best way to join the pieces that differs in a gap, over the price of this one; inf if
            there is no other.
        bent: What a bridge over a wide gap bends at most, see ``bending``; 0 if no gap is wide.
    """

    curve: Array
    bridged: npt.NDArray[np.bool_]
    next_best: float
    bent: float = 0.0


def bridge(pieces: list[Array], width: float) -> Bridged:
    """Join curves into one by smooth bridges, the short and straight ones overall.

    The price of a gap is its length and the bending energy of the bridge.

    Args:
        pieces: ``(P_i, 2)`` curves, pixels, in no particular direction.
        width: Of the rope, pixels.
    """
    if len(pieces) == 1:
        return Bridged(pieces[0], np.zeros(len(pieces[0]), bool), np.inf)
    price = _prices([_cut(piece, width) for piece in pieces], width)
    few = len(pieces) <= MOST_ORDERED
    total, order = cheapest_order(price) if few else _greedy(price)
    next_best = np.inf
    if few:
        for out, into in zip(order[1:-1:2], order[2::2], strict=True):
            without = price.copy()
            without[out, into] = without[into, out] = np.inf
            next_best = min(next_best, cheapest_order(without)[0])
    run: list[Array] = []
    bent = 0.0
    for place, entry in enumerate(order[::2]):
        piece = pieces[entry // 2][:: 1 - 2 * (entry % 2)]
        piece = _cut(piece, width, start=place > 0, end=place < len(pieces) - 1)
        if run:
            before, after = lead(run[-1][::-1], width, 1.0), lead(piece, width, 1.0)
            if np.linalg.norm(piece[0] - run[-1][-1]) > NEAR * width:
                bent = max(bent, bending(before, after))
            run.append(hermite(run[-1][-1], -before.heading, piece[0], after.heading, width / 4))
        run.append(piece)
    is_gap = [np.full(len(part), i % 2 == 1) for i, part in enumerate(run)]
    return Bridged(np.concatenate(run), np.concatenate(is_gap), next_best / max(total, 1e-9), bent)


def _cut(piece: Array, width: float, *, start: bool = True, end: bool = True) -> Array:
    """Return a piece without its ragged ends."""
    piece = np.ascontiguousarray(piece)
    arc = arc_length(piece)
    cut = min(_RAGGED * width, 0.3 * float(arc[-1]))
    low, high = cut * start, arc[-1] - cut * end
    first, last = interpolate(piece, arc, np.array([low, high]))
    return np.concatenate([first[None], piece[(arc > low) & (arc < high)], last[None]])


def _prices(pieces: list[Array], width: float) -> Array:
    """Return the price of going on from each end to each other, ``(2n, 2n)``; end 2 i + e is of piece i."""
    ends = [piece[:: 1 - 2 * e] for piece in pieces for e in (0, 1)]
    leads = [lead(end, width) for end in ends]
    price = np.full((len(ends), len(ends)), np.inf)
    for p, q in combinations(range(len(ends)), 2):
        if p // 2 != q // 2:
            gap = float(np.linalg.norm(ends[q][0] - ends[p][0]))
            reach = float(np.linalg.norm(leads[q].point - leads[p].point)) + width
            bend = bending(leads[p], leads[q])
            price[p, q] = price[q, p] = gap / width + STIFFNESS * bend * width / reach
    return price


@compiled("(f8[:,::1],)")
def cheapest_order(price: Array) -> tuple[float, npt.NDArray[np.int64]]:
    """Return the cheapest way through all pieces, and the ends in its order (Held and Karp, 1962).

    Args:
        price: ``(2n, 2n)`` of going on from each end to each other; end 2 i + e is of piece i.
    """
    size = len(price)
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
    total, done, order = best[full, end], full, np.empty(size, np.int64)
    for at in range(size - 1, -1, -2):
        order[at], order[at - 1] = end, end ^ 1
        done, end = done ^ 1 << end // 2, came[done, end]
    return total, order


def _greedy(price: Array) -> tuple[float, npt.NDArray[np.int64]]:
    """Join the cheapest gap first, as long as it closes no ring."""
    size = len(price)
    far = {end: end ^ 1 for end in range(size)}  # the other end of the chain that begins here
    next_end: dict[int, int] = {}
    total = 0.0
    for place in np.argsort(price, axis=None):
        p, q = divmod(int(place), size)
        if p in far and q in far and q not in (p, far[p]):
            next_end[p], next_end[q] = q, p
            total += float(price[p, q])
            first, second = far.pop(p), far.pop(q)
            far[first], far[second] = second, first
    end = min(far)
    order = [end, end ^ 1]
    while order[-1] in next_end:
        order += [next_end[order[-1]], next_end[order[-1]] ^ 1]
    return total, np.array(order)


class Lead(NamedTuple):
    """How a strand leaves a zone or a gap: from a point (u, v) where it is clear of it, in pixels, away from it."""

    u: float
    v: float
    heading_u: float
    heading_v: float

    @property
    def point(self) -> Array:
        """``(2,)`` pixels."""
        return np.array([self.u, self.v])

    @property
    def heading(self) -> Array:
        """``(2,)`` unit vector, away from the zone."""
        return np.array([self.heading_u, self.heading_v])


def lead(curve: Array, width: float, chord: float = CHORD) -> Lead:
    """Return how a rope of a width, ``(P, 2)`` pixels, leaves its first point: the direction of its first chord.

    On a bend a chord is parallel to the tangent in its middle, so the two belong together.
    """
    return Lead(*first_chord(np.ascontiguousarray(curve), chord * width))


@compiled("(f8[:,::1], f8)")
def first_chord(curve: Array, reach: float) -> tuple[float, float, float, float]:
    """Return the point in the middle of the first ``reach`` pixels of a curve, and the direction of their chord."""
    arc = arc_length(curve)
    reach = min(reach, arc[-1])
    start, middle, end = interpolate(curve, arc, np.array([0.0, reach / 2, reach]))
    along = max(np.hypot(end[0] - start[0], end[1] - start[1]), 1e-9)
    return middle[0], middle[1], (end[0] - start[0]) / along, (end[1] - start[1]) / along


def bending(before: Lead, after: Lead) -> float:
    """Return how much a smooth curve between two strands bends: bending energy times length over 4, rad^2.

    Both headings point away from the gap. Of a cubic that turns by a and b from its chord at its ends the energy is
    4 (a^2 - a b + b^2) over its length: an arc is cheaper than an S.
    """
    u, v = after.u - before.u, after.v - before.v
    first = _turn(-before.heading_u, -before.heading_v, u, v)
    second = _turn(u, v, after.heading_u, after.heading_v)
    return first * first - first * second + second * second


@compiled("(f8[:,::1], f8)")
def sharp_turns(points: Array, width: float) -> int:
    """Return how often a curve turns more sharply between two chords that meet than ropes do.

    Args:
        points: ``(P, 2)`` pixels.
        width: Of the rope, pixels.
    """
    arc, reach, limit = arc_length(points), CHORD * width, math.cos(_SHARP)
    found, free, before, after = 0, 0.0, 0, 0
    for p in range(len(points)):
        if arc[p] < reach or arc[-1] - arc[p] < reach:
            continue
        while arc[before + 1] <= arc[p] - reach:
            before += 1
        while arc[after] < arc[p] + reach and after < len(points) - 1:
            after += 1
        if arc[p] < free:
            continue
        du, dv = points[p, 0] - points[before, 0], points[p, 1] - points[before, 1]
        far_u, far_v = points[after, 0] - points[p, 0], points[after, 1] - points[p, 1]
        if du * far_u + dv * far_v < limit * np.hypot(du, dv) * np.hypot(far_u, far_v):
            found += 1
            free = arc[p] + 2 * reach  # one turn is counted once
    return found


@compiled("(f8[::1], f8[::1], f8[::1], f8[::1], f8)")
def hermite(start: Array, out: Array, end: Array, into: Array, step: float) -> Array:
    """Return a smooth curve between two points with given unit tangents along the way: ``(P, 2)``, without ends."""
    length = np.hypot(end[0] - start[0], end[1] - start[1])
    pieces = max(int(np.rint(length / step)), 1)
    curve = np.empty((pieces - 1, 2))
    for p in range(pieces - 1):
        t = (p + 1) / pieces
        for d in range(2):
            curve[p, d] = (1 + 2 * t) * (1 - t) ** 2 * start[d] + t**2 * (3 - 2 * t) * end[d]
            curve[p, d] += t * (1 - t) * length * ((1 - t) * out[d] - t * into[d])
    return curve


def _turn(u: float, v: float, next_u: float, next_v: float) -> float:
    """Return the signed angle from one direction to another, radians."""
    return math.atan2(u * next_v - v * next_u, u * next_u + v * next_v)
