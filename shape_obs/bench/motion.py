"""A drawn rope that moves and bends, every material point's place known in every frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.bench.ropes import SIZE, Rope, draw_rope

Array = npt.NDArray[np.float64]

_HARMONICS: Final = 3
_BISECTIONS: Final = 30


def moving_rope(
    rng: np.random.Generator, speed: float, frames: int = 180, *, length: float = 320.0, width: float = 11.0
) -> Iterator[Rope]:
    """A rope whose fastest point moves ``speed`` pixels from each frame to the next.

    It wanders through the image, turns and bends at once: the heading along the rope is a sum of sines whose
    amplitudes swing, the middle follows a Lissajous curve.

    Args:
        rng: Draws the motion.
        speed: Pixels per frame.
        frames: How many.
        length: Of the rope, pixels.
        width: Of the rope, pixels.
    """
    rates = rng.uniform(0.3, 0.9, _HARMONICS)
    phases, bends = rng.uniform(0, 2 * np.pi, _HARMONICS), 1.1 / np.arange(1, _HARMONICS + 1)
    turn = rng.uniform(0.1, 0.25) * rng.choice([-1, 1])
    start = rng.uniform(0, 2 * np.pi, 3)

    def curve_at(time: float) -> Array:
        s = np.arange(0.0, length + 0.5)
        along = s / length
        heading = start[0] + turn * time
        for k in range(_HARMONICS):
            heading = heading + bends[k] * np.sin(rates[k] * time + phases[k]) * np.cos(np.pi * (k + 1) * along)
        curve = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
        room = (np.array([SIZE[1], SIZE[0]]) - length) / 2 - width
        middle = np.array([SIZE[1], SIZE[0]]) / 2 + np.maximum(room, 20) * np.sin([0.7 * time, 0.5 * time] + start[1:])
        return curve - curve.mean(axis=0) + middle

    time, curve = 0.0, curve_at(0.0)
    for _ in range(frames):
        yield draw_rope(curve, width, flat_caps=True, kind="moving")
        time = _after(curve_at, curve, time, speed)
        curve = curve_at(time)


def _after(curve_at: Callable[[float], Array], curve: Array, time: float, speed: float) -> float:
    """The next time at which some point has moved ``speed`` pixels."""
    low, high = 0.0, 0.05
    while np.linalg.norm(curve_at(time + high) - curve, axis=1).max() < speed:
        low, high = high, high * 1.5
    for _ in range(_BISECTIONS):
        step = (low + high) / 2
        near = np.linalg.norm(curve_at(time + step) - curve, axis=1).max() < speed
        low, high = (step, high) if near else (low, step)
    return time + low
