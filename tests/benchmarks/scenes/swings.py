"""Simulate ropes that are swung through the air by one or both ends, as particles with stiff distances.

Extended position-based dynamics with small substeps (M. Macklin et al., "Small Steps in Physics Simulation", 2019).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import resample
from shape_obs.compiled import compiled

Array = npt.NDArray[Any]
STIFFNESS: Final = (1, 2, 4, 7)  # of a cord, a rope, a cable, a stiff cable, see ``swung_rope``
_PARTICLES: Final = 61
_SUBSTEP: Final = 1 / 2000  # seconds
_DRAG: Final = 0.8  # share of the speed that is lost in a second
_BENDING: Final = 0.3  # how strongly a particle is pulled to the middle of two others, in each substep
_SWEEPS: Final = 8  # over the distances, in each substep
_SETTLING: Final = 0.5  # seconds before the first frame


def swung_rope(
    rng: np.random.Generator, hertz: float, frames: int, *, hands: int = 1, stiffness: int = 1
) -> Iterator[Array]:
    """Yield the axis of a swung rope in each frame: ``(P, 3)`` metres, camera frame, from tip to tip.

    Args:
        rng: Draws length (0.4 to 0.9 m), camera and motion.
        hertz: Frames per second.
        frames: How many.
        hands: 1 or 2 ends are held.
        stiffness: Over how many particles to either side the rope resists bending: 1 for a cord, 7 for a stiff cable.
    """
    length, lean = float(rng.uniform(0.4, 0.9)), float(rng.uniform(0.0, 0.9))
    down = np.array([0.0, np.cos(lean), np.sin(lean)], dtype=np.float64)
    first, other = _path(rng), _path(rng)
    apart = np.array([rng.uniform(0.35, 0.8) * length, 0.0, 0.0])
    middle = np.array([0.0, 0.0, max(0.75, 1.4 * length)])
    top = middle - down * length * (0.25 if hands == 2 else 0.45) - (apart / 2 if hands == 2 else 0.0)
    places = top + np.linspace(0, 1, _PARTICLES)[:, None] * (apart if hands == 2 else down * length)
    places = np.ascontiguousarray(places, dtype=np.float64)
    speeds, time = np.zeros((_PARTICLES, 3)), 0.0
    for frame in range(frames):
        duration = _SETTLING if frame == 0 else 1 / hertz
        at = time + np.arange(1, round(duration / _SUBSTEP) + 1)[:, None] * _SUBSTEP
        held = np.zeros((hands, len(at), 3))
        held[0] = top + first(at)
        if hands == 2:  # the ends stay nearer to each other than the rope's length
            away = top + apart + other(at) - held[0]
            held[1] = held[0] + away * np.minimum(1.0, 0.97 * length / np.linalg.norm(away, axis=1, keepdims=True))
        advance_particles(places, speeds, held, length / (_PARTICLES - 1), down * 9.81, stiffness)
        time += duration
        yield resample(places, 0.002)


def _path(rng: np.random.Generator) -> Callable[[Array], Array]:
    """Draw the motion of a hand, a sum of three sines of up to 2.2 Hz: seconds -> metres from where it starts."""
    hertz = rng.uniform(0.2, 2.2, (3, 3))
    swing, phase = rng.normal(0, 0.09, (3, 3)) / (1 + 1.5 * hertz), rng.uniform(0, 2 * np.pi, (3, 3))

    def path(time: Array) -> Array:
        waves = np.sin(2 * np.pi * hertz * time[..., None, :] + phase) - np.sin(phase)
        return np.sum(swing * waves, axis=-2)

    return path


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
    size = len(places)
    for step in range(held.shape[1]):
        before = places.copy()
        speeds[:] = (speeds + gravity * _SUBSTEP) * (1 - _DRAG * _SUBSTEP)
        places += speeds * _SUBSTEP
        for reach in range(1, stiffness + 1):
            for k in range(reach, size - reach):
                off = _BENDING / reach**2 * ((places[k - reach] + places[k + reach]) / 2 - places[k])
                places[k] += off
                places[k - reach] -= off / 2
                places[k + reach] -= off / 2
        for sweep in range(_SWEEPS):
            places[0] = held[0, step]
            if len(held) == 2:
                places[-1] = held[1, step]
            for j in range(size - 1):
                k = j if sweep % 2 == 0 else size - 2 - j
                apart = places[k + 1] - places[k]
                distance = np.sqrt(np.sum(apart**2))
                first = 0.0 if k == 0 else 0.5  # a held particle does not move
                last = 0.0 if len(held) == 2 and k == size - 2 else 0.5
                apart *= (distance - rest) / max(distance, 1e-12) / (first + last)
                places[k] += first * apart
                places[k + 1] -= last * apart
        speeds[:] = (places - before) / _SUBSTEP
