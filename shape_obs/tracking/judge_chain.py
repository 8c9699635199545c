"""Judge: how well a rope's curve fits what was seen, and why its points may be wrong all the same."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import local_stretch, with_log_depth
from shape_obs.tracking.state import State

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


# Why a curve is refused: the codes of ``RopeState.refusal``.
_OFF, _NO_ROPE, _LONGER, _MISCONNECTED, _EITHER_END, _UNCLEAR = range(1, 7)  # does not fit, nor show where the rope is
_UNSEEN, _BETWEEN, _DRIFTED, _END_ON, _SHORTER = range(7, 12)  # fits, but its points may be wrong
_OBLIQUE, _POINTING, _STEEP, _UNMEASURED = range(12, 16)  # the same, in space alone
#: The sentence for it, with the two figures of the state and what the rope is seen in, ``"mask"`` or ``"cloud"``.
_SENTENCES: Final = {
    _OFF: "{0:.0%} of the curve lies off the {noun} (at most {1:.0%})",
    _NO_ROPE: (
        "the {noun} spreads {0:.2f} widths about the curve (a ribbon 0.29, at most {1:.2f}): it is no single rope"
    ),
    _LONGER: "the curve is {0:.0%} longer than the rope",
    _MISCONNECTED: "{0:.0%} of the curve connects pieces otherwise than the rope does (at most {1:.0%})",
    _EITHER_END: "it is in doubt which end of the rope is out of sight",
    _UNCLEAR: "it is in doubt where the rope begins",
    _UNSEEN: "{0:.0%} of the rope is in sight (at least {1:.0%})",
    _BETWEEN: "both ends are hidden, and {0:.0%} of the rope is in sight (at least {1:.0%})",
    _DRIFTED: "a piece without an end in sight may have slid by {0:.1%} of the rope's length",
    _END_ON: "it is seen end-on, {0:.2g} times as long as in the image (at most {1})",
    _SHORTER: "the curve is {0:.1%} shorter than the rope, and nothing is seen to hide an end",
    _OBLIQUE: "an end is hidden, and the rope is {0:.2g} times as long as it looks (at most {1})",
    _POINTING: "both ends point at the camera, and {0:.1%} of the rope is missing at one of them",
    _STEEP: "a piece is seen end-on, {0:.2g} times as long as it looks (at most {1})",
    _UNMEASURED: "the depth shows too little of the rope to measure its length",
}

_IDEAL_SCATTER: Final = 12**-0.5  # widths: that of an ideal ribbon


def reason_of(rope: State, noun: str) -> str:
    """Return in words why the points of a rope may be wrong; empty if they are not refused.

    Args:
        rope: ``(1,)``.
        noun: What it is seen in: ``"mask"`` or ``"cloud"``.
    """
    code = int(rope["refusal"][0])
    return _SENTENCES[code].format(*rope["figures"][0].tolist(), noun=noun) if code else ""


def is_unclear(rope: State, either_end: float) -> bool:
    """Return whether it is not clear which way a curve runs along its rope, or which end is out of sight."""
    return bool(rope["unclear"][0]) or float(rope["elsewhere"][0]) > either_end


@compiled
def judge_chain(
    was: Any, now: Any, points: Array, arc: Array, flags: Mask, metres: Array, log_depth: Array, spread: float,
    width: float, ribbon: float, area: float, off: float, spurious: float, begins: bool, needs_metres: bool, model: Any,
) -> None:  # fmt: skip
    """Write the quality of a rope's curve into its state, and the first reason for which its points may be wrong.

    Args:
        was: What was known of the rope.
        now: What is known now; written to.
        points: ``(P, D)`` its whole curve.
        arc: ``(P,)`` its arc length.
        flags: ``(P,)`` what of it is interpolated.
        metres: ``(P,)`` its arc length in space; ``(0,)`` if it is not known, or the points are in space.
        log_depth: ``(P,)``; ``(0,)`` without.
        spread: Mean square distance of what is seen from the curve, see ``sample_spread``.
        width: Of what is seen, if ``area`` is 0.
        ribbon: Width of the rope, pixels; 0 in a cloud.
        area: Of the mask, pixels; 0 for a cloud.
        off: The share of the curve that may be bridged or hidden.
        spurious: The share that cannot be the rope, see ``fit_chain_in_mask``.
        begins: Whether it is numbered from the start again, so that its direction need not be clear.
        needs_metres: Whether its points lie at equal steps in space, and its track began.
        model: The constants, one ``ChainModel``.
    """
    missing = _interpolated_share(arc, flags)
    hidden, seen = min(missing, off), 1 - missing
    now.seen_width = max(area / max(arc[-1] * seen, 1e-9), 1.0) if area > 0 else 0.0
    ratio = math.sqrt(spread) / max(max(area / max(arc[-1] * (1 - hidden), 1e-9), 1.0) if area > 0 else width, 1e-9)
    excess = (ratio - _IDEAL_SCATTER) / (model.max_scatter - _IDEAL_SCATTER)
    now.follow, now.quality = False, 0.0
    if missing - hidden > model.max_off:
        return _refuse(now, _OFF, missing - hidden, model.max_off)
    if ratio > model.max_scatter:
        return _refuse(now, _NO_ROPE, ratio, model.max_scatter)
    now.quality = math.sqrt((1 - (missing - hidden) / model.max_off) * min(max(1 - excess, 0.0), 1.0))
    stretch = max(now.stretch, 1e-9)
    if len(metres) > 0 and now.measured * model.min_stretch > was.measured > 0 and stretch < model.min_stretch:
        return _refuse(now, _LONGER, 1 / stretch - 1, 0.0)
    if spurious > model.max_off:
        return _refuse(now, _MISCONNECTED, spurious, model.max_off)
    if not begins and now.elsewhere > model.either_end:
        return _refuse(now, _EITHER_END, 0.0, 0.0)
    if not begins and now.misplaced > model.max_misplaced:
        return _refuse(now, _MISCONNECTED, now.misplaced, model.max_misplaced)
    if not begins and now.unclear:
        return _refuse(now, _UNCLEAR, 0.0, 0.0)
    now.follow = seen >= model.min_followed
    least = model.min_in_pieces if missing - (now.hidden[0] + now.hidden[1]) > model.long_gap else model.min_seen
    if seen < least:
        return _refuse(now, _UNSEEN, seen, least)
    if seen < model.min_between and now.occluded[0] and now.occluded[1]:
        return _refuse(now, _BETWEEN, seen, model.min_between)
    if now.drift > model.max_drift:
        return _refuse(now, _DRIFTED, now.drift, 0.0)
    if now.steep > model.max_foreshortening:
        now.follow = False
        return _refuse(now, _END_ON, now.steep, model.max_foreshortening)
    if len(metres) == 0:
        lost = needs_metres and was.metres > 0 and area > 0
        return _refuse(now, _UNMEASURED if lost else 0, 0.0, 0.0)
    if stretch > 1 + model.short_tolerances * now.tolerance:
        return _refuse(now, _SHORTER, 1 - 1 / stretch, 0.0)
    one_end, steep, steepest = now.occluded[0] != now.occluded[1], (1.0, 1.0), 1.0
    cut = max(now.occlusion[0], now.occlusion[1]) > 0
    if len(log_depth) > 0 and (one_end or cut):
        stretched = local_stretch(arc, with_log_depth(points, log_depth), ribbon / 2)
        steep, steepest = (stretched[0], stretched[-1]), stretched.max()
    if one_end:
        free = 0 if now.occluded[1] else 1
        most = model.oblique_cut if now.occlusion[free] > now.occlusion[1 - free] else model.most_oblique
        return _refuse(now, _OBLIQUE if steep[free] > most else 0, steep[free], most)
    hides, short = now.occluded[0] != 0, now.hidden[0] + now.hidden[1]
    if not hides and short > model.most_missing and not now.folded[0] and not now.folded[1]:
        return _refuse(now, _POINTING, short, 0.0)
    return _refuse(now, _STEEP if not hides and cut and steepest > model.steepest else 0, steepest, model.steepest)


@compiled
def _refuse(now: Any, reason: int, figure: float, limit: float) -> None:
    """Note why a rope is refused; 0 if it is not."""
    now.refusal, now.figures[0], now.figures[1] = reason, figure, limit
    if 0 < reason <= _UNCLEAR:
        now.innovation = np.inf


@compiled
def _interpolated_share(arc: Array, flags: Mask) -> float:
    """Return the share of a curve's length that is interpolated: half of each step next to such a point."""
    total = 0.0
    for p in range(len(arc) - 1):
        total += (arc[p + 1] - arc[p]) * (int(flags[p]) + int(flags[p + 1])) / 2
    return total / max(arc[-1], 1e-9)
