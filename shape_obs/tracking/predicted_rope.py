"""Where a known rope is expected, and which piece of it a visible curve is.

For each way to share out what is missing of a rope (at its start, at its end, in a gap, or because the measurement is
short), the cost is how badly the visible points agree with where their material was expected, how far the measurement
would have to be off, and what is seen at the tips.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property, lru_cache
from itertools import product
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import FittedCurve, Length
from shape_obs.geometry.polyline import interpolate
from shape_obs.geometry.rotation import covariance_of, largest_trace
from shape_obs.tracking.occluders import FREE, HIDDEN, UNKNOWN
from shape_obs.tracking.prediction import Prediction

Array = npt.NDArray[np.float64]
Ends = tuple[int, int]

_PROBES: Final = np.linspace(0, 1, 32)  # of a visible piece, at which it is compared with the prediction
_SHARES: Final = np.linspace(0, 1, 9)  # of what is missing, that may be hidden at an end
_INDEPENDENT: Final = (4.0, 1.0)  # of the probes: neighbours err alike, and a rope that is elsewhere is so as a whole
_NOISE: Final = 0.15  # in resolutions: how far off a curve lies that was predicted perfectly
_SETTLING: Final = 0.1  # how fast the distance of curves from their predictions is learnt
# What it costs, in squared standard deviations, to take an end for hidden: without evidence, with
# evidence, and a free one, which is then folded back or points at the camera. And by which share of the length it
# changes from frame to frame.
_COST: Final = {UNKNOWN: 4.0, HIDDEN: 4.0, FREE: 16.0}
_FOLDED: Final = 100.0  # of a free end while something hides the other, which explains what is missing
_INERTIA: Final = {UNKNOWN: 0.05, HIDDEN: 0.1, FREE: 0.05}
_BRIDGE: Final = 0.35  # of a bridged gap: the standard deviation of its length
_SLIDES: Final = 0.1  # of a bridged gap: by so much what lies behind it may have slid into it
_UNSEEN: Final = 30.0  # squared standard deviations: a piece that lies where all was folded back is so unlikely
_CLEAR: Final = 3.0  # how much nearer ends lie to their own places than to each other's
_ASKEW: Final = 0.6  # widths: of the visible piece next to a hidden end, which may follow the cut
_SURE: Final = 8.0  # squared standard deviations by which the other direction has to be less likely
_PLACES: Final = 7  # along the rope, at which a piece is compared with it to find its direction
_TRUST: Final = 5.0  # squared standard deviations, beyond which costs grow slowly: predictions may be far off
_OUTLIER: Final = 10.0  # residuals: more is not learnt from at once
_NOISY: Final = 3.0  # standard deviations by which a length may be short, though an end is hidden
_BY_NOISE: Final = 1.0  # standard deviations of a length, which may seem hidden
_LONG_AGO: Final = 25.0  # squared intervals of a track, after which a rope may have slid anywhere
_FEWEST: Final = 6  # nodes of a visible piece


def oriented(form: FittedCurve, rope: PredictedRope, length: Length) -> tuple[FittedCurve, bool]:
    """Return a curve in the direction of the predicted rope, of which it may be a piece, and whether it was reversed.

    A direction that is in doubt is noted as the curve's ambiguity.
    """
    if _is_along(rope.points_of(form), rope.nodes):
        return form, False
    whole = length.metres if form.metres is not None else length.pixels
    seen = min(float(form.stations[-1]) / whole, 1.0) if whole > 0 else 1.0
    firsts, back = np.linspace(0, 1 - seen, _PLACES), form.reversed()
    off, off_back = (min(rope.doubt(rope.along(curve), first, seen) for first in firsts) for curve in (form, back))
    if abs(off - off_back) < _SURE:
        form, back = (replace(curve, ambiguity="it is in doubt where the rope begins") for curve in (form, back))
    return (back, True) if off_back < off else (form, False)


def visible_nodes(prediction: Prediction) -> Array:
    """Return the predicted nodes of the visible piece, about as far apart, with their relief: ``(K', 2 or 3)``."""
    (head, tail), rope = prediction.hints.hidden, PredictedRope(prediction)
    nodes = rope.nodes
    if head + tail <= 0:
        return nodes
    first, last = head, 1 - tail
    count = max(round(len(nodes) * (last - first)), _FEWEST)
    return rope.at(first + (np.arange(count) + 0.5) / count * (last - first))


def _is_along(points: Array, nodes: Array) -> bool:
    """Return whether a curve clearly runs in the direction of ``(K, D)`` nodes, by the distances of its ends."""
    first, last = points[0].tolist(), points[-1].tolist()
    head, tail = nodes[0].tolist(), nodes[-1].tolist()
    forwards, backwards = math.dist(first, head) + math.dist(last, tail), math.dist(first, tail) + math.dist(last, head)
    return _CLEAR * forwards < backwards


class PredictedRope:
    """The predicted rope from tip to tip.

    Args:
        prediction: Its nodes lie at the centres of K equal pieces of the rope.
        form: What it is compared with: in the image, if its relief is not known.
    """

    def __init__(self, prediction: Prediction, form: FittedCurve | None = None) -> None:
        nodes, self.hidden, self.folded = prediction.nodes, prediction.hints.hidden, prediction.hints.folded
        if prediction.relief is not None and (form is None or form.relief is not None):
            nodes = np.concatenate([nodes, prediction.relief[:, None]], axis=1)
        self.nodes = nodes
        # An object that moves as it likes is as far from its prediction as the square of the time that went by.
        self.residuals, self.lapse = prediction.hints.residuals, prediction.lapse**2
        self.adrift, self.stale = prediction.hints.adrift, prediction.stale
        self.rival = 0.0
        self.askew, self.resolution = _ASKEW * prediction.width, prediction.resolution

    @cached_property
    def share(self) -> Array:
        """``(K + 2,)`` where the points lie along the rope, 0...1."""
        return _shares(len(self.nodes))

    @cached_property
    def points(self) -> Array:
        """``(K + 2, D)`` the nodes, and the tips in front of and behind them."""
        nodes = self.nodes
        return np.concatenate([1.5 * nodes[:1] - 0.5 * nodes[1:2], nodes, 1.5 * nodes[-1:] - 0.5 * nodes[-2:-1]])

    def at(self, share: Array) -> Array:
        """Return ``(N, D)`` points at shares of the length."""
        return interpolate(self.points, self.share, share)

    def points_of(self, form: FittedCurve) -> Array:
        """Return ``(P, D)`` the points of a curve, in the coordinates of the rope."""
        return form.lifted if self.nodes.shape[1] > form.points.shape[1] else form.points

    def along(self, form: FittedCurve) -> Array:
        """Return ``(32, D)`` points at equal steps along a curve."""
        return interpolate(self.points_of(form), form.stations, _PROBES * form.stations[-1])

    def doubt(self, found: Array, first: float, share: float) -> float:
        """Return how unlikely ``(32, D)`` points along a curve are a piece of the rope, in squared standard deviations.

        Args:
            found: The points.
            first: Where the piece begins, as a share of the rope's length.
            share: How long it is. What was folded back cannot be compared with it.
        """
        at = first + share * _PROBES
        head, tail = (hidden * folded for hidden, folded in zip(self.hidden, self.folded, strict=True))
        seen = (at >= head) & (at <= 1 - tail)
        doubt = _UNSEEN * (1 - float(seen.mean()))
        if not seen.any():
            return doubt
        away = (self.at(at) - found)[seen]
        shift, least = away.mean(axis=0), (_NOISE * self.resolution) ** 2
        off = float(np.mean(np.sum((away - shift) ** 2, axis=1))), float(np.sum(shift**2))
        for now, usual, count in zip(off, self.residuals, _INDEPENDENT, strict=True):
            doubt += _TRUST * math.log1p(count * now / max(self.lapse * usual, least) / _TRUST)
        return doubt

    def settle(self, *distances: float) -> None:
        """Learn how far curves lie from their predictions: mean square distances, see ``disagreements``."""
        bent, apart = (
            known + _SETTLING * (min(now, _OUTLIER * known) - known)
            for known, now in zip(self.residuals, distances, strict=True)
        )
        self.residuals = bent, apart

    def place(
        self,
        form: FittedCurve,
        ends: Ends,
        cut: tuple[float, float],
        missing: float,
        noise: float,
        gap: tuple[int, int],
    ) -> tuple[float, float, float]:
        """Return how much of a rope is hidden at its start, at its end and in a gap: what costs least.

        If something hides one end, what is missing is taken to be there. ``rival`` is set to the share of the length by
        which more would be hidden elsewhere if the prediction alone decided whether the free end is folded back.

        Args:
            form: What is seen of it.
            ends: What is known about its tips.
            cut: How much likelier, as logarithms, they are cut than the rope's own.
            missing: By how much the form is shorter than the rope.
            noise: Standard deviation of the measured length.
            gap: The last point before a gap and the first after it.
        """
        length, stations = missing + float(form.stations[-1]), form.stations
        bridge = float(stations[gap[1]] - stations[gap[0]])
        shares = np.array([(a, b) for a, b in product(_SHARES, _SHARES) if a + b <= 1])
        if (
            bridge == 0 and HIDDEN in ends and missing > _NOISY * noise
        ):  # what is missing is hidden where something hides it
            shares = shares[shares.sum(axis=1) == 1]
        rest, hidden = (1 - shares.sum(axis=1)) * missing, shares * missing / length
        points = self.points_of(form)
        found = np.empty((len(shares), len(_PROBES), points.shape[1]))
        for more in np.unique(rest) if bridge else rest[:1]:
            moved = widened(stations, gap, more) if bridge else stations
            found[rest == more if bridge else slice(None)] = interpolate(points, moved, _PROBES * moved[-1])
        bent, apart = disagreements(self.points, self.share, found, hidden)
        cost, dearer = (rest / (noise + _BRIDGE * bridge)) ** 2, np.zeros(len(shares))
        for end in range(2):
            # What is hidden changes little from frame to frame; a free end is hidden in no frame for longer.
            known, last = ends[end], 0.0 if ends[end] == FREE else self.hidden[end]
            price = _COST[known] * (last <= 0) + 2 * (max(cut) - cut[end]) * (HIDDEN not in ends)
            change = _TRUST * np.log1p(((hidden[:, end] - last) / _INERTIA[known]) ** 2 / _TRUST)
            cost += price * (hidden[:, end] > 0) + change
            if known == FREE and HIDDEN in ends:  # a hairpin closes in the image from one frame to the next
                dearer += (_FOLDED - price) * (hidden[:, end] > 0)
                cost -= change * (hidden[:, end] > 0)
        least = (_NOISE * self.resolution) ** 2
        for off, known, count in zip((bent, apart), self.residuals, _INDEPENDENT, strict=True):
            cost += _TRUST * np.log1p(count * (off - off.min()) / max(self.lapse * known, least) / _TRUST)
        folded, best = int(np.argmin(cost)), int(np.argmin(cost + dearer))
        vague = bridge > 0 or self.adrift > 0 or self.lapse > _LONG_AGO
        self.rival = 0.0 if vague else float(np.abs(hidden[folded] - hidden[best]).max())
        beyond = np.maximum(hidden[best] - _BY_NOISE * noise / length, 0.0)
        self.slide(ends, beyond, _SLIDES * bridge / length, float(apart[best]))
        self.settle(float(bent[best]), float(apart[best]))
        head, tail = hidden[best] * length
        return float(head), float(tail), float(rest[best])

    def slide(self, ends: Ends, hidden: Array, bridged: float, apart: float) -> None:
        """Learn by how much a visible piece of the rope may have slid along it while no end of it was seen.

        It looks then as if it lay where it was put last; the unforeseen motion adds up. After a while out of sight it
        may be any piece. Only an end that is free, or all of the rope, shows where it is.

        Args:
            ends: What is known about the rope's ends.
            hidden: ``(2,)`` share of its length that is hidden there, beyond what noise explains.
            bridged: By how much of its length it may have slid into a gap that something leaves in it.
            apart: Mean square distance from the prediction.
        """
        loose = [end == HIDDEN or (end == UNKNOWN and share > 0) for end, share in zip(ends, hidden, strict=True)]
        sliding = all(loose) or (any(loose) and bridged > 0)
        if FREE in ends and not sliding:
            self.adrift = 0.0
            return
        size = float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())
        slid = 1.0 if self.stale or self.lapse > _LONG_AGO else apart**0.5 / size * sliding
        self.adrift = min(self.adrift + slid, float(hidden.max()) + bridged * (HIDDEN in ends))


@compiled("(f8[:,::1], f8[::1], f8[:,:,::1], f8[:,::1])")
def disagreements(points: Array, share: Array, found: Array, hidden: Array) -> tuple[Array, Array]:
    """Return the mean square distances between curves and those pieces of a rope that are not hidden.

    They are taken after the best rigid motion (Kabsch 1976), and as they are: the prediction of a fast rope fails
    first in where it is, and last in how it is bent; of a slow one both hold.

    Args:
        points: ``(K, D)`` of the rope.
        share: ``(K,)`` where they lie along it, 0...1.
        found: ``(C, 32, D)`` points along each curve.
        hidden: ``(C, 2)`` shares of the rope that are hidden at its ends.
    """
    count, probes, size = found.shape
    bent, apart = np.empty(count), np.empty(count)
    for c in range(count):
        expected = interpolate(points, share, hidden[c, 0] + _PROBES * (1 - hidden[c, 1] - hidden[c, 0]))
        covariance, middle, centre = covariance_of(expected, found[c])
        square = away = 0.0
        for n in range(probes):
            for d in range(size):
                square += (expected[n, d] - middle[d]) ** 2 + (found[c, n, d] - centre[d]) ** 2
                away += (expected[n, d] - found[c, n, d]) ** 2
        if size == 2:
            turned = math.hypot(covariance[0, 0] + covariance[1, 1], covariance[0, 1] - covariance[1, 0])
        else:
            turned = largest_trace(covariance)
        bent[c], apart[c] = max(square - 2 * turned, 0.0) / probes, away / probes
    return bent, apart


@lru_cache(maxsize=64)
def _shares(count: int) -> Array:
    return np.concatenate([[0.0], (np.arange(count) + 0.5) / count, [1.0]])


def widened(stations: Array, gap: tuple[int, int], more: float) -> Array:
    """Return stations with a gap that is longer."""
    first, last = gap
    out = stations.copy()
    out[first : last + 1] += more * np.linspace(0, 1, last - first + 1)
    out[last + 1 :] += more
    return out
