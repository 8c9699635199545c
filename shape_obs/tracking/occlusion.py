"""Occlusion: find out which piece of a known rope a visible curve is.

A rope has a length, and what is seen of it may be shorter for three reasons: an end is hidden, a gap is bridged too
straight, or the measurement is short, because of noise or, in pixels, of perspective. One decision weighs all of them,
see ``rope_match``. Visible points keep their distance from the rope's ends, and hidden ends are carried along.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.curve import FittedCurve, TrackHints
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.tracking.occluders import Tips
from shape_obs.tracking.placement import widened
from shape_obs.tracking.predicted_rope import PredictedRope, oriented
from shape_obs.tracking.prediction import Prediction
from shape_obs.tracking.rope_match import Expected, evened, match_to_rope
from shape_obs.tracking.state import State, new_rope

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Ends = tuple[int, int]

_STRETCH: Final = 1.3  # a predicted piece is not laid into a gap that is this much wider or narrower
_LONG: Final = 0.06  # of the length: next to a hidden end that is shorter, the visible piece stays as it is
_NOTHING: Final = np.zeros(0)
_NO_NODES: Final = np.zeros((0, 2))
_WHOLE: Final = 0.03  # of a length in metres, by which the curve of a whole rope may be too long or too short
_RIVAL: Final = 0.08  # of the length: if so much more may be hidden at the other end, nothing is known of either
_TURN: Final = 0.06  # of the length, at most: so much next to what lies behind the rope is off by up to 2 gaps of 20
_LEVELLING: Final = 0.1  # of the relief of what is hidden, lost in a frame: it is as deep as what is seen next to it
_NEXT_TO: Final = 0.25  # of the visible piece, next to a hidden end, whose scale that end has


def expected_rope(prediction: Prediction | None, width: float, metres: float) -> tuple[State, Expected, Array, Array]:
    """Return what a track knows of a rope and expects of it, as ``match_to_rope`` takes it.

    Args:
        prediction: None at a cold start.
        width: Of the rope, pixels.
        metres: Its length if that is known at a cold start; else 0.
    """
    if prediction is None:
        return new_rope(metres), (float(width), 1.0, 1.0, 0.0, 0.0), _NO_NODES, _NOTHING
    moment = float(prediction.lapse), float(prediction.stale), float(prediction.motion)
    relief = _NOTHING if prediction.relief is None else prediction.relief
    return prediction.rope, (float(width), float(prediction.resolution), *moment), prediction.nodes, relief


def is_plain(rope: State) -> bool:
    """Return whether a curve is all of a rope, in its direction, and no piece of it is bridged."""
    first, last = rope["gap"][0]
    return bool(rope["aligned"][0]) and first == last and max(rope["hidden"][0]) <= 0


def ambiguity_of(rope: State) -> str:
    """Return why a match may be wrong though it is the likeliest; empty if it is not in doubt."""
    return "it is in doubt which end of the rope is out of sight" if rope["rival"][0] > _RIVAL else ""


def match_chain(form: FittedCurve, prediction: Prediction, tips: Tips) -> FittedCurve:
    """Give a curve the direction of the rope, and put back what of it is hidden.

    Args:
        form: ``(P, D)`` fitted to this frame, in any direction; its hints hold what ``match_to_rope`` found.
        prediction: Where the rope should be.
        tips: What the curve's tips look like.

    Returns:
        The whole rope. Its hints hold what is known of it now.
    """
    state, stations = form.rope, form.metres
    if not state["aligned"][0]:
        form, back = oriented(form, PredictedRope(prediction, form), tips)
        tips, known = tips.reversed() if back else tips, expected_rope(prediction, form.width, 0.0)
        state, stations = match_to_rope(*_seen(form), *tips, *known, True)
    metric, (head, tail), gap = form.metres is not None, state["hidden"][0], state["gap"][0]
    if gap[1] > gap[0] or head + tail > 0:
        known = PredictedRope(prediction, form)
        length = float(known.state["metres" if metric else "pixels"])
        form = _filled(known, form, gap.tolist(), head * length, float(state["between"][0]), length)
        form = _completed(known, form, state[0], length)
        stations = form.metres
    return FittedCurve(
        form.points, form.interpolated, form.arc, False, stations if metric else None, form.pixels, form.relief,
        form.width, form.space, hints=TrackHints(state), ambiguity=ambiguity_of(state) or form.ambiguity,
    )  # fmt: skip


def _seen(form: FittedCurve) -> tuple[Array, Array, Mask, Array, Array]:
    """Return the arrays of a curve as ``match_to_rope`` takes them."""
    metres, relief = _NOTHING if form.metres is None else form.metres, _NOTHING if form.relief is None else form.relief
    return form.points, form.arc, form.interpolated, metres, relief


def is_whole(form: FittedCurve) -> bool:
    """Return whether a form is as long in space as its rope, and nothing of it is hidden."""
    return form.metres is not None and not form.hints.hides and abs(float(form.rope["stretch"][0]) - 1) <= _WHOLE


def shown(form: FittedCurve) -> slice:
    """Return the piece of a matched curve over which points are spread: without what may be hidden by noise alone.

    Of an end that something hides, two thirds of what may be noise elsewhere.
    """
    if not form.hints.hides:
        return slice(None)
    rope = form.rope
    share, (head, tail) = form.stations / form.stations[-1], rope["hidden"][0].tolist()
    least = [float(rope["tolerance"][0]) * (2 / 3 if over else 1) for over in rope["occluded"][0]]
    first = np.searchsorted(share, head - 1e-9) if head < least[0] else 0
    last = np.searchsorted(share, 1 - tail + 1e-9) if tail < least[1] else len(share)
    return slice(int(first), int(last))


def _filled(
    rope: PredictedRope, form: FittedCurve, gap: list[int], head: float, between: float, length: float
) -> FittedCurve:
    """Return the curve with a gap as long as it is, and bent as predicted."""
    first, last = gap
    if last == first:
        return form
    stations = widened(form.stations, (first, last), between)
    piece = rope.at((head + np.linspace(stations[first], stations[last], last - first + 1)) / length)
    points = rope.points_of(form)
    chord, wanted = piece[-1] - piece[0], points[last] - points[first]
    scale = np.linalg.norm(wanted) / max(float(np.linalg.norm(chord)), 1e-9)
    if 1 / _STRETCH < scale < _STRETCH:
        # What is left over at the far end is spread along the piece, so that it meets both ends.
        piece = piece - piece[0] + points[first]
        piece += np.linspace(0, 1, len(piece))[:, None] * (points[last] - piece[-1])
        piece = _drawn_tight(piece, (stations[last] - stations[first]) * _seen_scale(form, points))
        if rope.lifted:
            piece[:, -1] += _LEVELLING * (np.linspace(piece[0, -1], piece[-1, -1], len(piece)) - piece[:, -1])
        points = np.concatenate([points[:first], piece, points[last + 1 :]])
    drawn = form.relaid(points, form.interpolated)
    if form.metres is None:
        return replace(drawn, pixels=stations)
    more = stations[last] - stations[first]
    pixels = widened(
        drawn.arc, (first, last), more * _seen_scale(form, form.points) - (drawn.arc[last] - drawn.arc[first])
    )
    return replace(drawn, metres=stations, pixels=pixels)


def _completed(rope: PredictedRope, form: FittedCurve, found: Any, length: float) -> FittedCurve:
    """Return the visible piece that begins at station ``head``, with the hidden ends before and behind it.

    A hand cuts a rope askew, and what is fitted turns into the longer side of the cut; near a long hidden end the
    rope is therefore as predicted too. The rest of an end that is free can only lie on what is seen of the rope.
    """
    (head, tail), occluded, folded = found["hidden"] * length, found["occluded"], found["folded"]
    stations = head + _stretched(form, length - head - tail)
    metric = form.metres is not None
    if head + tail <= 0:
        return replace(form, metres=stations) if metric else replace(form, pixels=stations)
    first, last = (rope.askew if hidden > _LONG * length else 0.0 for hidden in (head, tail))
    inner = (form.arc >= first) & (form.arc <= form.size - last)
    if np.count_nonzero(inner) < 2:
        inner = np.ones(len(inner), bool)
    points, flags, at = rope.points_of(form)[inner], form.interpolated[inner], stations[inner]
    reach = max(int(_NEXT_TO * len(points)), 1)
    if folded[0]:
        before = _folded(points, at, at[0])[::-1]
    else:
        before = _hidden_piece(rope, 0, at[0], points[: reach + 1], at[: reach + 1], length, bool(occluded[0]))[::-1]
    if folded[1]:
        behind = _folded(points[::-1], at[-1] - at[::-1], length - at[-1])
    else:
        behind = _hidden_piece(
            rope, 1, length - at[-1], points[: -reach - 2 : -1], at[: -reach - 2 : -1], length, bool(occluded[1])
        )
    hidden_before = np.linspace(0, at[0], len(before) + 1)[:-1]
    hidden_behind = np.linspace(at[-1], length, len(behind) + 1)[1:]
    along = np.concatenate([hidden_before, at, hidden_behind])
    # Where a rope turns round or towards the camera, and goes on behind itself, a part of the turn is not seen either.
    first, last = (
        hidden + min(hidden, _TURN * length) * (metric and not over)
        for hidden, over in zip((head, tail), occluded, strict=True)
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
    rope: PredictedRope, end: int, hidden: float, seen: Array, stations: Array, length: float, over: bool
) -> Array:
    """Return a hidden end of the rope from its joint with the visible piece outwards, without the joint.

    It is bent as predicted, but goes straight on if it was folded back onto the rope before: of that, nothing is known.

    Args:
        rope: Where it was expected.
        end: 0 for its start, 1 for its end.
        hidden: Length of what is hidden.
        seen: ``(P, D)`` the visible piece from the joint inwards.
        stations: ``(P,)`` of these points.
        length: Of the rope.
        over: Whether something lies over it: then its depth is not known from where it was predicted.
    """
    if hidden <= 1e-9 * length:
        return np.zeros((0, seen.shape[1]))
    count = max(int(np.ceil(hidden / (length * rope.share[1]))) + 1, 2)
    scale = float(arc_length(np.ascontiguousarray(seen))[-1]) / max(abs(float(stations[-1] - stations[0])), 1e-9)
    if rope.folded[end] and rope.hidden[end] > 0:
        piece = np.linspace(0, 1, count)[:, None] * (seen[0] - seen[-1])
    else:
        share = np.linspace(hidden, 0, count) / length
        piece = rope.at(1 - share if end else share)
        piece = piece - piece[0]
        if rope.lifted and over:
            piece[:, 2] *= 1 - _LEVELLING
    piece = piece * (scale * hidden / max(float(arc_length(np.ascontiguousarray(piece))[-1]), 1e-9))
    return piece[1:] + seen[0]


def _stretched(form: FittedCurve, length: float) -> Array:
    """Return a curve's stations, made to span a length.

    In metres, what was measured too short or too long is so where the curve runs towards the camera: there a pixel
    holds much of it.
    """
    stations = form.stations
    if form.metres is None:
        return stations * (length / max(float(stations[-1]), 1e-9))
    return evened(stations, form.arc, length)


def _folded(points: Array, stations: Array, length: float) -> Array:
    """Return an end that lies back on the curve, from behind the curve's first point on."""
    along = stations - stations[0]
    count = int(np.searchsorted(along, length, side="right"))
    if length <= 1e-9 * along[-1]:
        return points[:0]
    at = np.linspace(0, length, max(count, 2))[1:]
    return interpolate(np.ascontiguousarray(points), np.ascontiguousarray(along), at)


def _drawn_tight(piece: Array, length: float) -> Array:
    """Return a piece of a rope, pulled towards its chord until it is no longer than it can be.

    What is predicted of a piece that stays out of sight comes from what was put there before: else it would grow.
    """
    line = np.linspace(piece[0], piece[-1], len(piece))
    size, chord = float(arc_length(np.ascontiguousarray(piece))[-1]), float(np.linalg.norm(piece[-1] - piece[0]))
    if size <= max(length, chord):
        return piece
    return line + ((max(length, chord) ** 2 - chord**2) / (size**2 - chord**2)) ** 0.5 * (piece - line)


def _seen_scale(form: FittedCurve, points: Array) -> float:
    """Return how long a curve through points is for each unit of its stations, where it is visible."""
    seen, arc = ~form.interpolated, arc_length(np.ascontiguousarray(points))
    seen = seen[1:] & seen[:-1]
    return float(np.diff(arc)[seen].sum()) / max(float(np.diff(form.stations)[seen].sum()), 1e-9)
