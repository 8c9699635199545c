"""Which piece of a known rope a visible curve is.

For each way to share out what is missing of a rope (at its start, at its end, in a gap, or because the measurement is
short), the cost is how badly the visible points agree with where their material was expected, how far the measurement
would have to be off, and what is seen at the tips. Costs are in nats: differences of the log likelihood.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.geometry.rotation import largest_trace
from shape_obs.tracking.model import (
    ChainConstants,  # noqa: F401 - in a signature
    gain_of,
)
from shape_obs.tracking.occluders import FREE, HIDDEN

Array = npt.NDArray[np.float64]
Ends = tuple[int, int]

PROBES: Final = np.linspace(0, 1, 32)  # of a visible piece, at which it is compared with the prediction
_SHARES: Final = 8  # of what is missing, that may be hidden at an end
_FINER: Final = 3  # times, that the best share is looked for with steps of half the size
_TICK: Final = 1e-3  # seconds: stamps that are closer show no speed
# In which what is hidden at the start and at the end is varied; the first two keep their sum.
_WAYS: Final = np.array([[1.0, -1.0], [-1.0, 1.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])  # of a step
_NEARER: Final = 0.9  # a surprise of -1 has no logarithm


class Placed(NamedTuple):
    """Which piece of a known rope a visible curve is.

    Args:
        head: Length of what is hidden at its start, in the unit of the curve's stations.
        tail: The same at its end.
        between: By how much a gap in it is longer than it is bridged.
        bent: Mean square distance from the prediction after the best rigid motion.
        apart: The same as it is.
        elsewhere: By which share of the length more would be hidden elsewhere if the prediction and what the tips look
            like alone decided whether a free end is folded back.
    """

    head: float
    tail: float
    between: float
    bent: float
    apart: float
    elsewhere: float


@compiled(
    "(f8[:,::1], f8[::1], f8[:,::1], f8[::1], UniTuple(i8, 2), UniTuple(f8, 2), UniTuple(f8, 2), UniTuple(f8, 2), f8, "
    "f8, f8, UniTuple(i8, 2), ChainConstants)"
)
def place(
    rope: Array,
    share: Array,
    points: Array,
    stations: Array,
    ends: Ends,
    cut: tuple[float, float],
    before: tuple[float, float],
    usual: tuple[float, float],
    missing: float,
    noise: float,
    seconds: float,
    gap: tuple[int, int],
    model: Any,
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
        usual: Mean square distances of curves from their predictions, see ``disagreement``.
        missing: By how much what is seen is shorter than the rope.
        noise: Standard deviation of the measured length.
        seconds: Since the rope was seen.
        gap: The last point before a gap and the first after it; the same without one.
        model: The constants, one ``ChainModel``.
    """
    steps, piece, bridge = _SHARES, missing / _SHARES, stations[gap[1]] - stations[gap[0]]
    length, loose = missing + stations[-1], noise + model.bridge * bridge
    # How much more of an unknown, a hidden and a free end is hidden than before, or seems so by noise.
    change = np.empty(3)
    for known in range(3):
        change[known] = math.hypot(model.hiding_rate[known] * seconds, noise / length)
    # What is missing is hidden where something hides it.
    least = steps if bridge == 0 and HIDDEN in ends and missing > model.too_short * noise else 0
    bent, apart = np.full((steps + 1, steps + 1), np.inf), np.full((steps + 1, steps + 1), np.inf)
    found = _probes(points, stations, gap, 0.0)
    for hidden in range(least, steps + 1):
        if bridge > 0:
            found = _probes(points, stations, gap, missing - hidden * piece)
        for a in range(hidden + 1):
            first, second = a * piece / length, (hidden - a) * piece / length
            bent[a, hidden - a], apart[a, hidden - a] = disagreement(rope, share, found, first, second)
    nearest = bent.min(), apart.min()
    # The cheapest as what hides an end explains it, and as the prediction and the tips alone do.
    best, likeliest, a, b, other_a, other_b = np.inf, np.inf, 0, 0, 0, 0
    for first in range(steps + 1):
        for second in range(steps + 1 - first):
            if bent[first, second] == np.inf:
                continue
            cost, impossible = _cost(
                first * piece, second * piece, missing, length, loose, ends, cut, before, change, model
            )
            cost += _surprise(bent[first, second] - nearest[0], apart[first, second] - nearest[1], usual, model)
            if cost + impossible < best:
                best, a, b = cost, first, second
            if cost < likeliest:
                likeliest, other_a, other_b = cost, first, second
    head, tail, off = a * piece, b * piece, (bent[a, b], apart[a, b])
    both = ends[0] == ends[1] if HIDDEN in ends else min(cut) > 0
    if both and missing > model.too_short * noise:
        # Where both ends are out of sight, what each of them loses from one frame to the next is less than a share.
        for n in range(_FINER):
            step, centre = piece / 2 ** (n + 1), (head, tail)
            for way in range(2 if least else 6):
                first, second = centre[0] + step * _WAYS[way, 0], centre[1] + step * _WAYS[way, 1]
                if min(first, second) < 0 or first + second > missing * (1 + 1e-9):
                    continue
                if bridge > 0:
                    found = _probes(points, stations, gap, missing - first - second)
                now = disagreement(rope, share, found, first / length, second / length)
                cost, impossible = _cost(first, second, missing, length, loose, ends, cut, before, change, model)
                cost += impossible + _surprise(now[0] - nearest[0], now[1] - nearest[1], usual, model)
                if cost < best:
                    best, head, tail, off = cost, first, second, now
    elsewhere = max(abs(a - other_a), abs(b - other_b)) * piece / length
    return Placed(head, tail, missing - head - tail, off[0], off[1], elsewhere)


@compiled
def _probes(points: Array, stations: Array, gap: tuple[int, int], between: float) -> Array:
    """Return ``(32, D)`` points at equal steps along what is seen of a rope, in which a gap is longer."""
    moved = widened(stations, gap, between) if gap[1] > gap[0] else stations
    return interpolate(points, moved, PROBES * moved[-1])


@compiled
def _surprise(bent: float, apart: float, usual: tuple[float, float], model: Any) -> float:
    """Return what it costs that a piece lies farther from its prediction than another one, nats, see ``limited``."""
    form = max(model.independent[0] / model.trust * bent / usual[0], -_NEARER)
    place = max(model.independent[1] / model.trust * apart / usual[1], -_NEARER)
    return model.trust / 2 * math.log((1 + form) * (1 + place))


@compiled
def _cost(
    head: float,
    tail: float,
    missing: float,
    length: float,
    loose: float,
    ends: Ends,
    cut: tuple[float, float],
    before: tuple[float, float],
    likely: Array,
    model: Any,
) -> tuple[float, float]:
    """Return the nats of taking lengths at both ends for hidden, and infinity if one that is free would be, else 0.

    What is hidden changes little from frame to frame; a free end is not hidden while something hides the other.
    """
    cost, impossible = ((missing - head - tail) / loose) ** 2 / 2, 0.0
    if head > 0 and tail > 0 and HIDDEN not in ends:  # one end explains what is missing, though none looks cut
        cost += max(-max(cut), 0.0)
    for end in range(2):
        share, known = (tail if end else head) / length, ends[end]
        was = 0.0 if known == FREE else before[end]
        change = limited(((share - was) / likely[known]) ** 2, model.trust)
        if share > 0:
            price = model.cost_of_hiding[known] if was <= 0 else 0.0
            price += 0.0 if HIDDEN in ends else max(cut) - cut[end]
            cost += price
            if known == FREE and HIDDEN in ends:  # a hairpin closes in the image from one frame to the next
                likelier = max(cut[end] - cut[1 - end], 0.0)
                cost, impossible = cost - likelier, np.inf
                change = 0.0
        elif HIDDEN not in ends:
            cost += max(cut[end], 0.0)
        cost += change
    return cost, impossible


@compiled
def settled(speed: float, off: float, noise: float, seconds: float, lasted: float, model: Any) -> float:
    """Return the mean square of how fast curves leave their predictions, after another frame, (U/s)^2.

    Args:
        speed: The same before.
        off: Mean square distance of the curve from its prediction.
        noise: The same of a perfect prediction.
        seconds: Since the rope was seen.
        lasted: For how many of them this frame counts.
        model: The constants, one ``ChainModel``.
    """
    most = model.outlier * (noise + speed * seconds**2)
    beyond = max(min(off, most) - noise, 0.0) / max(seconds, _TICK) ** 2
    return speed + gain_of(lasted, model.speed_memory) * (beyond - speed)


@compiled
def limited(square: float, trust: float) -> float:
    """Return the nats of some squared standard deviations, half as many, which grow slowly beyond ``trust``."""
    return trust / 2 * math.log1p(square / trust)


@compiled
def beyond_rest(apart: float, motion: float, least: float) -> float:
    """Return how far a curve lies from its prediction, RMS, beyond what a rope at rest may.

    Args:
        apart: Mean square distance.
        motion: How far it is expected to have moved, RMS: a rope that moves is not at rest.
        least: How far off a rope at rest may be, in the unit of the points.
    """
    return math.sqrt(max(apart - max(least**2 - motion**2, 0.0), 0.0))


@compiled
def slid(
    adrift: float,
    rope: Array,
    ends: Ends,
    hidden: tuple[float, float],
    bridged: float,
    strayed: float,
    lost: bool,
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
        lost: Whether it was out of sight for so long that it may have slid anywhere.
    """
    loose, anchored = 0, False
    for end in range(2):
        loose += ends[end] == HIDDEN or hidden[end] > 0
        anchored |= ends[end] == FREE and hidden[end] <= 0
    sliding = loose == 2 or (loose == 1 and bridged > 0)
    if anchored and not sliding:
        return 0.0
    now = 1.0 if lost else (strayed / arc_length(rope)[-1] if sliding else 0.0)
    return min(adrift + now, max(hidden) + (bridged if HIDDEN in ends else 0.0))


@compiled(reassociate=True)
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
    (probes, size), last, p, long = found.shape, len(share) - 1, 0, 1 - tail - head
    deep, k, away, covariance = size - 2, size - 1, 0.0, np.empty((3, 3))  # in the plane all lies at depth 0
    x0 = y0 = z0 = u0 = v0 = w0 = xu = xv = xw = yu = yv = yw = zu = zv = zw = 0.0
    for n in range(probes):  # in one pass, without arrays: this runs dozens of times in a frame
        here = min(max(head + PROBES[n] * long, share[0]), share[last])
        while p < last - 1 and share[p + 1] < here:
            p += 1
        gap = share[p + 1] - share[p]
        part = (here - share[p]) / gap if gap > 0 else 0.0
        # From the first point found: sums of squares of large numbers would lose digits.
        x = points[p, 0] + part * (points[p + 1, 0] - points[p, 0]) - found[0, 0]
        y = points[p, 1] + part * (points[p + 1, 1] - points[p, 1]) - found[0, 1]
        z = deep * (points[p, k] + part * (points[p + 1, k] - points[p, k]) - found[0, k])
        u, v, w = found[n, 0] - found[0, 0], found[n, 1] - found[0, 1], deep * (found[n, k] - found[0, k])
        x0, y0, z0, u0, v0, w0 = x0 + x, y0 + y, z0 + z, u0 + u, v0 + v, w0 + w
        xu, xv, xw = xu + x * u, xv + x * v, xw + x * w
        yu, yv, yw = yu + y * u, yv + y * v, yw + y * w
        zu, zv, zw = zu + z * u, zv + z * v, zw + z * w
        away += (x - u) ** 2 + (y - v) ** 2 + (z - w) ** 2
    x0, y0, z0 = x0 / probes, y0 / probes, z0 / probes
    moved = (x0 - u0 / probes) ** 2 + (y0 - v0 / probes) ** 2 + (z0 - w0 / probes) ** 2
    covariance[0, 0], covariance[0, 1], covariance[0, 2] = xu - x0 * u0, xv - x0 * v0, xw - x0 * w0
    covariance[1, 0], covariance[1, 1], covariance[1, 2] = yu - y0 * u0, yv - y0 * v0, yw - y0 * w0
    covariance[2, 0], covariance[2, 1], covariance[2, 2] = zu - z0 * u0, zv - z0 * v0, zw - z0 * w0
    stayed = covariance[0, 0] + covariance[1, 1] + covariance[2, 2]
    turned = largest_trace(covariance) if deep else math.hypot(stayed, covariance[0, 1] - covariance[1, 0])
    return max((away - 2 * (turned - stayed)) / probes - moved, 0.0), away / probes


@compiled
def widened(stations: Array, gap: tuple[int, int], more: float) -> Array:
    """Return stations with a gap that is longer."""
    out = stations.copy()
    for p in range(gap[0] + 1, len(out)):
        out[p] += more * min((p - gap[0]) / (gap[1] - gap[0]), 1.0)
    return out
