"""Simulate ropes that are swung through the air by one or both ends, as particles with stiff distances.

Extended position-based dynamics with small substeps (M. Macklin et al., "Small Steps in Physics Simulation", 2019).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from tests.benchmarks.scenes.ropes import resample

Array = npt.NDArray[Any]

_LENGTH: Final = (0.4, 0.9)  # metres
_PARTICLES: Final = 61
_SUBSTEP: Final = 1 / 2000  # seconds
_GRAVITY: Final = 9.81
_DRAG: Final = 0.8  # share of the speed that is lost in a second
_BENDING: Final = 0.3  # how strongly a particle is pulled to the middle of two others, in each substep
STIFFNESS: Final = (1, 2, 4, 7)  # of a cord, a rope, a cable, a stiff cable, see ``swung_rope``
_SWEEPS: Final = 8  # over the distances, in each substep
_SWAYS: Final = (3, 0.09, 2.2)  # number of sines of a hand's motion, metres of the first, most hertz
_NEAREST: Final = 0.75  # metres from the camera, at least
_CLOSEST: Final = 1.4  # lengths from the camera, at least
_LEAN: Final = (0.0, 0.9)  # radians by which the camera looks down
_STEP: Final = 0.002  # metres between the points of the curve that is returned
_SETTLING: Final = 0.5  # seconds before the first frame


def swung_rope(
    rng: np.random.Generator, hertz: float, frames: int, *, hands: int = 1, pace: float = 1.0, stiffness: int = 1
) -> Iterator[Array]:
    """Yield the axis of a swung rope in each frame: ``(P, 3)`` metres, camera frame, from tip to tip.

    Args:
        rng: Draws length, camera and motion.
        hertz: Frames per second.
        frames: How many.
        hands: 1 or 2 ends are held.
        pace: Multiplies the speed of the hands.
        stiffness: Over how many particles to either side the rope resists bending: 1 for a cord, 7 for a stiff cable.
    """
    length, lean = float(rng.uniform(*_LENGTH)), float(rng.uniform(*_LEAN))
    down = np.array([0.0, np.cos(lean), np.sin(lean)], dtype=np.float64)
    first, other = _path(rng, pace), _path(rng, pace)
    apart = np.array([rng.uniform(0.35, 0.8) * length, 0.0, 0.0])
    middle = np.array([0.0, 0.0, max(_NEAREST, _CLOSEST * length)])
    top = middle - down * length * (0.25 if hands == 2 else 0.45) - (apart / 2 if hands == 2 else 0.0)
    places = top + np.linspace(0, 1, _PARTICLES)[:, None] * (apart if hands == 2 else down * length)
    places = np.ascontiguousarray(places, dtype=np.float64)
    speeds, rest, time = np.zeros((_PARTICLES, 3)), length / (_PARTICLES - 1), 0.0
    for frame in range(frames):
        duration = _SETTLING if frame == 0 else 1 / hertz
        steps = round(duration / _SUBSTEP)
        at = time + np.arange(1, steps + 1)[:, None] * _SUBSTEP
        held = np.zeros((hands, steps, 3))
        held[0] = top + first(at)
        if hands == 2:
            held[1] = _within(held[0], top + apart + other(at), 0.97 * length)
        advance_particles(places, speeds, held, rest, down * _GRAVITY, stiffness)
        time += duration
        yield resample(places, _STEP)


def _path(rng: np.random.Generator, pace: float) -> Callable[[Array], Array]:
    """Draw the motion of a hand: seconds -> metres from where it starts."""
    count, reach, fastest = _SWAYS
    hertz = rng.uniform(0.2, fastest, (count, 3)) * pace
    swing = rng.normal(0, reach, (count, 3)) / (1 + 1.5 * hertz / pace)
    phase = rng.uniform(0, 2 * np.pi, (count, 3))

    def path(time: Array) -> Array:
        waves = np.sin(2 * np.pi * hertz * time[..., None, :] + phase) - np.sin(phase)
        return np.sum(swing * waves, axis=-2)

    return path


def _within(centre: Array, points: Array, reach: float) -> Array:
    """Return points moved towards their centres so that they lie within ``reach``."""
    away = points - centre
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    return centre + away * np.minimum(1.0, reach / np.maximum(distance, 1e-9))


@compiled("(f8[:,::1], f8[:,::1], f8[:,:,::1], f8, f8[::1], i8)")
def advance_particles(places: Array, speeds: Array, held: Array, rest: float, gravity: Array, stiffness: int) -> None:
    """Advance a chain of particles in place.

    Args:
        places: ``(K, 3)`` metres.
        speeds: ``(K, 3)`` metres per second.
        held: ``(1 or 2, T, 3)`` places of the first and the last particle in each of T substeps.
        rest: Metres between neighbours.
        gravity: ``(3,)`` metres per second squared.
        stiffness: Particles to either side, over which it resists bending.
    """
    size, before = len(places), np.empty_like(places)
    for step in range(held.shape[1]):
        for k in range(size):
            for d in range(3):
                before[k, d] = places[k, d]
                speeds[k, d] = (speeds[k, d] + gravity[d] * _SUBSTEP) * (1 - _DRAG * _SUBSTEP)
                places[k, d] += speeds[k, d] * _SUBSTEP
        for reach in range(1, stiffness + 1):
            share = _BENDING / reach**2
            for k in range(reach, size - reach):
                first, last = k - reach, k + reach
                for d in range(3):
                    middle = (places[first, d] + places[last, d]) / 2 - places[k, d]
                    places[k, d] += share * middle
                    places[first, d] -= share * middle / 2
                    places[last, d] -= share * middle / 2
        for sweep in range(_SWEEPS):
            for d in range(3):
                places[0, d] = held[0, step, d]
                if len(held) == 2:
                    places[size - 1, d] = held[1, step, d]
            for j in range(size - 1):
                k = j if sweep % 2 == 0 else size - 2 - j
                square = 0.0
                for d in range(3):
                    square += (places[k + 1, d] - places[k, d]) ** 2
                excess = (np.sqrt(square) - rest) / max(np.sqrt(square), 1e-12)
                heavy = 0.0 if k == 0 else 0.5
                light = 0.0 if len(held) == 2 and k == size - 2 else 0.5
                total = heavy + light
                for d in range(3):
                    away = (places[k + 1, d] - places[k, d]) * excess / total
                    places[k, d] += heavy * away
                    places[k + 1, d] -= light * away
        for k in range(size):
            for d in range(3):
                speeds[k, d] = (places[k, d] - before[k, d]) / _SUBSTEP
