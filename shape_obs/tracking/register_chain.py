"""Match a visible curve to the rope that a track knows: one decision about what of it is hidden.

A rope has a length, and what is seen of it may be shorter for three reasons: an end is hidden, a gap is bridged too
straight, or the measurement is short, because of noise or, in pixels, of perspective.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import local_stretch, with_log_depth
from shape_obs.geometry.polyline import arc_length, interpolate, nearest_piece
from shape_obs.geometry.topology import from_tip_to_tip
from shape_obs.tracking.model import gain_of
from shape_obs.tracking.occluders import (
    FREE,
    HIDDEN,
    UNKNOWN,
    learn_tips,
    likelier_cut,
    remember_tips,
)
from shape_obs.tracking.placement import (
    PROBES,
    Placed,
    beyond_rest,
    disagreement,
    limited,
    place,
    settled,
    slid,
)
from shape_obs.tracking.rope_length import learn_length, shorten_length
from shape_obs.tracking.state import State

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Ends = tuple[int, int]
#: Of a rope: its width in pixels, the resolution of the observation, 1 if it was lost for long, how far its nodes are
#: expected to have moved, RMS, the seconds since it was seen, for how many of them this frame counts, and how far the
#: nodes can have moved since then.
Expected = tuple[float, float, float, float, float, float, float]

_PLACES: Final = 7  # along the rope, at which a piece is compared with it to find its direction


@compiled
def register_chain(
    points: Array, arc: Array, flags: Mask, metres: Array, log_depth: Array, ends: Ends, shapes: Array, known: State,
    expected: Expected, nodes: Array, node_log_depth: Array, before: Array, model: Any,
) -> tuple[State, Array, Array, Mask, Array, Array]:  # fmt: skip
    """Find out which piece of a known rope a curve is, and which way it runs along the rope.

    Args:
        points: ``(P, D)``.
        arc: ``(P,)`` their arc length.
        flags: ``(P,)`` what is bridged.
        metres: ``(P,)`` arc length in space; ``(0,)`` if it is not known, or the points are in space.
        log_depth: ``(P,)`` see ``FittedCurve``; ``(0,)`` without.
        ends: What is known about both tips, see ``tip_evidence``.
        shapes: ``(2, 2)`` what they look like, see ``tip_shape``; ``(0, 2)`` if that is not known.
        known: ``(1,)`` what is known of the rope.
        expected: See ``Expected``.
        nodes: ``(K, D)`` where it is predicted; ``(0, D)`` at a cold start.
        node_log_depth: ``(K,)`` their log-depth; ``(0,)`` without.
        before: ``(K, D)`` where the nodes were.
        model: The constants, one ``ChainModel``.

    Returns:
        ``(1,)`` what is known of the rope after this frame; the curve in the direction of the rope: points, arc length,
        flags, metres (even where all of the rope is seen) and log-depth.
    """
    after, metric, unclear, found, predicted = known.copy(), len(metres) > 0, False, points, nodes
    if len(log_depth) > 0 and len(node_log_depth) > 0:
        found, predicted = with_log_depth(points, log_depth), with_log_depth(nodes, node_log_depth)
    if len(nodes) > 0:
        stations = metres if metric else arc
        back, unclear = _runs_back(points, stations, metric, ends, found, predicted, known[0], expected, before, model)
        if back:
            found = _backwards(found)
            points, flags, ends, shapes = _backwards(points), flags[::-1].copy(), (ends[1], ends[0]), _backwards(shapes)
            arc, metres, log_depth = _from_the_end(arc), _from_the_end(metres), log_depth[::-1].copy()
    stations = _match(
        points, arc, flags, metres, log_depth, ends, shapes, known[0], after[0], expected, found, predicted, model
    )
    after[0].unclear = unclear
    return after, points, arc, flags, stations if after[0].plain and metric else metres, log_depth


@compiled
def _match(
    points: Array, arc: Array, flags: Mask, metres: Array, log_depth: Array, ends: Ends, shapes: Array, was: Any,
    now: Any, expected: Expected, found: Array, predicted: Array, model: Any,
) -> Array:  # fmt: skip
    """Find out which piece of a known rope a curve in its direction is.

    What was known of the rope is in ``was``; what is known after this frame is written into ``now``. The curve and the
    predicted nodes are compared in the image, or with their log-depth. See ``register_chain`` for the others.

    Returns:
        ``(P,)`` stations of the curve, in metres if these are known; evened if all of the rope is seen.
    """
    last, metric, in_space = len(arc) - 1, len(metres) > 0, points.shape[1] == 3
    along, size = metres if metric else arc, metres[-1] if metric else 0.0
    width, resolution, was_lost, motion, seconds, lasted, _ = expected
    now.elsewhere, now.misplaced, now.plain = 0.0, 0.0, False
    gap = _widest_gap(arc, flags)
    unbroken, length = not flags.any(), was.metres if metric else was.pixels
    if len(predicted) == 0 or length <= 0:
        _begin(now, shapes, width, resolution, model)
        learn_length(now, arc[last], size, HIDDEN not in ends, unbroken, lasted, model)
        return along
    rope, share = from_tip_to_tip(predicted)
    steep, steepest = np.ones(2), 1.0
    if len(log_depth) > 0:
        stretched = local_stretch(arc, with_log_depth(points, log_depth), width / 2)
        steep[0], steep[1] = stretched[0], stretched[last]
        for p in range(last + 1):
            steepest = max(steepest, stretched[p])
    short = (1 - along[last] / length) / model.still_missing
    first, now.hold[0] = _still_hidden(ends[0], was.hidden[0], short, was.hold[0] - seconds, model)
    second, now.hold[1] = _still_hidden(ends[1], was.hidden[1], short, was.hold[1] - seconds, model)
    ends = first, second
    if HIDDEN in ends:  # that explains what is missing
        first, second = first if first != UNKNOWN else FREE, second if second != UNKNOWN else FREE
    # What points at the camera lies in front of what goes on behind it.
    first = UNKNOWN if first == FREE and steep[0] > model.pointing else first
    second = UNKNOWN if second == FREE and steep[1] > model.pointing else second
    ends = first, second
    familiar = was.tips_known and len(shapes) > 0
    likelier = likelier_cut(shapes, was.tips, width, model) if familiar else (0.0, 0.0)
    kept, counts = math.exp(-seconds / model.evidence_memory), min(seconds / model.independent_after, 1.0)
    cut_head = min(max(kept * was.occlusion[0] + counts * likelier[0], -model.certain), model.certain)
    cut_tail = min(max(kept * was.occlusion[1] + counts * likelier[1], -model.certain), model.certain)
    step = resolution * along[last] / max(arc[last], 1e-9)  # in the unit of the stations
    tolerance, missing = model.length_tolerance[0] * length + model.length_tolerance[1] * step, length - along[last]
    least = model.least_missing * length
    spread = was.metres_spread if metric or in_space else was.pixels_spread
    noise = spread * length + (model.length_noise[0] + model.length_noise[1] * (steepest - 1)) * step
    placed, usual = Placed(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), usual_distance(was, seconds, resolution, model)
    now.drift = 0.0
    if missing > 0 and (gap[1] > gap[0] or missing > least or HIDDEN in ends):
        cut, loosened = (cut_head, cut_tail), usual
        # The prediction may be of other pieces.
        if was.drift > model.max_drift and min(cut) <= -model.sure and max(cut) > 0:
            away = (was.drift * arc_length(rope)[-1]) ** 2
            loosened = usual[0], max(usual[1], away)
        placed = place(
            rope, share, found, along, ends, cut, (was.hidden[0], was.hidden[1]), loosened, missing, noise,
            seconds, gap, model,
        )  # fmt: skip
        beyond = model.by_noise * noise / length
        hidden = max(placed.head / length - beyond, 0.0), max(placed.tail / length - beyond, 0.0)
        lost = was_lost > 0 or seconds > model.lost_after
        bridge = along[gap[1]] - along[gap[0]]
        strayed = beyond_rest(placed.apart, motion, model.motion_floor * resolution)
        shown = (
            FREE if first == UNKNOWN and hidden[0] <= 0 and cut_head <= -model.sure else first,
            FREE if second == UNKNOWN and hidden[1] <= 0 and cut_tail <= -model.sure else second,
        )
        now.drift = slid(was.drift, rope, shown, hidden, model.gap_drift * bridge / length, strayed, lost)
        now.elsewhere = 0.0 if bridge > 0 or was.drift > 0 or seconds > model.lost_after else placed.elsewhere
        bent, apart = placed.bent, placed.apart
    else:
        bent, apart = disagreement(rope, share, interpolate(found, along, PROBES * along[last]), 0.0, 0.0)
    alone = (model.perfect * resolution) ** 2  # of noise
    now.shape_speed = settled(was.shape_speed, bent, alone, seconds, lasted, model)
    now.pose_speed = settled(was.pose_speed, apart, alone, seconds, lasted, model)
    hidden_length = placed.head + placed.tail
    if hidden_length <= least and not (missing > model.seems_short * noise and max(cut_head, cut_tail) > 0):
        if familiar:
            learn_tips(now.tips, shapes, max(gain_of(lasted, model.memory), 1 / (was.frames + 1)))
        learn_length(now, arc[last], size, HIDDEN not in ends, unbroken, lasted, model)
    else:
        # A gap may be bridged too straight: then the rope is not shorter than it was.
        free = first == FREE and second == FREE and unbroken and missing > model.beyond_noise * noise
        shorten_length(now, arc[last], size, free, lasted, model)
    now.hidden[0], now.hidden[1], now.hides = placed.head / length, placed.tail / length, hidden_length > 0
    now.plain = gap[1] == gap[0] and not now.hides
    near = max(width, 2 * resolution)
    if not now.plain and apart > near**2:  # all of it in one piece is the rope, wherever it was predicted
        probes, hidden = interpolate(found, along, PROBES * along[last]), (placed.head / length, placed.tail / length)
        now.misplaced = _misplaced_share(rope, share, probes, hidden, along[last] / length, near, model)
    for end in range(2):
        now.occluded[end], now.folded[end] = ends[end] == HIDDEN, ends[end] == FREE
    now.occlusion[0], now.occlusion[1] = cut_head, cut_tail
    now.gap[0], now.gap[1], now.between, now.tolerance = gap[0], gap[1], placed.between, tolerance / length
    now.stretch = (length - hidden_length) / max(along[last] + placed.between * (gap[1] > gap[0]), 1e-9)
    changed = abs(now.hidden[0] - was.hidden[0]) + abs(now.hidden[1] - was.hidden[1])
    now.innovation = max(changed, (2 if metric else 1) * abs(now.stretch - 1))
    now.measured = was.measured if hidden_length > least else along[last]
    return evened(metres, arc, length, model) if metric and hidden_length <= 0 else along


@compiled
def usual_distance(rope: Any, seconds: float, resolution: float, model: Any) -> tuple[float, float]:
    """Return the mean square distance at which a rope is usually found from where it is predicted.

    Args:
        rope: What is known of it.
        seconds: Since it was seen.
        resolution: Of the observation.
        model: The constants, one ``ChainModel``.

    Returns:
        After the best rigid motion; as it is.
    """
    noise = (model.perfect * resolution) ** 2
    return noise + rope.shape_speed * seconds**2, noise + rope.pose_speed * seconds**2


@compiled
def _begin(rope: Any, shapes: Array, width: float, resolution: float, model: Any) -> None:
    """Forget all but the length of a rope, and remember the tips as they look now."""
    rope.drift = rope.tolerance = rope.measured = rope.elsewhere = rope.between = rope.innovation = 0.0
    rope.shape_speed = rope.pose_speed = (model.first_speed * resolution) ** 2
    rope.stretch = 1.0
    rope.tips_known, rope.hides, rope.plain = len(shapes) > 0, False, True
    for end in range(2):
        rope.hidden[end] = rope.occlusion[end] = rope.hold[end] = 0.0
        rope.occluded[end] = rope.folded[end] = rope.gap[end] = 0
    if rope.tips_known:
        remember_tips(rope.tips, shapes, width, model)


@compiled
def _still_hidden(known: int, hidden: float, short: float, left: float, model: Any) -> tuple[int, float]:
    """Return what is known about a tip, and for how many seconds it is hidden: noise may hide the evidence.

    Args:
        known: What this frame shows.
        hidden: Share of the length that was hidden there before.
        short: The largest such share for which enough is missing now.
        left: Seconds for which it is still taken for hidden.
        model: The constants, one ``ChainModel``.
    """
    if known == HIDDEN:
        return HIDDEN, model.hold
    if known == FREE and model.length_tolerance[0] < hidden < short and left > 0:
        return HIDDEN, left
    return known, 0.0


@compiled
def _runs_back(
    points: Array, stations: Array, metric: bool, ends: Ends, found: Array, nodes: Array, was: Any,
    expected: Expected, before: Array, model: Any,
) -> tuple[bool, bool]:  # fmt: skip
    """Return whether a curve runs against the direction of its rope, and whether that is not clear.

    It may be a piece of the rope, and what hides an end, such as the border, hides it still.

    Args:
        points: ``(P, D)``.
        stations: ``(P,)`` how far along it they lie.
        metric: Whether that is in metres.
        ends: What is known about its tips.
        found: ``(P, D')`` the curve as it is compared with the rope.
        nodes: ``(K, D')`` where the rope is predicted.
        was: What was known of the rope.
        expected: See ``Expected``.
        before: ``(K, D)`` where its nodes were.
        model: The constants, one ``ChainModel``.
    """
    own, other = _ways(found, nodes)
    if model.clear * own < other or model.clear * other < own:
        return other < own, False
    _, resolution, _, _, seconds, _, reach = expected
    way = direction(points, before, reach)
    if way != 0:
        return way < 0, False
    rope, share = from_tip_to_tip(nodes)
    length, usual = was.metres if metric else was.pixels, usual_distance(was, seconds, resolution, model)
    seen = min(stations[-1] / length, 1.0) if length > 0 else 1.0
    folded = was.hidden[0] * was.folded[0], was.hidden[1] * was.folded[1]
    probes = interpolate(found, stations, PROBES * stations[-1])
    off = _unlikely(rope, share, probes, seen, folded, usual, model)
    off_back = _unlikely(rope, share, _backwards(probes), seen, folded, usual, model)
    uncovered = -math.log(math.tanh(max(model.uncovering * seconds, 1e-9)))  # a chain of two states
    for end in range(2):
        off += uncovered * ((was.occluded[end] != 0) != (ends[end] == HIDDEN))
        off_back += uncovered * ((was.occluded[end] != 0) != (ends[1 - end] == HIDDEN))
    return off_back < off, abs(off - off_back) < model.sure_direction


@compiled
def _backwards(points: Array) -> Array:
    """Return ``(P, D)`` points in the other order."""
    out = np.empty_like(points)
    for p in range(len(points)):
        for d in range(points.shape[1]):
            out[p, d] = points[len(points) - 1 - p, d]
    return out


@compiled
def _from_the_end(along: Array) -> Array:
    """Return how far points lie along a curve that is run through backwards; ``(0,)`` stays so."""
    out, last = np.empty_like(along), len(along) - 1
    for p in range(len(along)):
        out[p] = along[last] - along[last - p]
    return out


@compiled("(f8[:,::1], f8[:,::1], f8)")
def direction(points: Array, before: Array, reach: float) -> int:
    """Return whether the ends of a curve must have come from their own places (1), or each other's (-1); else 0.

    Args:
        points: ``(P, D)``.
        before: ``(K, D)`` nodes where it was.
        reach: How far they can have moved; infinity without a limit.
    """
    if not math.isfinite(reach):
        return 0
    own, other = _ways(points, before)
    return int(own / 2 <= reach < other / 2) - int(other / 2 <= reach < own / 2)


@compiled
def _ways(points: Array, nodes: Array) -> tuple[float, float]:
    """Return how far both ends of a curve are together from those of ``(K, D)`` nodes, and from each other's."""
    own = other = 0.0
    for end in range(2):
        same = crossed = 0.0
        for d in range(points.shape[1]):
            at = points[-1 if end else 0, d]
            same += (at - nodes[-1 if end else 0, d]) ** 2
            crossed += (at - nodes[0 if end else -1, d]) ** 2
        own, other = own + math.sqrt(same), other + math.sqrt(crossed)
    return own, other


@compiled
def _unlikely(
    points: Array,
    share: Array,
    found: Array,
    size: float,
    folded: tuple[float, float],
    usual: tuple[float, float],
    model: Any,
) -> float:
    """Return how unlikely a curve is a piece of a rope, the likeliest of seven, in nats.

    Args:
        points: ``(K, D)`` of the rope.
        share: ``(K,)`` where they lie along it, 0...1.
        found: ``(32, D)`` at equal steps along the curve.
        size: Share of the rope that the curve is long.
        folded: Shares at both ends of the rope that were folded back: with them nothing can be compared.
        usual: Mean square distances of curves from their predictions: after a shift, and as they are.
        model: The constants, one ``ChainModel``.
    """
    probes, least = len(found), np.inf
    at = np.empty(probes)
    for at_place in range(_PLACES):
        known, square, apart = 0, 0.0, 0.0
        for n in range(probes):
            at[n] = at_place / (_PLACES - 1) * (1 - size) + size * PROBES[n]
        expected, shift = interpolate(points, share, at), np.zeros(points.shape[1])
        for n in range(probes):
            if folded[0] <= at[n] <= 1 - folded[1]:
                known += 1
                for d in range(len(shift)):
                    shift[d] += expected[n, d] - found[n, d]
                    square += (expected[n, d] - found[n, d]) ** 2
        cost = model.unseen * (1 - known / probes)
        if known > 0:
            for d in range(len(shift)):
                apart += (shift[d] / known) ** 2
            bent = max(square / known - apart, 0.0)
            cost += limited(model.independent[0] * bent / usual[0], model.trust)
            cost += limited(model.independent[1] * apart / usual[1], model.trust)
        least = min(least, cost)
    return least


@compiled
def _misplaced_share(
    rope: Array, share: Array, probes: Array, hidden: tuple[float, float], seen: float, near: float, model: Any
) -> float:
    """Return the share of a curve that lies where a far part of the rope was expected: it is connected otherwise.

    More of the rope than is known may come to light at one of its ends.

    Args:
        rope: ``(K, D)`` where it is predicted, from tip to tip.
        share: ``(K,)`` where these points lie along it, 0...1.
        probes: ``(32, D)`` at equal steps along the curve.
        hidden: Shares of the rope at its ends.
        seen: Length of the curve over that of the rope.
        near: How far from the rope what lies on it may be.
        model: The constants, one ``ChainModel``.
    """
    from_start = from_end = 0
    for n in range(len(probes)):
        square, piece, part = nearest_piece(rope, probes[n], 0, len(rope) - 1)
        if square <= near**2:
            at = share[piece] + part * (share[piece + 1] - share[piece])
            from_start += abs(at - hidden[0] - seen * PROBES[n]) > model.far_along
            from_end += abs(1 - at - hidden[1] - seen * (1 - PROBES[n])) > model.far_along
    return min(from_start, from_end) / len(probes)


@compiled
def _widest_gap(arc: Array, flags: Mask) -> tuple[int, int]:
    """Return the last point before and the first after the widest bridged piece; the same point without one."""
    start, stop, before, widest = 0, 0, -1, 0.0
    for p in range(len(flags)):
        if flags[p]:
            continue
        if before >= 0 and arc[p] - arc[before] > widest:
            start, stop, widest = before, p, arc[p] - arc[before]
        before = p
    return (start, stop) if stop > start + 1 else (0, 0)


@compiled
def evened(stations: Array, arc: Array, length: float, model: Any) -> Array:
    """Return stations in metres that span a length: what was measured too short or too long is so where it is steep.

    Where a rope runs towards the camera, a pixel holds much of it.
    """
    count, whole = len(stations) - 1, 0.0
    step, weight, out = np.empty(count), np.empty(count), np.zeros(count + 1)
    for p in range(count):
        step[p] = stations[p + 1] - stations[p]
        weight[p] = step[p] / max(arc[p + 1] - arc[p], 1e-9)
    usual = np.median(weight)
    for p in range(count):
        weight[p] = step[p] * (model.evenly + max((weight[p] / usual) ** 2 - 1, 0.0))
        whole += weight[p]
    share = (length - stations[-1]) / max(whole, 1e-12)
    for p in range(count):
        out[p + 1] = out[p] + max(step[p] + share * weight[p], 0.1 * step[p])
    return out
