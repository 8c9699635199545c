"""The length of a rope: what is known of it, and how little a frame may change that."""

from __future__ import annotations

import math
from typing import Any

from shape_obs.compiled import compiled
from shape_obs.tracking.model import gain_of


@compiled
def learn_length(
    rope: Any, size: float, metres: float, in_sight: bool, unbroken: bool, seconds: float, model: Any
) -> None:
    """Learn a rope's length in a frame in which nothing of it is hidden.

    A length follows what is measured as far as noise explains the difference, and hardly beyond that: never because
    less is seen.

    Args:
        rope: What is known of it, one ``RopeState``; changed in place.
        size: What was seen, pixels.
        metres: The same in metres, 0 if it is not known.
        in_sight: Whether nothing is seen to hide an end.
        unbroken: Whether no piece is bridged.
        seconds: For which this frame counts.
        model: The constants, one ``ChainModel``.
    """
    whole = in_sight and unbroken
    if rope.frames == 0 and (unbroken or rope.pixels == 0):  # a gap may be bridged by too long a way
        rope.pixels, rope.metres = max(size, rope.pixels), max(metres, rope.metres)
        rope.frames, rope.short = 1.0 if whole else 0.0, 0.0
        return
    if not whole:
        return
    change, gain = size / rope.pixels - 1, gain_of(seconds, model.memory)
    # What looks shorter may be hidden in part: only what comes back to its length was seen at an angle, or in noise.
    rope.pixels_spread = _varied(rope.pixels_spread, max(change, -model.shorter[0] * rope.pixels_spread), gain, model)
    rope.pixels *= 1 + gain * change
    rope.frames, rope.short = rope.frames + 1, 0.0
    if metres == 0 or rope.metres == 0:
        rope.metres = metres if metres > 0 else rope.metres
        return
    off = max(metres / rope.metres - 1, -model.shorter[1] * rope.metres_spread)
    most = model.length_rate * seconds
    explained = abs(off) < model.beyond_noise * model.length_spread[1]
    step = max(gain, 1 / rope.frames) * off if explained else min(max(off, -most), most)
    rope.metres_spread = min(_varied(rope.metres_spread, off, gain, model), model.length_spread[1])
    rope.metres *= 1 + step


@compiled
def shorten_length(rope: Any, size: float, metres: float, free: bool, seconds: float, model: Any) -> None:
    """Learn that a rope became shorter, if both of its tips are free, and nothing is nearer than they are, for long.

    Args:
        rope: What is known of it, one ``RopeState``; changed in place.
        size: What was seen, pixels.
        metres: The same in metres, 0 if it is not known.
        free: Whether both of its tips are free.
        seconds: For which this frame counts.
        model: The constants, one ``ChainModel``.
    """
    if free and rope.short >= model.shorter_for:
        rope.pixels, rope.metres, rope.frames, rope.short = size, metres, 1.0, 0.0
        return
    rope.short = rope.short + seconds if free else 0.0


@compiled
def _varied(spread: float, change: float, gain: float, model: Any) -> float:
    """Return the RMS share by which a length varies, after another change."""
    now = math.sqrt(spread**2 * (1 - gain) + gain * change**2)
    now = max(now, abs(change) / 2) if abs(change) > model.beyond_noise * spread else now
    return max(now, model.length_spread[0])
