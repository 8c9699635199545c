"""The length of a rope: what is known of it, and how little a frame may change that."""

from __future__ import annotations

from typing import Final

import numpy as np

from shape_obs.geometry.curve import FittedCurve, Length
from shape_obs.tracking.occluders import HIDDEN

Ends = tuple[int, int]

# Of the length: the standard deviation of a measurement. In pixels it is learnt, and this is the least.
_SPREAD: Final = {"px": 0.001, "m": 0.012}
_WIDEST: Final = 0.2
_BEYOND: Final = 4.0  # standard deviations, beyond which noise explains nothing
# By which share of a difference a length follows a measurement, and of itself if noise cannot explain the difference.
_LEARNING: Final = (0.05, 0.001)
_FORGETTING: Final = 0.05
_CHANGED: Final = 30  # frames in a row in which a rope with free tips is shorter than it was: it has changed


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
    if known.frames == 0 and (form.whole or not known.pixels):  # a gap may be bridged by too long a way
        return known._replace(pixels=max(form.size, known.pixels), metres=max(metres, known.metres), frames=int(whole))
    if not whole:
        return known
    change = form.size / known.pixels - 1
    # What looks shorter may be hidden in part; only what comes back to its length has been seen at an angle.
    spread = _varied(known.spread, max(change, -1.5 * known.spread), _SPREAD["px"])
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
