"""Occlusion: find out which piece of a known rope a visible curve is.

A rope has a length, and what is seen of it may be shorter for three reasons: an end is hidden, a gap is bridged too
straight, or the measurement is short, because of noise or, in pixels, of perspective. One decision weighs all of them:
for each way to share out what is missing, how well the visible points agree with where their material was expected, how
far the measurement would have to be off, and what is seen at the tips. Visible points keep their distance from the
rope's ends, and hidden ends are carried along.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import FittedCurve, TrackHints
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.tracking.occluders import FREE, HIDDEN, UNKNOWN, Tips
from shape_obs.tracking.predicted_rope import PredictedRope, disagreements, oriented, widened
from shape_obs.tracking.prediction import Prediction
from shape_obs.tracking.rope_length import learnt, shortened

Array = npt.NDArray[np.float64]
Ends = tuple[int, int]

_WHOLE: Final = 0.03  # of a length in metres, by which the curve of a whole rope may be too long or too short
_GRAIN: Final = (0.3, 0.9)  # in resolutions: that of a short one, and what a rope adds that is seen twice as short
_POINTING: Final = 3.0  # times as long in space as in the image: there a tip hides what goes on behind it
_SLACK: Final = (0.01, 1.5)  # of the length and in resolutions: what is missing below this is noise
_BEYOND: Final = 4.0  # standard deviations, beyond which noise explains nothing
_STRETCH: Final = 1.3  # a predicted piece is not laid into a gap that is this much wider or narrower
_EVENLY: Final = 0.1  # the weight of a piece of a curve at a right angle to the view, in a length that is off
_LEAST: Final = 0.002  # of a length in pixels: less cannot be seen to be missing
_FADING: Final = 0.8  # how much of the last frame's evidence for cut tips is kept
_CERTAIN: Final = 8.0  # the most that such evidence can weigh
_DOUBTFUL: Final = 1.5  # standard deviations by which a rope is too short, and its tips may be cut
_LONG: Final = 0.06  # of the length: next to a hidden end that is shorter, the visible piece stays as it is
_RIVAL: Final = 0.08  # of the length: if so much more may be hidden at the other end, nothing is known of either
_TURN: Final = 0.06  # of the length, at most: so much next to what lies behind the rope is off by up to 2 gaps of 20
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
    rope, known = PredictedRope(prediction, form), prediction.hints.length
    turned, back = oriented(form, rope, known)
    form, tips = turned, tips.reversed() if back else tips
    ends, steep = tips.known, form.steepness(prediction.width / 2)
    if HIDDEN in ends:  # that explains what is missing
        ends = (ends[0] or FREE, ends[1] or FREE)
    # What points at the camera lies in front of what goes on behind it.
    first, last = (end == FREE and aslant > _POINTING for end, aslant in zip(ends, steep[[0, -1]], strict=True))
    ends = UNKNOWN if first else ends[0], UNKNOWN if last else ends[1]
    before = prediction.hints
    head, tail = (_FADING * old + new for old, new in zip(before.cut, tips.cut(before.tips), strict=True))
    cut = max(min(head, _CERTAIN), -_CERTAIN), max(min(tail, _CERTAIN), -_CERTAIN)
    unit = "m" if form.metres is not None or form.points.shape[1] == 3 else "px"
    length = known.metres if form.metres is not None else known.pixels
    if length <= 0:
        return replace(form, hints=TrackHints(length=learnt(known, form, ends), tips=tips.remembered(None, 0)))
    gap = _widest_gap(form)
    resolution = prediction.resolution * float(form.stations[-1]) / max(form.size, 1e-9)
    slack, missing = _SLACK[0] * length + _SLACK[1] * resolution, length - float(form.stations[-1])
    head = tail = adrift = 0.0
    least = _LEAST * length
    grain = _GRAIN[0] + _GRAIN[1] * (float(steep.max(initial=1.0)) - 1)
    noise = (known.spread if unit == "px" else known.spread_metres) * length + grain * resolution
    if missing > 0 and (gap[1] > gap[0] or missing > least or HIDDEN in ends):
        head, tail, between = rope.place(form, ends, cut, missing, noise, gap)
        adrift = rope.adrift
        form = _filled(rope, form, gap, head, between, length)
        if rope.rival > _RIVAL:
            form = replace(form, ambiguity="it is in doubt which end of the rope is out of sight")
    else:
        bent, apart = disagreements(rope.points, rope.share, rope.along(form)[None], np.zeros((1, 2)))
        rope.settle(float(bent[0]), float(apart[0]))
    doubtful = missing > _DOUBTFUL * noise and max(cut) > 0
    if head + tail <= least and not doubtful:
        now, own = learnt(known, form, ends), tips.remembered(before.tips, known.frames)
    else:
        now, own = shortened(known, form, ends == (FREE, FREE) and missing > _BEYOND * noise), before.tips
    stretch = (length - head - tail) / max(float(form.stations[-1]), 1e-9)
    form = _completed(rope, form, ends, head, tail, stretch, length)
    hidden = head / length, tail / length
    covered, folded = ((ends[0] == known, ends[1] == known) for known in (HIDDEN, FREE))
    measured = before.measured if head + tail > least else length - missing
    hints = TrackHints(
        hidden, covered, folded, adrift, slack / length, stretch, measured, rope.residuals, cut, own, now
    )
    return replace(form, hints=hints)


def surprise(form: FittedCurve, prediction: Prediction) -> float:
    """Return by which share of its length other parts of a rope are hidden than before, or by which it is off."""
    (head, tail), before, hints = form.hints.hidden, prediction.hints.hidden, form.hints
    change = abs(head - before[0]) + abs(tail - before[1])
    return max(change, (1 if form.metres is None else 2) * abs(hints.stretch - 1))


def is_whole(form: FittedCurve) -> bool:
    """Return whether a form is as long in space as its rope, and nothing of it is hidden."""
    return form.metres is not None and max(form.hints.hidden) <= 0 and abs(form.hints.stretch - 1) <= _WHOLE


def shown(form: FittedCurve) -> slice:
    """Return the piece of a matched curve over which points are spread: without ends hidden by less than the slack."""
    (head, tail), slack, share = form.hints.hidden, form.hints.slack, form.stations / form.stations[-1]
    first = np.searchsorted(share, head - 1e-9) if head < slack else 0
    last = np.searchsorted(share, 1 - tail + 1e-9) if tail < slack else len(share)
    return slice(int(first), int(last))


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


def _filled(
    rope: PredictedRope, form: FittedCurve, gap: tuple[int, int], head: float, between: float, length: float
) -> FittedCurve:
    """Return the curve with a gap as long as it is, and bent as predicted."""
    first, last = gap
    if last == first:
        return form
    stations = widened(form.stations, gap, between)
    piece = rope.at((head + np.linspace(stations[first], stations[last], last - first + 1)) / length)
    points = rope.points_of(form)
    chord, wanted = piece[-1] - piece[0], points[last] - points[first]
    scale = np.linalg.norm(wanted) / max(float(np.linalg.norm(chord)), 1e-9)
    if 1 / _STRETCH < scale < _STRETCH:
        # What is left over at the far end is spread along the piece, so that it meets both ends.
        piece = piece - piece[0] + points[first]
        piece += np.linspace(0, 1, len(piece))[:, None] * (points[last] - piece[-1])
        points = np.concatenate([points[:first], piece, points[last + 1 :]])
    drawn = form.relaid(points, form.interpolated)
    if form.metres is None:
        return replace(drawn, pixels=stations)
    more = stations[last] - stations[first]
    pixels = widened(drawn.arc, gap, more * _seen_scale(form) - (drawn.arc[last] - drawn.arc[first]))
    return replace(drawn, metres=stations, pixels=pixels)


def _completed(
    rope: PredictedRope, form: FittedCurve, ends: Ends, head: float, tail: float, stretch: float, length: float
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
    first, last = (rope.askew if hidden > _LONG * length else 0.0 for hidden in (head, tail))
    inner = (form.arc >= first) & (form.arc <= form.size - last)
    if np.count_nonzero(inner) < 2:
        inner = np.ones(len(inner), bool)
    points, flags, at = rope.points_of(form)[inner], form.interpolated[inner], stations[inner]
    reach = max(int(_NEXT_TO * len(points)), 1)
    if ends[0] == FREE:
        before = _folded(points, at, at[0])[::-1]
    else:
        before = _hidden_piece(rope, 0.0, at[0], points[0], _scale(points[: reach + 1], at), length, at_start=True)
    if ends[1] == FREE:
        behind = _folded(points[::-1], at[-1] - at[::-1], length - at[-1])
    else:
        behind = _hidden_piece(rope, at[-1], length, points[-1], _scale(points[-reach - 1 :], at[::-1]), length)
    hidden_before = np.linspace(0, at[0], len(before) + 1)[:-1]
    hidden_behind = np.linspace(at[-1], length, len(behind) + 1)[1:]
    along = np.concatenate([hidden_before, at, hidden_behind])
    # Where a rope turns round or towards the camera, and goes on behind itself, a part of the turn is not seen either.
    first, last = (
        hidden + min(hidden, _TURN * length) * (metric and end != HIDDEN)
        for hidden, end in zip((head, tail), ends, strict=True)
    )
    flags = np.concatenate([np.zeros(len(before), bool), flags, np.zeros(len(behind), bool)])
    flags |= (along < first - 1e-9) | (along > length - last + 1e-9)
    whole = form.relaid(np.concatenate([before, points, behind]), flags)
    if not metric:
        return replace(whole, pixels=along)
    if form.pixels is None:
        return replace(whole, metres=along)
    seen, drawn = form.pixels[inner], whole.arc
    ahead, past = len(before), len(before) + len(points)
    seen = drawn[ahead] + seen - seen[0]
    pixels = np.concatenate([drawn[:ahead], seen, seen[-1] + drawn[past:] - drawn[past - 1]])
    return replace(whole, metres=along, pixels=pixels)


def _hidden_piece(
    rope: PredictedRope, start: float, stop: float, joint: Array, scale: float, length: float, *, at_start: bool = False
) -> Array:
    """Return the rope between two stations without its joint with the visible piece, moved there.

    Args:
        rope: Where it was expected.
        start: First station.
        stop: Last station.
        joint: ``(D,)`` where the visible piece ends.
        scale: The curve's units in a unit of the stations.
        length: Of the rope.
        at_start: Whether the joint is at the last station.
    """
    if stop - start <= 1e-9 * length:
        return np.zeros((0, len(joint)))
    gap = length * rope.share[1]
    share = np.linspace(start, stop, max(int(np.ceil((stop - start) / gap)) + 1, 2)) / length
    piece = rope.at(share)
    piece = piece - piece[-1 if at_start else 0]
    piece *= scale * (stop - start) / max(float(arc_length(np.ascontiguousarray(piece))[-1]), 1e-9)
    return (piece[:-1] if at_start else piece[1:]) + joint


def _stretched(form: FittedCurve, length: float) -> Array:
    """Return a curve's stations, made to span a length.

    In metres, what was measured too short or too long is so where the curve runs towards the camera: there a pixel
    holds much of it.
    """
    stations = form.stations
    if form.metres is None:
        return stations * (length / max(float(stations[-1]), 1e-9))
    return evened(stations, form.arc, length)


@compiled("(f8[::1], f8[::1], f8)")
def evened(stations: Array, arc: Array, length: float) -> Array:
    """Return stations in metres that span a length, see ``_stretched``."""
    step, pixels = np.diff(stations), np.maximum(np.diff(arc), 1e-9)
    usual = np.median(step / pixels)
    weight = step * (_EVENLY + np.maximum((step / pixels / usual) ** 2 - 1, 0.0))
    share, out = (length - stations[-1]) / max(weight.sum(), 1e-12), np.zeros(len(stations))
    for p in range(len(step)):
        out[p + 1] = out[p] + max(step[p] + share * weight[p], 0.1 * step[p])
    return out


def _folded(points: Array, stations: Array, length: float) -> Array:
    """Return an end that lies back on the curve, from behind the curve's first point on."""
    along = stations - stations[0]
    count = int(np.searchsorted(along, length, side="right"))
    if length <= 1e-9 * along[-1]:
        return points[:0]
    at = np.linspace(0, length, max(count, 2))[1:]
    return interpolate(np.ascontiguousarray(points), np.ascontiguousarray(along), at)


def _seen_scale(form: FittedCurve) -> float:
    """Return the pixels in a unit of a curve's stations, where it is visible."""
    seen = ~form.interpolated
    seen = seen[1:] & seen[:-1]
    return float(np.diff(form.arc)[seen].sum()) / max(float(np.diff(form.stations)[seen].sum()), 1e-9)


def _scale(points: Array, stations: Array) -> float:
    """Return the units of a curve in a unit of its stations, which begin with the points'."""
    along = abs(float(stations[len(points) - 1] - stations[0]))
    return float(arc_length(np.ascontiguousarray(points))[-1]) / max(along, 1e-9)
