"""Complete: put back what is hidden of a rope, so that its visible points keep their distance from its ends.

A gap is as long as the rope goes on behind it, and bent as predicted; a hidden end is carried along with what is seen
next to it; an end that is folded back is on what is seen.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import first_coordinates, with_log_depth
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.geometry.topology import from_tip_to_tip
from shape_obs.tracking.model import gain_of
from shape_obs.tracking.placement import widened
from shape_obs.tracking.register_chain import evened
from shape_obs.tracking.state import State

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_NONE: Final = 1e-9  # of a length: less is nothing


@compiled
def complete_chain(
    points: Array, arc: Array, flags: Mask, metres: Array, log_depth: Array, before: State, known: State, width: float,
    lasted: float, nodes: Array, node_log_depth: Array, model: Any,
) -> tuple[Array, Array, Mask, Array, Array, Array]:  # fmt: skip
    """Return the whole curve of a rope that is seen in part.

    Args:
        points: ``(P, D)`` what is seen, in the direction of the rope, in pixels or metres.
        arc: ``(P,)`` its arc length.
        flags: ``(P,)`` what of it is bridged.
        metres: ``(P,)`` its arc length in space; ``(0,)`` if it is not known, or the points are in space.
        log_depth: ``(P,)`` see ``FittedCurve``; ``(0,)`` without.
        before: ``(1,)`` what was known of the rope before this frame.
        known: ``(1,)`` what is known now, see ``register_chain``.
        width: Of the rope, pixels, as it was; 0 in a cloud.
        lasted: Seconds for which this frame counts.
        nodes: ``(K, D)`` where it is predicted.
        node_log_depth: ``(K,)`` their log-depth; ``(0,)`` without.
        model: The constants, one ``ChainModel``.

    Returns:
        ``(P', D)`` the curve from tip to tip; ``(P',)`` its arc length, and what of it is interpolated; how far along
        the rope each point lies in metres, and in the unit of the points where gaps and ends are longer than they are
        drawn; its log-depth. The last three are ``(0,)`` if they are not known.
    """
    metric, lifted, was, now = len(metres) > 0, len(log_depth) > 0 and len(node_log_depth) > 0, before[0], known[0]
    rope, share = from_tip_to_tip(with_log_depth(nodes, node_log_depth) if lifted else nodes)
    curve, stations, size = (
        with_log_depth(points, log_depth) if lifted else points,
        metres if metric else arc,
        points.shape[1],
    )
    length = was.metres if metric else was.pixels
    head, tail, pixels = now.hidden[0] * length, now.hidden[1] * length, arc[:0]
    gap = int(now.gap[0]), int(now.gap[1])
    level = gain_of(lasted, model.levelling)
    if gap[1] > gap[0]:
        scale, drawn = _seen_scale(points, stations, flags), _seen_scale(curve, stations, flags)
        stations = widened(stations, gap, now.between)
        curve = _filled(curve, stations, gap, drawn, rope, share, head, length, lifted, level, model)
        arc = arc_length(first_coordinates(curve, size))
        if metric:
            first, last = gap
            longer = (stations[last] - stations[first]) * scale - (arc[last] - arc[first])
            pixels = widened(arc, gap, float(longer))
    stations = evened(stations, arc, length - head - tail, model) if metric else stations.copy()
    scaled = 1.0 if metric else (length - head - tail) / max(stations[-1], 1e-9)
    for p in range(len(stations)):
        stations[p] = head + scaled * stations[p]
    if head + tail > 0:
        curve, flags, stations, pixels = _with_ends(
            curve,
            arc,
            flags,
            stations,
            pixels,
            rope,
            share,
            was,
            now,
            length,
            width,
            size,
            metric,
            lifted,
            level,
            model,
        )
        arc = arc_length(first_coordinates(curve, size))
    deep = np.empty(len(curve) if lifted else 0)
    for p in range(len(deep)):
        deep[p] = curve[p, size]
    return (
        first_coordinates(curve, size),
        arc,
        flags,
        stations if metric else arc[:0],
        pixels if metric else stations,
        deep,
    )


@compiled
def _with_ends(
    curve: Array, arc: Array, flags: Mask, stations: Array, pixels: Array, rope: Array, share: Array, was: Any,
    now: Any, length: float, width: float, size: int, metric: bool, lifted: bool, level: float, model: Any,
) -> tuple[Array, Mask, Array, Array]:  # fmt: skip
    """Return the visible piece with the hidden ends before and behind it.

    A hand cuts a rope askew, and what is fitted turns into the longer side of the cut; near a long hidden end the
    rope is therefore as predicted too. The rest of an end that is free can only lie on what is seen of the rope.

    Args:
        curve: ``(P, D)`` the visible piece.
        arc: ``(P,)`` its arc length.
        flags: ``(P,)`` what of it is interpolated.
        stations: ``(P,)`` how far along the rope its points lie.
        pixels: ``(P,)`` the same in the image, or ``(0,)``.
        rope: ``(K, D)`` where the rope is predicted, from tip to tip.
        share: ``(K,)`` where these points lie along it, 0...1.
        was: What was known of the rope.
        now: What is known now.
        length: Of the rope, in the unit of the stations.
        width: Pixels.
        size: How many of the coordinates are places.
        metric: Whether stations are metres though points are pixels.
        lifted: Whether the last coordinate is log-depth.
        level: Share by which the log-depth of what is hidden nears that of what is seen next to it.
        model: The constants, one ``ChainModel``.

    Returns:
        Points, flags, stations and pixels of the whole.
    """
    head, tail = now.hidden[0] * length, now.hidden[1] * length
    start, stop, cut, long = 0, len(arc), model.along_cut * width, model.long_end * length
    while start < stop and arc[start] < (cut if head > long else 0.0):
        start += 1
    while stop > start and arc[stop - 1] > arc[-1] - (
        model.along_cut * width if tail > model.long_end * length else 0.0
    ):
        stop -= 1
    if stop - start < 2:
        start, stop = 0, len(arc)
    seen, at = curve[start:stop].copy(), stations[start:stop].copy()
    back, from_end = seen[::-1].copy(), at[-1] - at[::-1].copy()
    reach = max(int(model.next_to * len(seen)), 1) + 1
    if now.folded[0]:
        before = _folded(seen, at - at[0], at[0])
    else:
        before = _hidden_piece(
            rope,
            share,
            was,
            0,
            at[0],
            seen[:reach],
            at[:reach],
            length,
            lifted,
            level * (lifted and now.occluded[0] != 0),
            model,
        )
    if now.folded[1]:
        behind = _folded(back, from_end, length - at[-1])
    else:
        behind = _hidden_piece(
            rope, share, was, 1, length - at[-1], back[:reach], from_end[:reach], length, lifted,
            level * (lifted and now.occluded[1] != 0), model,
        )  # fmt: skip
    ahead, past = len(before), len(before) + len(seen)
    count = past + len(behind)
    whole, along, hidden = np.empty((count, curve.shape[1])), np.empty(count), np.zeros(count, np.bool_)
    for p in range(count):
        for d in range(curve.shape[1]):
            whole[p, d] = (
                before[ahead - 1 - p, d] if p < ahead else seen[p - ahead, d] if p < past else behind[p - past, d]
            )
        if p < ahead:
            along[p] = at[0] * p / ahead
        elif p < past:
            along[p], hidden[p] = at[p - ahead], flags[start + p - ahead]
        else:
            along[p] = at[-1] + (length - at[-1]) * (p - past + 1) / len(behind)
    # Where a rope turns round or towards the camera, and goes on behind itself, a part of the turn is not seen either.
    first, last = head, tail
    if metric and not now.occluded[0]:
        first += min(head, model.turn * length)
    if metric and not now.occluded[1]:
        last += min(tail, model.turn * length)
    for p in range(count):
        hidden[p] = hidden[p] or along[p] < first - 1e-9 or along[p] > length - last + 1e-9
    if len(pixels) == 0:
        return whole, hidden, along, pixels
    drawn, out = arc_length(first_coordinates(whole, size)), np.empty(count)
    for p in range(count):
        if p < ahead:
            out[p] = drawn[p]
        elif p < past:
            out[p] = drawn[ahead] + pixels[start + p - ahead] - pixels[start]
        else:
            out[p] = out[past - 1] + drawn[p] - drawn[past - 1]
    return whole, hidden, along, out


@compiled
def _filled(
    curve: Array, stations: Array, gap: tuple[int, int], scale: float, rope: Array, share: Array, head: float,
    length: float, lifted: bool, level: float, model: Any,
) -> Array:  # fmt: skip
    """Return a curve with a gap that is bent as predicted.

    Args:
        curve: ``(P, D)``.
        stations: ``(P,)`` how far along the visible piece its points lie.
        gap: The last point before it and the first after it.
        scale: How long the curve is for each unit of the stations, where it is visible.
        rope: ``(K, D)`` where the rope is predicted, from tip to tip.
        share: ``(K,)`` where these points lie along it, 0...1.
        head: Length that is hidden at its start.
        length: Of the rope.
        lifted: Whether the last coordinate is log-depth.
        level: Share by which its log-depth nears that of what is seen next to it.
        model: The constants, one ``ChainModel``.
    """
    first, last = gap
    count, size, out = last - first, curve.shape[1], curve.copy()
    long = stations[last] - stations[first]
    piece = interpolate(rope, share, (head + stations[first] + np.arange(count + 1) / count * long) / length)
    predicted = wanted = 0.0
    for d in range(size):
        predicted += (piece[count, d] - piece[0, d]) ** 2
        wanted += (curve[last, d] - curve[first, d]) ** 2
    chord = math.sqrt(wanted)
    if not 1 / model.gap_stretch < chord / max(math.sqrt(predicted), 1e-9) < model.gap_stretch:
        return out
    # What is left over at the far end is spread along the piece, so that it meets both ends.
    for d in range(size):
        start, left = piece[0, d], curve[last, d] - curve[first, d] - (piece[count, d] - piece[0, d])
        for p in range(count + 1):
            piece[p, d] += curve[first, d] - start + p / count * left
    # A piece that stays out of sight is predicted from what was put there before: it would grow without this.
    tight, drawn = max(long * scale, chord), arc_length(piece)[count]
    if drawn > tight:
        pull = math.sqrt((tight**2 - chord**2) / (drawn**2 - chord**2))
        for p in range(count + 1):
            for d in range(size):
                line = curve[first, d] + p / count * (curve[last, d] - curve[first, d])
                piece[p, d] = line + pull * (piece[p, d] - line)
    if lifted:
        for p in range(count + 1):
            line = piece[0, size - 1] + p / count * (piece[count, size - 1] - piece[0, size - 1])
            out[first + p, size - 1] = piece[p, size - 1] + level * (line - piece[p, size - 1])
    for p in range(count + 1):
        for d in range(size - 1 if lifted else size):
            out[first + p, d] = piece[p, d]
    return out


@compiled
def _hidden_piece(
    rope: Array, share: Array, was: Any, end: int, hidden: float, seen: Array, stations: Array, length: float,
    lifted: bool, level: float, model: Any,
) -> Array:  # fmt: skip
    """Return a hidden end of the rope from its joint with the visible piece outwards, without the joint.

    It is bent as predicted, but goes straight on if it was folded back onto the rope before: of that, nothing is known.

    Args:
        rope: ``(K, D)`` where the rope is predicted, from tip to tip.
        share: ``(K,)`` where these points lie along it, 0...1.
        was: What was known of the rope.
        end: 0 for its start, 1 for its end.
        hidden: Length of what is hidden.
        seen: ``(P, D)`` the visible piece from the joint inwards.
        stations: ``(P,)`` of these points.
        length: Of the rope.
        lifted: Whether the last coordinate is log-depth.
        level: Share by which its log-depth nears that of the joint: something over it hides its depth.
        model: The constants, one ``ChainModel``.
    """
    size = seen.shape[1]
    if hidden <= _NONE * length:
        return np.empty((0, size))
    count = max(math.ceil(hidden / (length * share[1])) + 1, 2)
    scale = arc_length(seen)[-1] / max(abs(stations[-1] - stations[0]), 1e-9)
    outwards = np.arange(count) / (count - 1)
    if was.folded[end] and was.hidden[end] > 0:
        piece = np.empty((count, size))
        for p in range(count):
            for d in range(size):
                piece[p, d] = outwards[p] * (seen[0, d] - seen[-1, d])
    else:
        at = hidden * (1 - outwards) / length
        piece = interpolate(rope, share, 1 - at if end else at)
        for d in range(size):
            joint = piece[0, d]
            for p in range(count):
                piece[p, d] -= joint
                if d == 2:
                    piece[p, d] *= 1 - level
    longer, out = scale * hidden / max(arc_length(piece)[-1], 1e-9), np.empty((count - 1, size))
    for p in range(count - 1):
        for d in range(size):
            out[p, d] = piece[p + 1, d] * longer + seen[0, d]
    return out


@compiled
def _folded(points: Array, along: Array, length: float) -> Array:
    """Return an end of a length that lies back on a curve, from behind the curve's first point on."""
    if length <= _NONE * along[-1]:
        return np.empty((0, points.shape[1]))
    count = max(np.searchsorted(along, length, side="right"), 2)
    return interpolate(points, along, np.arange(1, count) / (count - 1) * length)


@compiled
def _seen_scale(points: Array, stations: Array, flags: Mask) -> float:
    """Return how long a curve through points is for each unit of its stations, where it is visible."""
    arc, drawn, long = arc_length(points), 0.0, 0.0
    for p in range(len(arc) - 1):
        if not flags[p] and not flags[p + 1]:
            drawn, long = drawn + arc[p + 1] - arc[p], long + stations[p + 1] - stations[p]
    return drawn / max(long, 1e-9)
