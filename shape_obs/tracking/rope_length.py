"""The length of a rope: what is known of it, and how little a frame may change that."""

from __future__ import annotations

import math
from typing import Final

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import FittedCurve, Length
from shape_obs.tracking.occluders import HIDDEN

Ends = tuple[int, int]

# Of the length: the standard deviation of a measurement in pixels, which is learnt, at least, and in metres, at most.
_SPREAD: Final = (0.001, 0.012)
_WIDEST: Final = 0.2
_BEYOND: Final = 4.0  # standard deviations, beyond which noise explains nothing
# By which share of a difference a length follows a measurement, and of itself if noise cannot explain the difference.
_LEARNING: Final = (0.05, 0.001)
_SHORTER: Final = (1.5, 2.0)  # standard deviations in pixels and in metres, by which a length is learnt to be shorter
_FORGETTING: Final = 0.05
_CHANGED: Final = 30  # frames in a row in which a rope with free tips is shorter than it was: it has changed


def learnt(known: Length, form: FittedCurve, ends: Ends) -> Length:
    """Return what is known of a rope's length after a frame in which nothing of it is hidden.

    Args:
        known: What was known before.
        form: What was seen.
        ends: What is known about its tips.
    """
    metres = 0.0 if form.metres is None else float(form.metres[-1])
    return learn_length(known, form.size, metres, HIDDEN not in ends, form.whole)


def shortened(known: Length, form: FittedCurve, free: bool) -> Length:
    """Return what is known of a rope's length after a frame in which less of it was seen.

    Args:
        known: What was known before.
        form: What was seen.
        free: Whether both of its tips are free, and nothing is nearer than they are.
    """
    metres = 0.0 if form.metres is None else float(form.metres[-1])
    return shorten_length(known, form.size, metres, free)


@compiled("(Length, f8, f8, b1, b1)")
def learn_length(known: Length, size: float, metres: float, in_sight: bool, unbroken: bool) -> Length:
    """Return what is known of a rope's length after a frame in which nothing of it is hidden.

    A length follows what is measured as far as noise explains the difference, and hardly beyond that: never because
    less is seen.

    Args:
        known: What was known before.
        size: What was seen, pixels.
        metres: The same in metres, 0 if it is not known.
        in_sight: Whether nothing is seen to hide an end.
        unbroken: Whether no piece is bridged.
    """
    whole = in_sight and unbroken
    if known.frames == 0 and (unbroken or known.pixels == 0):  # a gap may be bridged by too long a way
        return Length(
            max(size, known.pixels),
            max(metres, known.metres),
            known.spread,
            known.spread_metres,
            1.0 if whole else 0.0,
            0.0,
        )
    if not whole:
        return known
    change = size / known.pixels - 1
    # What looks shorter may be hidden in part: only what comes back to its length was seen at an angle, or in noise.
    spread = _varied(known.spread, max(change, -_SHORTER[0] * known.spread), _SPREAD[0])
    follow = min(max((spread / 0.04) ** 2, _LEARNING[0]), 1.0)
    pixels, frames = known.pixels * (1 + follow * change), known.frames + 1
    if metres == 0 or known.metres == 0:
        return Length(pixels, metres if metres > 0 else known.metres, spread, known.spread_metres, frames, 0.0)
    off = max(metres / known.metres - 1, -_SHORTER[1] * known.spread_metres)
    gain = max(_LEARNING[0], 1 / frames) if abs(off) < _BEYOND * _SPREAD[1] else 0.0
    step = gain * off if gain > 0 else min(max(off, -_LEARNING[1]), _LEARNING[1])
    varied = min(_varied(known.spread_metres, off, _SPREAD[0]), _SPREAD[1])
    return Length(pixels, known.metres * (1 + step), spread, varied, frames, 0.0)


@compiled("(Length, f8, f8, b1)")
def shorten_length(known: Length, size: float, metres: float, free: bool) -> Length:
    """Return what is known of a rope's length after a frame in which less of it was seen.

    If both of its tips are free, and nothing is nearer than they are, for long enough, then the rope has changed.

    Args:
        known: What was known before.
        size: What was seen, pixels.
        metres: The same in metres, 0 if it is not known.
        free: Whether both of its tips are free.
    """
    if free and known.short >= _CHANGED:
        return Length(size, metres, known.spread, known.spread_metres, 1.0, 0.0)
    short = known.short + 1 if free else 0.0
    return Length(known.pixels, known.metres, known.spread, known.spread_metres, known.frames, short)


@compiled
def _varied(spread: float, change: float, least: float) -> float:
    """Return the RMS share by which a length varies, after another change."""
    now = math.sqrt(spread**2 * (1 - _FORGETTING) + _FORGETTING * change**2)
    if abs(change) > _BEYOND * spread:
        now = max(now, abs(change) / 2)
    return min(max(now, least), _WIDEST)
