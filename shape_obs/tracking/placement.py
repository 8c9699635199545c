"""Which piece of a known rope a visible curve is.

For each way to share out what is missing of a rope (at its start, at its end, in a gap, or because the measurement is
short), the cost is how badly the visible points agree with where their material was expected, how far the measurement
would have to be off, and what is seen at the tips.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.geometry.rotation import covariance_of, largest_trace
from shape_obs.tracking.occluders import FREE, HIDDEN, UNKNOWN

Array = npt.NDArray[np.float64]
Ends = tuple[int, int]

PROBES: Final = np.linspace(0, 1, 32)  # of a visible piece, at which it is compared with the prediction
INDEPENDENT: Final = (4.0, 1.0)  # of the probes: neighbours err alike, and a rope that is elsewhere is so as a whole
NOISE: Final = 0.15  # in resolutions: how far off a curve lies that was predicted perfectly
_AT_REST: Final = 0.35  # in resolutions: a rope at rest is not farther from its prediction
TRUST: Final = 5.0  # squared standard deviations, beyond which costs grow slowly: predictions may be far off
_SHARES: Final = 8  # of what is missing, that may be hidden at an end
# What it costs, in squared standard deviations, to take an end for hidden: one of which nothing is known, one that
# something hides, and a free one, which is then folded back or points at the camera. And by which share of the length
# it changes from frame to frame.
_COST: Final = (4.0, 1.0, 16.0)
_INERTIA: Final = (0.05, 0.1, 0.05)
_FOLDED: Final = 100.0  # of a free end while something hides the other, which explains what is missing
_BRIDGE: Final = 0.35  # of a bridged gap: the standard deviation of its length
_NOISY: Final = 3.0  # standard deviations by which a length may be short, though an end is hidden
_SETTLING: Final = 0.1  # how fast the distance of curves from their predictions is learnt
_OUTLIER: Final = 10.0  # residuals: more is not learnt from at once


class Placed(NamedTuple):
    """Which piece of a known rope a visible curve is.

    Args:
        head: Length of what is hidden at its start, in the unit of the curve's stations.
        tail: The same at its end.
        between: By how much a gap in it is longer than it is bridged.
        bent: Mean square distance from the prediction after the best rigid motion.
        apart: The same as it is.
        rival: By which share of the length more would be hidden elsewhere if the prediction alone decided whether a
            free end is folded back.
    """

    head: float
    tail: float
    between: float
    bent: float
    apart: float
    rival: float


@compiled(
    "(f8[:,::1], f8[::1], f8[:,::1], f8[::1], UniTuple(i8, 2), UniTuple(f8, 2), UniTuple(f8, 2), UniTuple(f8, 2), f8, "
    "f8, f8, f8, UniTuple(i8, 2))"
)
def place(
    rope: Array,
    share: Array,
    points: Array,
    stations: Array,
    ends: Ends,
    cut: tuple[float, float],
    before: tuple[float, float],
    residuals: tuple[float, float],
    missing: float,
    noise: float,
    resolution: float,
    lapse: float,
    gap: tuple[int, int],
) -> Placed:
    """Return how much of a rope is hidden at its start, at its end and in a gap: what costs least.

    If something hides one end, what is missing is taken to be there.

    Args:
        rope: ``(K, D)`` where it is predicted, from tip to tip.
        share: ``(K,)`` where these points lie along it, 0...1.
        points: ``(P, D)`` what is seen of it.
        stations: ``(P,)`` how far along it they lie.
        ends: What is known about its tips.
        cut: How much likelier, as logarithms, they are cut than the rope's own.
        before: Which share of it was hidden at its start and at its end.
        residuals: Mean square distances of curves from their predictions, see ``disagreement``.
        missing: By how much what is seen is shorter than the rope.
        noise: Standard deviation of the measured length.
        resolution: Of the observation.
        lapse: How much farther from its prediction the rope may be than after one interval, squared.
        gap: The last point before a gap and the first after it; the same without one.
    """
    last, steps = stations[-1], _SHARES
    length, bridge = missing + last, stations[gap[1]] - stations[gap[0]]
    # What is missing is hidden where something hides it.
    least = steps if bridge == 0 and HIDDEN in ends and missing > _NOISY * noise else 0
    bent, apart = np.full((steps + 1, steps + 1), np.inf), np.full((steps + 1, steps + 1), np.inf)
    nearest_bent, nearest_apart, found = np.inf, np.inf, np.empty((0, 0))
    for hidden in range(least, steps + 1):
        if bridge > 0 or hidden == least:
            moved = widened(stations, gap, missing * (steps - hidden) / steps) if bridge > 0 else stations
            found = interpolate(points, moved, PROBES * moved[-1])
        for a in range(hidden + 1):
            b, scale = hidden - a, missing / length / steps
            bent[a, b], apart[a, b] = disagreement(rope, share, found, a * scale, b * scale)
            nearest_bent, nearest_apart = min(nearest_bent, bent[a, b]), min(nearest_apart, apart[a, b])
    # The cheapest as what hides an end explains it, and as the prediction alone does: costs and shares at both ends.
    best, first, second, floor = np.inf, 0, 0, (NOISE * resolution) ** 2
    likeliest, other_first, other_second = np.inf, 0, 0
    for a in range(steps + 1):
        for b in range(steps + 1 - a):
            if bent[a, b] == np.inf:
                continue
            cost, dearer = (missing * (steps - a - b) / steps / (noise + _BRIDGE * bridge)) ** 2, 0.0
            for end in range(2):
                # What is hidden changes little from frame to frame; a free end is hidden in no frame for longer.
                share_now, known = (b if end else a) * missing / length / steps, ends[end]
                was = 0.0 if known == FREE else before[end]
                change = TRUST * math.log1p(((share_now - was) / _INERTIA[known]) ** 2 / TRUST)
                if share_now > 0:
                    price = _COST[known] if was <= 0 else 0.0
                    price += 0.0 if HIDDEN in ends else 2 * (max(cut) - cut[end])
                    cost += price
                    if known == FREE and HIDDEN in ends:  # a hairpin closes in the image from one frame to the next
                        dearer += _FOLDED - price
                        change = 0.0
                cost += change
            off = bent[a, b] - nearest_bent, apart[a, b] - nearest_apart
            for k in range(2):
                cost += TRUST * math.log1p(INDEPENDENT[k] * off[k] / max(lapse * residuals[k], floor) / TRUST)
            if cost + dearer < best:
                best, first, second = cost + dearer, a, b
            if cost < likeliest:
                likeliest, other_first, other_second = cost, a, b
    head, tail = first * missing / steps, second * missing / steps
    rival = max(abs(first - other_first), abs(second - other_second)) * missing / steps / length
    return Placed(head, tail, missing - head - tail, bent[first, second], apart[first, second], rival)


@compiled("(UniTuple(f8, 2), f8, f8)")
def settled(residuals: tuple[float, float], bent: float, apart: float) -> tuple[float, float]:
    """Return how far curves usually lie from their predictions: mean square distances, after another frame."""
    now_bent, now_apart = min(bent, _OUTLIER * residuals[0]), min(apart, _OUTLIER * residuals[1])
    return (
        residuals[0] + _SETTLING * (now_bent - residuals[0]),
        residuals[1] + _SETTLING * (now_apart - residuals[1]),
    )


@compiled("(f8, f8, f8)")
def beyond_rest(apart: float, motion: float, resolution: float) -> float:
    """Return how far a curve lies from its prediction, RMS, beyond what a rope at rest may.

    Args:
        apart: Mean square distance.
        motion: How far it is expected to have moved, RMS: a rope that moves is not at rest.
        resolution: Of the observation.
    """
    return math.sqrt(max(apart - max((_AT_REST * resolution) ** 2 - motion**2, 0.0), 0.0))


@compiled("(f8, f8[:,::1], UniTuple(i8, 2), UniTuple(f8, 2), f8, f8, b1)")
def slid(
    adrift: float,
    rope: Array,
    ends: Ends,
    hidden: tuple[float, float],
    bridged: float,
    strayed: float,
    long_ago: bool,
) -> float:
    """Return by which share of its length a rope may have slid along itself while no end of it was seen.

    It looks then as if it lay where it was put last; the unforeseen motion adds up. After a while out of sight it
    may be any piece. Only an end that is free, or all of the rope, shows where it is.

    Args:
        adrift: The share before this frame.
        rope: ``(K, D)`` where it is predicted, from tip to tip.
        ends: What is known about its ends.
        hidden: Share of its length that is hidden there, beyond what noise explains.
        bridged: By how much of its length it may have slid into a gap that something leaves in it.
        strayed: How far it lies from its prediction, RMS, see ``beyond_rest``.
        long_ago: Whether it was out of sight for so long that it may have slid anywhere.
    """
    loose = 0
    for end in range(2):
        loose += ends[end] == HIDDEN or (ends[end] == UNKNOWN and hidden[end] > 0)
    sliding = loose == 2 or (loose == 1 and bridged > 0)
    if FREE in ends and not sliding:
        return 0.0
    now = 1.0 if long_ago else (strayed / arc_length(rope)[-1] if sliding else 0.0)
    return min(adrift + now, max(hidden) + (bridged if HIDDEN in ends else 0.0))


@compiled
def disagreement(points: Array, share: Array, found: Array, head: float, tail: float) -> tuple[float, float]:
    """Return the mean square distances between a curve and the piece of a rope that is not hidden.

    They are taken after the best rigid motion (Kabsch 1976), and as they are: the prediction of a fast rope fails
    first in where it is, and last in how it is bent; of a slow one both hold.

    Args:
        points: ``(K, D)`` of the rope.
        share: ``(K,)`` where they lie along it, 0...1.
        found: ``(32, D)`` points along the curve.
        head: Share of the rope that is hidden at its start.
        tail: The same at its end.
    """
    probes, size = found.shape
    expected = interpolate(points, share, head + PROBES * (1 - tail - head))
    covariance, middle, centre = covariance_of(expected, found)
    square = away = 0.0
    for n in range(probes):
        for d in range(size):
            square += (expected[n, d] - middle[d]) ** 2 + (found[n, d] - centre[d]) ** 2
            away += (expected[n, d] - found[n, d]) ** 2
    if size == 2:
        turned = math.hypot(covariance[0, 0] + covariance[1, 1], covariance[0, 1] - covariance[1, 0])
    else:
        turned = largest_trace(covariance)
    return max(square - 2 * turned, 0.0) / probes, away / probes


@compiled("(f8[::1], UniTuple(i8, 2), f8)")
def widened(stations: Array, gap: tuple[int, int], more: float) -> Array:
    """Return stations with a gap that is longer."""
    out = stations.copy()
    for p in range(gap[0] + 1, len(out)):
        out[p] += more * min((p - gap[0]) / (gap[1] - gap[0]), 1.0)
    return out


@compiled("(f8[:,::1],)")
def from_tip_to_tip(nodes: Array) -> tuple[Array, Array]:
    """Return nodes at the centres of equal pieces with the tips, ``(K + 2, D)``, and where they lie, 0...1."""
    count, size = nodes.shape
    points, share = np.empty((count + 2, size)), np.empty(count + 2)
    for d in range(size):
        points[0, d] = 1.5 * nodes[0, d] - 0.5 * nodes[1, d]
        points[count + 1, d] = 1.5 * nodes[count - 1, d] - 0.5 * nodes[count - 2, d]
        for k in range(count):
            points[k + 1, d] = nodes[k, d]
    for k in range(count):
        share[k + 1] = (k + 0.5) / count
    share[0], share[count + 1] = 0.0, 1.0
    return points, share
