"""Match a visible curve to the rope that a track knows: one decision about what of it is hidden.

A rope has a length, and what is seen of it may be shorter for three reasons: an end is hidden, a gap is bridged too
straight, or the measurement is short, because of noise or, in pixels, of perspective.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import Length, local_stretch, with_relief
from shape_obs.geometry.polyline import interpolate
from shape_obs.geometry.topology import from_tip_to_tip
from shape_obs.tracking.occluders import FREE, HIDDEN, TIP_LEARNING, UNKNOWN, blended_tips, likelier_cut
from shape_obs.tracking.placement import (
    PROBES,
    Placed,
    beyond_rest,
    disagreement,
    place,
    settled,
    slid,
)
from shape_obs.tracking.rope_length import learn_length, shorten_length

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Ends = tuple[int, int]

_GRAIN: Final = (0.3, 0.9)  # in resolutions: that of a short one, and what a rope adds that is seen twice as short
_POINTING: Final = 3.0  # times as long in space as in the image: there a tip hides what goes on behind it
_SLACK: Final = (0.01, 1.5)  # of the length and in resolutions: what is missing below this is noise
_BEYOND: Final = 4.0  # standard deviations, beyond which noise explains nothing
_EVENLY: Final = 0.1  # the weight of a piece of a curve at a right angle to the view, in a length that is off
_FADING: Final = 0.8  # how much of the last frame's evidence for cut tips is kept
_CERTAIN: Final = 8.0  # the most that such evidence can weigh
_OWN: Final = 6.0  # a logarithm: a tip that is so much likelier the rope's own than cut shows where the rope ends
_DOUBTFUL: Final = 1.5  # standard deviations by which a rope is too short, and its tips may be cut
_CLEAR: Final = 3.0  # how much nearer ends lie to their own places than to each other's
_BY_NOISE: Final = 1.0  # standard deviations of a length, which may seem hidden
_SLIDES: Final = 0.1  # of a bridged gap: by so much what lies behind it may have slid into it
_CREDIT: Final = 3.0  # frames, for which an end is taken for hidden after something was seen to hide it
_STILL: Final = 0.5  # of what was hidden: an end is only taken for hidden if so much is missing
_LONG_AGO: Final = 25.0  # squared intervals of a track, after which a rope may have slid anywhere
_BENT: Final = 0.25  # of the squared distance by which a rope has slid: how far off the form of a piece is then
ADRIFT: Final = 0.02  # of its length: by so much a rope may have slid along itself unseen
LEAST: Final = 0.002  # of a length in pixels: less cannot be seen to be missing


class RopeBelief(NamedTuple):
    """What a track believes of a rope, for compiled code; see ``TrackHints`` and ``Prediction``.

    Args:
        head: Share of its length that was hidden at its start.
        tail: The same at its end.
        bent: Mean square distance of curves from their predictions, after the best rigid motion.
        apart: The same as they are.
        cut_head: How much likelier, as a logarithm, its start was cut than its own.
        cut_tail: The same of its end.
        adrift: By which share of its length it may have slid along itself.
        width: In pixels.
        resolution: Of the observation.
        lapse: Intervals since it was seen.
        stale: 1 if it was lost for long, else 0.
        credit_head: For how many frames its start is taken for hidden though nothing is seen to hide it.
        credit_tail: The same of its end.
        motion: How far it is expected to have moved, RMS.
    """

    head: float
    tail: float
    bent: float
    apart: float
    cut_head: float
    cut_tail: float
    adrift: float
    width: float
    resolution: float
    lapse: float
    stale: float
    credit_head: float
    credit_tail: float
    motion: float


class Match(NamedTuple):
    """Which piece of a known rope a visible curve is, and what follows of it.

    Args:
        clear: Whether the curve clearly runs in the direction of the rope, or is known to; else nothing is decided.
        first: What is known about its first point, see ``tip_evidence``.
        last: The same of its last point.
        gap_start: The last point before the widest bridged piece.
        gap_stop: The first point after it; the same without one.
        head: Length of what is hidden at its start, in the unit of the curve's stations.
        tail: The same at its end.
        between: By how much the gap is longer than it is bridged.
        length: Of the rope, in that unit.
        slack: Below this length what is missing is noise.
        bent: See ``RopeBelief``, as are the next four, after this frame.
        apart: Mean square distance.
        cut_head: Logarithm.
        cut_tail: Logarithm.
        adrift: Share.
        rival: By which share of the length more may be hidden elsewhere, see ``Placed``.
        stretch: By how much more of the rope there is than was measured where it is visible.
        measured: Length of what is visible.
        credit_head: Frames, see ``RopeBelief``.
        credit_tail: The same of its end.
    """

    clear: bool
    first: int
    last: int
    gap_start: int
    gap_stop: int
    head: float
    tail: float
    between: float
    length: float
    slack: float
    bent: float
    apart: float
    cut_head: float
    cut_tail: float
    adrift: float
    rival: float
    stretch: float
    measured: float
    credit_head: float
    credit_tail: float


#: The match; ``(P,)`` stations in metres if all of the rope is seen; what is then known of its length and its tips.
Found = tuple[Match, Array, Length, Array]


@compiled(
    "(f8[:,::1], f8[::1], b1[::1], f8[::1], f8[::1], UniTuple(i8, 2), f8[:,::1], RopeBelief, Length, f8[:,::1], "
    "f8[::1], f8[:,:,::1], b1)"
)
def match_to_rope(
    points: Array, arc: Array, flags: Mask, metres: Array, relief: Array, ends: Ends, shapes: Array,
    belief: RopeBelief, known: Length, nodes: Array, node_relief: Array, own: Array, oriented: bool,
) -> Found:  # fmt: skip
    """Find out which piece of a known rope a curve is.

    Args:
        points: ``(P, D)``.
        arc: ``(P,)`` their arc length.
        flags: ``(P,)`` what is bridged.
        metres: ``(P,)`` arc length in space; ``(0,)`` if it is not known, or the points are in space.
        relief: ``(P,)`` see ``FittedCurve.relief``; ``(0,)`` without.
        ends: What is known about both tips, see ``tip_evidence``.
        shapes: ``(2, 2)`` what they look like, see ``tip_shape``.
        belief: What the track believes of the rope.
        known: What it knows of its length.
        nodes: ``(K, D)`` where it is predicted.
        node_relief: ``(K,)`` their relief; ``(0,)`` without.
        own: ``(2, 2, 2)`` what its own tips look like, see ``Tips.remembered``; ``(0, 2, 2)`` if it is not known.
        oriented: Whether the curve is known to run in the direction of the rope.

    Returns:
        The match; ``(P,)`` stations of the curve in metres if all of the rope is seen and that is known; what is then
        known of its length; and of its tips.
    """
    last, metric, in_space = len(arc) - 1, len(metres) > 0, points.shape[1] == 3
    lifted = with_relief(points, relief) if len(relief) > 0 else points
    with_depth = len(relief) > 0 and len(node_relief) > 0
    rope, share = from_tip_to_tip(with_relief(nodes, node_relief) if with_depth else nodes)
    found, along = lifted if with_depth else points, metres if metric else arc
    length, steep, steepest = known.metres if metric else known.pixels, np.ones(2), 1.0
    clear = oriented or _is_along(found, rope)
    if not clear or length <= 0:
        unknown = Match(
            clear, ends[0], ends[1], 0, 0, 0.0, 0.0, 0.0, length, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, along[last],
            0.0, 0.0,
        )  # fmt: skip
        return unknown, along, known, own
    if len(relief) > 0:
        stretched = local_stretch(arc, lifted, belief.width / 2)
        steep[0], steep[1] = stretched[0], stretched[last]
        for p in range(last + 1):
            steepest = max(steepest, stretched[p])
    short = (1 - along[last] / length) / _STILL
    first, credit_head = _still_hidden(ends[0], _SLACK[0] < belief.head < short, belief.credit_head)
    second, credit_tail = _still_hidden(ends[1], _SLACK[0] < belief.tail < short, belief.credit_tail)
    ends = first, second
    if HIDDEN in ends:  # that explains what is missing
        first, second = first if first != UNKNOWN else FREE, second if second != UNKNOWN else FREE
    # What points at the camera lies in front of what goes on behind it.
    first = UNKNOWN if first == FREE and steep[0] > _POINTING else first
    second = UNKNOWN if second == FREE and steep[1] > _POINTING else second
    ends = first, second
    likelier = likelier_cut(shapes, own, belief.width) if len(own) > 0 else (0.0, 0.0)
    cut_head = min(max(_FADING * belief.cut_head + likelier[0], -_CERTAIN), _CERTAIN)
    cut_tail = min(max(_FADING * belief.cut_tail + likelier[1], -_CERTAIN), _CERTAIN)
    gap = _widest_gap(arc, flags)
    resolution = belief.resolution * along[last] / max(arc[last], 1e-9)
    slack, missing, least = _SLACK[0] * length + _SLACK[1] * resolution, length - along[last], LEAST * length
    grain, spread = _GRAIN[0] + _GRAIN[1] * (steepest - 1), known.spread_metres if metric or in_space else known.spread
    noise = spread * length + grain * resolution
    placed, residuals, adrift, rival = Placed(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (belief.bent, belief.apart), 0.0, 0.0
    if missing > 0 and (gap[1] > gap[0] or missing > least or HIDDEN in ends):
        usual, cut = residuals, (cut_head, cut_tail)
        if belief.adrift > ADRIFT and min(cut) <= -_OWN and max(cut) > 0:  # the prediction may be of other pieces
            away = (belief.adrift * length) ** 2
            usual = max(residuals[0], _BENT * away), max(residuals[1], away)
        placed = place(
            rope, share, found, along, ends, cut, (belief.head, belief.tail), usual, missing,
            noise, belief.resolution, belief.lapse**2, gap,
        )  # fmt: skip
        beyond = _BY_NOISE * noise / length
        hidden = max(placed.head / length - beyond, 0.0), max(placed.tail / length - beyond, 0.0)
        long_ago = belief.stale > 0 or belief.lapse**2 > _LONG_AGO
        bridge = along[gap[1]] - along[gap[0]]
        strayed = beyond_rest(placed.apart, belief.motion, belief.resolution)
        shown = (
            FREE if first == UNKNOWN and hidden[0] <= 0 and cut_head <= -_OWN else first,
            FREE if second == UNKNOWN and hidden[1] <= 0 and cut_tail <= -_OWN else second,
        )
        adrift = slid(belief.adrift, rope, shown, hidden, _SLIDES * bridge / length, strayed, long_ago)
        rival = 0.0 if bridge > 0 or belief.adrift > 0 or belief.lapse**2 > _LONG_AGO else placed.rival
        bent, apart = placed.bent, placed.apart
    else:
        probes = interpolate(found, along, PROBES * along[last])
        bent, apart = disagreement(rope, share, probes, 0.0, 0.0)
    residuals = settled(residuals, bent, apart)
    hidden_length = placed.head + placed.tail
    unbroken, size = gap[1] == gap[0] and not flags.any(), metres[last] if metric else 0.0
    if hidden_length <= least and not (missing > _DOUBTFUL * noise and max(cut_head, cut_tail) > 0):
        if len(own) > 0:
            own = blended_tips(shapes, own, max(TIP_LEARNING, 1 / (known.frames + 1)))
        known = learn_length(known, arc[last], size, HIDDEN not in ends, unbroken)
    else:
        # A gap may be bridged too straight: then the rope is not shorter than it was.
        free = first == FREE and second == FREE and unbroken and missing > _BEYOND * noise
        known = shorten_length(known, arc[last], size, free)
    stations = evened(metres, arc, length) if metric and hidden_length <= 0 else along
    stretch = (length - hidden_length) / max(along[last] + placed.between * (gap[1] > gap[0]), 1e-9)
    match = Match(
        True, first, second, gap[0], gap[1], placed.head, placed.tail, placed.between, length, slack, residuals[0],
        residuals[1], cut_head, cut_tail, adrift, rival, stretch, along[last], credit_head, credit_tail,
    )  # fmt: skip
    return match, stations, known, own


@compiled
def _still_hidden(known: int, may_be: bool, credit: float) -> tuple[int, float]:
    """Return what is known about a tip, and for how many frames it is taken for hidden: noise may hide the evidence."""
    if known == HIDDEN:
        return HIDDEN, _CREDIT
    if known == FREE and may_be and credit > 0:
        return HIDDEN, credit - 1
    return known, 0.0


@compiled
def _is_along(points: Array, rope: Array) -> bool:
    """Return whether a curve clearly runs in the direction of a rope, by the distances of its ends."""
    count, size, forwards, backwards = len(rope), points.shape[1], 0.0, 0.0
    for end in range(2):
        same = other = 0.0
        for d in range(size):
            at = points[-1 if end else 0, d]
            same += (at - rope[count - 2 if end else 1, d]) ** 2
            other += (at - rope[1 if end else count - 2, d]) ** 2
        forwards, backwards = forwards + math.sqrt(same), backwards + math.sqrt(other)
    return _CLEAR * forwards < backwards


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
