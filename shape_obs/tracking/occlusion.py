"""Occlusion: find out which piece of a known rope a visible curve is.

A rope has a length, and what is seen of it may be shorter for three reasons: an end is hidden, a gap is bridged too
straight, or the measurement is short, because of noise or, in pixels, of perspective. One decision weighs all of them,
see ``rope_match``; then what is hidden is put back, see ``complete``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.curve import FittedCurve, TrackHints
from shape_obs.tracking.complete import complete_chain
from shape_obs.tracking.occluders import Tips
from shape_obs.tracking.predicted_rope import PredictedRope, oriented
from shape_obs.tracking.prediction import Prediction
from shape_obs.tracking.rope_match import Expected, match_to_rope
from shape_obs.tracking.state import State, new_rope

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_NOTHING: Final = np.zeros(0)
_NO_NODES: Final = np.zeros((0, 2))
_WHOLE: Final = 0.03  # of a length in metres, by which the curve of a whole rope may be too long or too short
_RIVAL: Final = 0.08  # of the length: if so much more may be hidden at the other end, nothing is known of either


def expected_rope(prediction: Prediction | None, width: float, metres: float) -> tuple[State, Expected, Array, Array]:
    """Return what is known of a rope and expected of it, as ``match_to_rope`` takes it.

    Args:
        prediction: None at a cold start.
        width: Of the rope, pixels.
        metres: Its length if that is known at a cold start; else 0.
    """
    if prediction is None:
        return new_rope(metres), (float(width), 1.0, 1.0, 0.0, 0.0), _NO_NODES, _NOTHING
    moment = float(prediction.lapse), float(prediction.stale), float(prediction.motion)
    relief = _NOTHING if prediction.relief is None else prediction.relief
    return prediction.hints.rope, (float(width), float(prediction.resolution), *moment), prediction.nodes, relief


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
    state, stations = form.hints.rope, form.metres
    if not state["aligned"][0]:
        form, back = oriented(form, PredictedRope(prediction, form), tips)
        tips, known = tips.reversed() if back else tips, expected_rope(prediction, form.width, 0.0)
        state, stations = match_to_rope(*_seen(form), *tips, *known, True)
    hints, ambiguity = TrackHints(state), ambiguity_of(state) or form.ambiguity
    if state["plain"][0]:
        metres = None if form.metres is None else stations
        return replace(form, metres=metres, hints=hints, ambiguity=ambiguity)
    relief = _NOTHING if prediction.relief is None else prediction.relief
    before, width = prediction.hints.rope, float(prediction.width)
    points, arc, flags, *measures = complete_chain(*_seen(form), before, state, width, prediction.nodes, relief)
    metres, pixels, deep = (each if len(each) else None for each in measures)
    return FittedCurve(points, flags, arc, False, metres, pixels, deep, form.width, hints=hints, ambiguity=ambiguity)


def _seen(form: FittedCurve) -> tuple[Array, Array, Mask, Array, Array]:
    """Return the arrays of a curve as ``match_to_rope`` takes them."""
    metres, relief = _NOTHING if form.metres is None else form.metres, _NOTHING if form.relief is None else form.relief
    return form.points, form.arc, form.interpolated, metres, relief


def is_whole(form: FittedCurve) -> bool:
    """Return whether a form is as long in space as its rope, and nothing of it is hidden."""
    rope = form.hints.rope
    return form.metres is not None and not rope["hides"][0] and abs(rope["stretch"][0] - 1) <= _WHOLE


def shown(form: FittedCurve) -> slice:
    """Return the piece of a matched curve over which points are spread: without what may be hidden by noise alone.

    Of an end that something hides, two thirds of what may be noise elsewhere.
    """
    rope = form.hints.rope
    if rope is None or not rope["hides"][0]:
        return slice(None)
    share, (head, tail) = form.stations / form.stations[-1], rope["hidden"][0].tolist()
    least = [float(rope["tolerance"][0]) * (2 / 3 if over else 1) for over in rope["occluded"][0]]
    first = np.searchsorted(share, head - 1e-9) if head < least[0] else 0
    last = np.searchsorted(share, 1 - tail + 1e-9) if tail < least[1] else len(share)
    return slice(int(first), int(last))
