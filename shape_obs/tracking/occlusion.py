"""Occlusion: find out which piece of a known rope a visible curve is.

A rope has a length, and what is seen of it may be shorter for three reasons: an end is hidden, a gap is bridged too
straight, or the measurement is short, because of noise or, in pixels, of perspective. One decision weighs all of them:
for each way to share out what is missing, how well the visible points agree with where their material was expected, how
far the measurement would have to be off, and what is seen at the tips. Visible points keep their distance from the
rope's ends, and hidden ends are carried along.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from math import dist
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.curve import FittedCurve, Length, TrackHints
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.tracking.occluders import FREE, HIDDEN, UNKNOWN, Tips
from shape_obs.tracking.prediction import Prediction

Array = npt.NDArray[np.float64]
Ends = tuple[int, int]

_PROBES: Final = np.linspace(0, 1, 32)  # of a visible piece, at which it is compared with the prediction
_SHARES: Final = np.linspace(0, 1, 9)  # of what is missing, that may be hidden at an end
_PLACE: Final = 0.1  # the weight of where a rope is predicted against how it is bent
_INDEPENDENT: Final = 4.0  # of the probes: neighbours err alike
_NOISE: Final = 0.15  # in resolutions: how far off a curve lies that was predicted perfectly
_SETTLING: Final = 0.1  # how fast the distance of curves from their predictions is learnt
# What it costs, in squared standard deviations, to take an end for hidden: without evidence, with
# evidence, and a free one, which is then folded back or points at the camera. And by which share of the length it
# changes from frame to frame.
_COST: Final = {UNKNOWN: 4.0, HIDDEN: 0.0, FREE: 4.0}
_FOLDED: Final = 25.0  # of a free end while something hides the other, which explains what is missing
_INERTIA: Final = {UNKNOWN: 0.05, HIDDEN: 0.1, FREE: 0.05}
# Of the length: the standard deviation of a measurement. In pixels it is learnt, and this is the least.
_SPREAD: Final = {"px": 0.001, "m": 0.012}
_GRAIN: Final = 0.3  # in resolutions: the same of a short one
_WIDEST: Final = 0.2
_BRIDGE: Final = 0.35  # of a bridged gap: the standard deviation of its length
_SLACK: Final = (0.01, 1.5)  # of the length and in resolutions: what is missing below this is noise
_BEYOND: Final = 4.0  # standard deviations, beyond which noise explains nothing
# By which share of a difference a length follows a measurement, and of itself if noise cannot explain the difference.
_LEARNING: Final = (0.05, 0.001)
_FORGETTING: Final = 0.05
_STRETCH: Final = 1.3  # a predicted piece is not laid into a gap that is this much wider or narrower
_CLEAR: Final = 3.0  # how much nearer ends lie to their own places than to each other's
_ASKEW: Final = 0.6  # widths: of the visible piece next to a hidden end, which may follow the cut
_SURE: Final = 2.0  # how much larger the mean square distance has to be in the other direction
_PLACES: Final = 7  # along the rope, at which a piece is compared with it to find its direction
_EVENLY: Final = 0.1  # the weight of a piece of a curve at a right angle to the view, in a length that is off
_LEAST: Final = 0.002  # of a length in pixels: less cannot be seen to be missing
_FADING: Final = 0.8  # how much of the last frame's evidence for cut tips is kept
_CERTAIN: Final = 8.0  # the most that such evidence can weigh
_TRUST: Final = 5.0  # squared standard deviations, beyond which costs grow slowly: predictions may be far off
_CHANGED: Final = 30  # frames in a row in which a rope with free tips is shorter than it was: it has changed
_DOUBTFUL: Final = 1.5  # standard deviations by which a rope is too short, and its tips may be cut
_OUTLIER: Final = 10.0  # residuals: more is not learnt from at once
_FEWEST: Final = 6  # nodes of a visible piece
_LONG: Final = 0.06  # of the length: next to a hidden end that is shorter, the visible piece stays as it is
_NEXT_TO: Final = 0.25  # of the visible piece, next to a hidden end, whose scale that end has


def match_chain(form: FittedCurve, prediction: Prediction, tips: Tips) -> FittedCurve:
    """Match a curve to the predicted rope: same direction, hidden ends put back, as long as the rope is known to be.

    Args:
        form: ``(P, D)`` fitted to this frame, in any direction.
        prediction: Where the rope should be.
        tips: What the curve's tips look like.

    Returns:
        The whole rope. Its hints hold the lengths of the hidden ends, and what is known of the rope's length.
    """
    rope, known = _PredictedRope(prediction), prediction.hints.length
    turned, back = oriented(form, prediction)
    form, tips = turned, tips.reversed() if back else tips
    ends = tips.known
    if HIDDEN in ends:  # that explains what is missing
        ends = (ends[0] or FREE, ends[1] or FREE)
    before = prediction.hints
    cut = np.clip(_FADING * np.array(before.cut) + tips.cut(before.tips), -_CERTAIN, _CERTAIN)
    unit = "m" if form.metres is not None or form.points.shape[1] == 3 else "px"
    length = known.metres if form.metres is not None else known.pixels
    if length <= 0:
        return replace(form, hints=TrackHints(length=learnt(known, form, ends), tips=tips.remembered(None, 0)))
    gap = _widest_gap(form)
    resolution = prediction.resolution * float(form.stations[-1]) / max(form.size, 1e-9)
    slack, missing = _SLACK[0] * length + _SLACK[1] * resolution, length - float(form.stations[-1])
    head = tail = 0.0
    least = _LEAST * length
    noise = (known.spread if unit == "px" else known.spread_metres) * length + _GRAIN * resolution
    if missing > 0 and (gap[1] > gap[0] or missing > least or HIDDEN in ends):
        head, tail, between = rope.place(form, ends, cut, missing, noise, gap)
        form = rope.filled(form, gap, head, between, length)
    else:
        rope.settle(float(rope.disagreement(_on(form)[None], np.zeros(1), np.ones(1))[0]))
    doubtful = missing > _DOUBTFUL * noise and cut.max() > 0
    if head + tail <= least and not doubtful:
        now, own = learnt(known, form, ends), tips.remembered(before.tips, known.frames)
    else:
        now, own = shortened(known, form, ends == (FREE, FREE) and missing > _BEYOND * noise), before.tips
    stretch = (length - head - tail) / max(float(form.stations[-1]), 1e-9)
    form = rope.completed(form, ends, head, tail, stretch, length)
    hidden = head / length, tail / length
    certain = (float(cut[0]), float(cut[1]))
    covered = ends[0] == HIDDEN, ends[1] == HIDDEN
    hints = TrackHints(hidden, covered, slack / length, stretch, rope.residual, certain, own, now)
    return replace(form, hints=hints)


def learnt(known: Length, form: FittedCurve, ends: Ends) -> Length:
    """Return what is known of a rope's length after a frame in which nothing of it is hidden.

    A length follows what is measured as far as noise explains the difference, and hardly beyond that: never because
    less is seen.

    Args:
        known: What was known before.
        form: What was seen.
        ends: What is known about its tips.
    """
    metres = 0.0 if form.metres is None else float(form.metres[-1])
    whole = HIDDEN not in ends and form.whole
    if known.frames == 0:
        return known._replace(pixels=max(form.size, known.pixels), metres=max(metres, known.metres), frames=int(whole))
    if not whole:
        return known
    change = form.size / known.pixels - 1
    spread = _varied(known.spread, change, _SPREAD["px"])
    follow = min(max((spread / 0.04) ** 2, _LEARNING[0]), 1.0)
    pixels = known.pixels * (1 + follow * change)
    if not metres or not known.metres:
        return Length(pixels, metres or known.metres, spread, known.spread_metres, known.frames + 1)
    off = metres / known.metres - 1
    gain = max(_LEARNING[0], 1 / (known.frames + 1)) if abs(off) < _BEYOND * _SPREAD["m"] else 0.0
    step = gain * off if gain else float(np.clip(off, -_LEARNING[1], _LEARNING[1]))
    varied = min(_varied(known.spread_metres, off, _SPREAD["px"]), _SPREAD["m"])
    return Length(pixels, known.metres * (1 + step), spread, varied, known.frames + 1)


def shortened(known: Length, form: FittedCurve, free: bool) -> Length:
    """Return what is known of a rope's length after a frame in which less of it was seen.

    If both of its tips are free, and nothing is nearer than they are, for long enough, then the rope has changed.
    """
    if not free:
        return known._replace(short=0)
    if known.short < _CHANGED:
        return known._replace(short=known.short + 1)
    metres = 0.0 if form.metres is None else float(form.stations[-1])
    return Length(form.size, metres, known.spread, known.spread_metres, 1)


def _varied(spread: float, change: float, least: float) -> float:
    """Return the RMS share by which a length varies, after another change."""
    now = (spread**2 * (1 - _FORGETTING) + _FORGETTING * change**2) ** 0.5
    if abs(change) > _BEYOND * spread:
        now = max(now, abs(change) / 2)
    return min(max(now, least), _WIDEST)


def oriented(form: FittedCurve, prediction: Prediction) -> tuple[FittedCurve, bool]:
    """Return a curve in the direction of the predicted rope, of which it may be a piece, and whether it was reversed.

    A direction that is in doubt is noted as the curve's ambiguity.
    """
    if _is_along(form, prediction.nodes):
        return form, False
    rope, length = _PredictedRope(prediction), prediction.hints.length
    whole = length.metres if form.metres is not None else length.pixels
    seen = min(float(form.stations[-1]) / whole, 1.0) if whole > 0 else 1.0
    firsts, back = np.linspace(0, 1 - seen, _PLACES), form.reversed()
    off, off_back = (
        min(_apart(rope.at(first + seen * _PROBES), _on(curve)) for first in firsts) for curve in (form, back)
    )
    if max(off, off_back) < _SURE * min(off, off_back):
        form, back = (replace(curve, ambiguity="it is in doubt where the rope begins") for curve in (form, back))
    return (back, True) if off_back < off else (form, False)


def shown(form: FittedCurve) -> slice:
    """Return the piece of a matched curve over which points are spread: without ends hidden by less than the slack."""
    (head, tail), slack, share = form.hints.hidden, form.hints.slack, form.stations / form.stations[-1]
    first = np.searchsorted(share, head - 1e-9) if head < slack else 0
    last = np.searchsorted(share, 1 - tail + 1e-9) if tail < slack else len(share)
    return slice(int(first), int(last))


def _is_along(form: FittedCurve, nodes: Array) -> bool:
    """Return whether a curve clearly runs in the direction of ``(K, D)`` nodes, by the distances of its ends."""
    first, last = form.points[0].tolist(), form.points[-1].tolist()
    head, tail = nodes[0].tolist(), nodes[-1].tolist()
    forwards, backwards = dist(first, head) + dist(last, tail), dist(first, tail) + dist(last, head)
    return _CLEAR * forwards < backwards


def _apart(first: Array, second: Array) -> float:
    """Return the mean square distance of points, most of it after the best translation."""
    away = first - second
    shift = away.mean(axis=0)
    return float(np.mean(np.sum((away - shift) ** 2, axis=1)) + _PLACE * np.sum(shift**2))


def _widest_gap(curve: FittedCurve) -> tuple[int, int]:
    """Return the last point before and the first after the widest bridged piece; the same point without one."""
    if curve.whole:
        return 0, 0
    seen = np.flatnonzero(~curve.interpolated)
    if len(seen) < 2:
        return 0, 0
    widest = int(np.argmax(np.diff(curve.arc[seen])))
    first, last = int(seen[widest]), int(seen[widest + 1])
    return (first, last) if last > first + 1 else (0, 0)


def visible_nodes(prediction: Prediction) -> Array:
    """Return the predicted nodes of the visible piece, about as far apart: ``(K', D)``."""
    (head, tail), nodes = prediction.hints.hidden, prediction.nodes
    if head + tail <= 0:
        return nodes
    first, last = head, 1 - tail
    count = max(round(len(nodes) * (last - first)), _FEWEST)
    return _PredictedRope(prediction).at(first + (np.arange(count) + 0.5) / count * (last - first))


class _PredictedRope:
    """The predicted rope from tip to tip.

    Args:
        prediction: Its nodes lie at the centres of K equal pieces of the rope.
    """

    def __init__(self, prediction: Prediction) -> None:
        nodes, self.hidden = prediction.nodes, prediction.hints.hidden
        self.residual = prediction.hints.residual
        self.askew, self.resolution = _ASKEW * prediction.width, prediction.resolution
        self.share = np.concatenate([[0.0], (np.arange(len(nodes)) + 0.5) / len(nodes), [1.0]])
        self.points = np.concatenate([1.5 * nodes[:1] - 0.5 * nodes[1:2], nodes, 1.5 * nodes[-1:] - 0.5 * nodes[-2:-1]])

    def at(self, share: Array) -> Array:
        """Return ``(N, D)`` points at shares of the length."""
        return interpolate(self.points, self.share, share)

    def disagreement(self, found: Array, first: Array, last: Array) -> Array:
        """Return the mean square distances between curves and the rope's pieces between two shares of its length.

        Most of it is taken after the best rigid motion (Kabsch 1976): a prediction fails first in where a rope is,
        and last in how it is bent.

        Args:
            found: ``(C, 32, D)`` points along each curve.
            first: ``(C,)`` where each piece begins.
            last: ``(C,)`` where it ends.
        """
        share = first[:, None] + _PROBES * (last - first)[:, None]
        expected = self.at(share.ravel()).reshape(found.shape)
        apart = np.mean(np.sum((expected - found) ** 2, axis=2), axis=1)
        expected, found = (points - points.mean(axis=1, keepdims=True) for points in (expected, found))
        overlap = np.einsum("cpd,cpe->cde", expected, found)
        if found.shape[2] == 2:
            turned = np.hypot(overlap[:, 0, 0] + overlap[:, 1, 1], overlap[:, 0, 1] - overlap[:, 1, 0])
        else:
            values = np.linalg.svd(overlap, compute_uv=False)
            turned = values[:, :-1].sum(axis=1) + np.sign(np.linalg.det(overlap)) * values[:, -1]
        bent = np.sum(expected**2, axis=(1, 2)) + np.sum(found**2, axis=(1, 2)) - 2 * turned
        return np.maximum(bent, 0.0) / len(_PROBES) + _PLACE * apart

    def settle(self, apart: float) -> None:
        """Learn how far curves lie from their predictions, a mean square distance."""
        self.residual += _SETTLING * (min(apart, _OUTLIER * self.residual) - self.residual)

    def place(
        self,
        form: FittedCurve,
        ends: Ends,
        cut: Array,
        missing: float,
        noise: float,
        gap: tuple[int, int],
    ) -> tuple[float, float, float]:
        """Return how much of a rope is hidden at its start, at its end and in a gap: what costs least.

        Args:
            form: What is seen of it.
            ends: What is known about its tips.
            cut: ``(2,)`` how much likelier, as logarithms, they are cut than the rope's own.
            missing: By how much the form is shorter than the rope.
            noise: Standard deviation of the measured length.
            gap: The last point before a gap and the first after it.
        """
        length, stations = missing + float(form.stations[-1]), form.stations
        bridge = float(stations[gap[1]] - stations[gap[0]])
        shares = np.array([(a, b) for a, b in product(_SHARES, _SHARES) if a + b <= 1])
        if bridge == 0 and HIDDEN in ends:  # what is missing is hidden where something hides it
            shares = shares[shares.sum(axis=1) == 1]
        rest, hidden = (1 - shares.sum(axis=1)) * missing, shares * missing / length
        found = np.empty((len(shares), len(_PROBES), form.points.shape[1]))
        for more in np.unique(rest) if bridge else rest[:1]:
            moved = _widened(stations, gap, more) if bridge else stations
            found[rest == more if bridge else slice(None)] = interpolate(form.points, moved, _PROBES * moved[-1])
        apart = self.disagreement(found, hidden[:, 0], 1 - hidden[:, 1])
        cost = (rest / (noise + _BRIDGE * bridge)) ** 2
        for end in range(2):
            # What is hidden changes little from frame to frame; a free end is hidden in no frame for longer.
            known, last = ends[end], 0.0 if ends[end] == FREE else self.hidden[end]
            price = _FOLDED if known == FREE and HIDDEN in ends else _COST[known]
            price = price * (last <= 0) + 2 * (cut.max() - cut[end]) * (HIDDEN not in ends)
            change = ((hidden[:, end] - last) / _INERTIA[known]) ** 2
            cost += price * (hidden[:, end] > 0) + _TRUST * np.log1p(change / _TRUST)
        worse = _INDEPENDENT * (apart - apart.min()) / max(self.residual, (_NOISE * self.resolution) ** 2)
        cost += _TRUST * np.log1p(worse / _TRUST)
        best = int(np.argmin(cost))
        self.settle(float(apart[best]))
        head, tail = hidden[best] * length
        return float(head), float(tail), float(rest[best])

    def filled(
        self, form: FittedCurve, gap: tuple[int, int], head: float, between: float, length: float
    ) -> FittedCurve:
        """Return the curve with a gap as long as it is, and bent as predicted."""
        first, last = gap
        if last == first:
            return form
        stations = _widened(form.stations, gap, between)
        piece = self.at((head + np.linspace(stations[first], stations[last], last - first + 1)) / length)
        chord, wanted = piece[-1] - piece[0], form.points[last] - form.points[first]
        scale = np.linalg.norm(wanted) / max(float(np.linalg.norm(chord)), 1e-9)
        points = form.points
        if 1 / _STRETCH < scale < _STRETCH:
            # What is left over at the far end is spread along the piece, so that it meets both ends.
            piece = piece - piece[0] + points[first]
            piece += np.linspace(0, 1, len(piece))[:, None] * (points[last] - piece[-1])
            points = np.concatenate([points[:first], piece, points[last + 1 :]])
        drawn = form.with_geometry(points, form.interpolated)
        if form.metres is None:
            return replace(drawn, pixels=stations)
        more = stations[last] - stations[first]
        pixels = _widened(drawn.arc, gap, more * _seen_scale(form) - (drawn.arc[last] - drawn.arc[first]))
        return replace(drawn, metres=stations, pixels=pixels)

    def completed(
        self, form: FittedCurve, ends: Ends, head: float, tail: float, stretch: float, length: float
    ) -> FittedCurve:
        """Return the visible piece that begins at station ``head``, with the hidden ends before and behind it.

        A hand cuts a rope askew, and what is fitted turns into the longer side of the cut; near a long hidden end the
        rope is therefore as predicted too. The rest of an end that is free can only lie on what is seen of the rope.
        """
        stations = head + _stretched(form, length - head - tail)
        metric = form.metres is not None
        if head + tail <= 0:
            return (
                replace(form, metres=stations)
                if metric
                else form
                if form.pixels is None
                else replace(form, pixels=stations)
            )
        first, last = (self.askew if hidden > _LONG * length else 0.0 for hidden in (head, tail))
        inner = (form.arc >= first) & (form.arc <= form.size - last)
        if np.count_nonzero(inner) < 2:
            inner = np.ones(len(inner), bool)
        points, flags, at = form.points[inner], form.interpolated[inner], stations[inner]
        reach = max(int(_NEXT_TO * len(points)), 1)
        if ends[0] == FREE:
            before = _folded(points, at, at[0])[::-1]
        else:
            before = self._hidden(0.0, at[0], points[0], _scale(points[: reach + 1], at), length, at_start=True)
        if ends[1] == FREE:
            behind = _folded(points[::-1], at[-1] - at[::-1], length - at[-1])
        else:
            behind = self._hidden(at[-1], length, points[-1], _scale(points[-reach - 1 :], at[::-1]), length)
        hidden_before = np.linspace(0, at[0], len(before) + 1)[:-1]
        hidden_behind = np.linspace(at[-1], length, len(behind) + 1)[1:]
        whole = form.with_geometry(
            np.concatenate([before, points, behind]),
            np.concatenate([hidden_before < head - 1e-9, flags, hidden_behind > length - tail + 1e-9]),
        )
        along = np.concatenate([hidden_before, at, hidden_behind])
        if not metric:
            return replace(whole, pixels=along)
        if form.pixels is None:
            return replace(whole, metres=along)
        seen, drawn = form.pixels[inner], whole.arc
        ahead, past = len(before), len(before) + len(points)
        seen = drawn[ahead] + seen - seen[0]
        pixels = np.concatenate([drawn[:ahead], seen, seen[-1] + drawn[past:] - drawn[past - 1]])
        return replace(whole, metres=along, pixels=pixels)

    def _hidden(
        self, start: float, stop: float, joint: Array, scale: float, length: float, *, at_start: bool = False
    ) -> Array:
        """Return the rope between two stations without its joint with the visible piece, moved there.

        Args:
            start: First station.
            stop: Last station.
            joint: ``(D,)`` where the visible piece ends.
            scale: The curve's units in a unit of the stations.
            length: Of the rope.
            at_start: Whether the joint is at the last station.
        """
        if stop - start <= 1e-9 * length:
            return np.zeros((0, len(joint)))
        gap = length * self.share[1]
        share = np.linspace(start, stop, max(int(np.ceil((stop - start) / gap)) + 1, 2)) / length
        piece = self.at(share)
        piece = piece - piece[-1 if at_start else 0]
        piece *= scale * (stop - start) / max(float(arc_length(np.ascontiguousarray(piece))[-1]), 1e-9)
        return (piece[:-1] if at_start else piece[1:]) + joint


def _on(curve: FittedCurve) -> Array:
    """Return ``(32, D)`` points at equal steps along a curve."""
    return interpolate(curve.points, curve.stations, _PROBES * curve.stations[-1])


def _stretched(form: FittedCurve, length: float) -> Array:
    """Return a curve's stations, made to span a length.

    In metres, what was measured too short or too long is so where the curve runs towards the camera: there a pixel
    holds much of it.
    """
    stations = form.stations
    if form.metres is None:
        return stations * (length / max(float(stations[-1]), 1e-9))
    step, pixels = np.diff(stations), np.maximum(np.diff(form.arc), 1e-9)
    steep = np.maximum((step / pixels / np.median(step / pixels)) ** 2 - 1, 0.0)
    weight = step * (_EVENLY + steep)
    more = (length - float(stations[-1])) * weight / max(float(weight.sum()), 1e-12)
    return np.concatenate([[0.0], np.cumsum(np.maximum(step + more, 0.1 * step))])


def _folded(points: Array, stations: Array, length: float) -> Array:
    """Return an end that lies back on the curve, from behind the curve's first point on."""
    along = stations - stations[0]
    count = int(np.searchsorted(along, length, side="right"))
    if length <= 1e-9 * along[-1]:
        return points[:0]
    at = np.linspace(0, length, max(count, 2))[1:]
    return interpolate(np.ascontiguousarray(points), np.ascontiguousarray(along), at)


def _widened(stations: Array, gap: tuple[int, int], more: float) -> Array:
    """Return stations with a gap that is longer."""
    first, last = gap
    out = stations.copy()
    out[first : last + 1] += more * np.linspace(0, 1, last - first + 1)
    out[last + 1 :] += more
    return out


def _seen_scale(form: FittedCurve) -> float:
    """Return the pixels in a unit of a curve's stations, where it is visible."""
    seen = ~form.interpolated
    seen = seen[1:] & seen[:-1]
    return float(np.diff(form.arc)[seen].sum()) / max(float(np.diff(form.stations)[seen].sum()), 1e-9)


def _scale(points: Array, stations: Array) -> float:
    """Return the units of a curve in a unit of its stations, which begin with the points'."""
    along = abs(float(stations[len(points) - 1] - stations[0]))
    return float(arc_length(np.ascontiguousarray(points))[-1]) / max(along, 1e-9)
