"""Move an inextensible rope in space: at rest, rigidly, bending, both, and so that it crosses itself and parts again.

The axis is the integral of unit tangents, so that its length is exact in every frame. All is a function of time in
seconds, so that a scene may have any frame rate. The fastest node has the speed that is asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final, Literal, NamedTuple, get_args

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics

Array = npt.NDArray[np.float64]
Motion = Literal["static", "rigid", "bending", "both", "crossing"]
MOTIONS: Final[tuple[Motion, ...]] = get_args(Motion)
LENGTH: Final = 0.78  # metres from tip to tip
NODES: Final = 14
PIECES: Final = 30 * (NODES - 1)  # of the axis, 2 mm each
_COARSE: Final = 6 * (NODES - 1)  # of the axis while scenes are drawn, 10 mm each
_RADIUS: Final = (0.0035, 0.01)  # metres
_DISTANCE: Final = (0.75, 1.15)  # metres from the camera to the rope's middle
_LEAN: Final = 0.9  # radians from the image's plane, at most
_MODES: Final = np.arange(1, 4)  # half waves of the heading over the length
_BENT: Final = np.array([0.8, 0.5, 0.25])  # radians, RMS, of each mode at rest
_BENDING: Final = np.array([0.5, 0.35, 0.2])  # radians, RMS, of each mode's motion
_RISING: Final = 0.3  # of the elevation over the heading
_WANDER: Final = 0.07  # metres, RMS, of the sines of the middle's way
_SWING: Final = 0.25  # radians, RMS, of the sines of the turns
_ARM: Final = 0.22  # metres from a tip to the loop of a rope that crosses itself
_LOOP: Final = (2.4, 4.9)  # radians that the loop turns; the arms cross from pi on
_RISE: Final = (0.07, 0.13)  # radians by which the loop and its arms leave their plane
_RAMP: Final = 0.5  # seconds until the motion has its speed: a rope is at rest when it is first seen
_CHECKED: Final = 60.0  # hertz at which speeds are measured; places at a third of it
_NEAR: Final = 0.06  # metres along the rope, up to which it may be near to itself
_CLEAR: Final = 1.5  # widths in the image from axis to axis; in a crossing 1.02 widths in space
_MARGIN: Final = 12.0  # pixels to the border of the image
_OFF: Final = 0.03  # share of the speed by which the fastest node may miss it
_FASTEST: Final = 10.0  # rate: its quickest waves have 2 Hz
_DRAWS: Final = 4000
_SMALLEST: Final = 1e-9


class Sines(NamedTuple):
    """Sums of two sines of the phase of a motion."""

    size: Array  # (K, 2)
    pace: Array  # (K, 2)
    begin: Array  # (K, 2) radians

    def at(self, phase: Array) -> Array:
        """Return the sums at ``(T,)`` phases, ``(T, K)``."""
        return np.sum(self.size * np.sin(self.pace * phase[:, None, None] + self.begin), axis=2)


def _sines(rng: np.random.Generator, size: npt.ArrayLike) -> Sines:
    size = np.atleast_1d(np.asarray(size, np.float64))
    shape = len(size), 2
    return Sines(size[:, None] * rng.normal(0, 1, shape), rng.uniform(0.5, 1.3, shape), rng.uniform(0, 6.28, shape))


@dataclass(frozen=True)
class MovingRope:
    """A rope and its motion.

    Args:
        motion: What moves.
        radius: In metres.
        rate: Phase of the motion per second.
        heading: Takes ``(T,)`` phases and ``(P,)`` arc positions from 0 to 1, and returns headings, radians.
        elevation: The same out of the rope's plane.
        way: Of the rope's middle about its place, metres.
        turns: About x, y and the optical axis, radians.
        place: Of the rope's middle, ``(3,)`` metres, camera frame.
        lean: Of the rope's plane and about the optical axis, a rotation vector, ``(3,)`` radians.
        carried: Seconds ``(T,)`` -> ``(T, 3)`` metres by which it is carried besides.
    """

    motion: Motion
    radius: float
    rate: float
    heading: Callable[[Array, Array], Array] = field(repr=False)
    elevation: Callable[[Array, Array], Array] = field(repr=False)
    way: Sines = field(repr=False)
    turns: Sines = field(repr=False)
    place: Array
    lean: Array
    carried: Callable[[Array], Array] | None = None

    def axis(self, seconds: npt.ArrayLike, pieces: int = PIECES) -> Array:
        """Return the axis from tip to tip at times: ``(T,)`` seconds -> ``(T, pieces + 1, 3)`` metres, camera frame."""
        time = np.atleast_1d(np.asarray(seconds, np.float64))
        phase = self.rate * np.where(time < _RAMP, time**2 / (2 * _RAMP), time - _RAMP / 2)
        bends = phase if self.motion in ("bending", "both", "crossing") else np.zeros_like(phase)
        moves = phase if self.motion in ("rigid", "both", "crossing") else np.zeros_like(phase)
        middle = (np.arange(pieces) + 0.5) / pieces
        heading, elevation = self.heading(bends, middle), self.elevation(bends, middle)
        flat = np.cos(elevation)
        tangents = np.stack([np.cos(heading) * flat, np.sin(heading) * flat, np.sin(elevation)], axis=-1)
        points = np.zeros((len(time), pieces + 1, 3))
        np.cumsum(tangents * (LENGTH / pieces), axis=1, out=points[:, 1:])
        points -= points.mean(axis=1, keepdims=True)
        rotation = np.stack([cv2.Rodrigues(turn)[0] for turn in self.turns.at(moves)]) @ cv2.Rodrigues(self.lean)[0]
        points = points @ np.swapaxes(rotation, 1, 2) + (self.place + self.way.at(moves))[:, None]
        return points if self.carried is None else points + self.carried(time)[:, None]

    def peak_speed(self, seconds: float) -> float:
        """Return the speed of the fastest node, metres per second, in the first seconds."""
        time = np.arange(0, seconds, 1 / _CHECKED)
        nodes = self.axis(time, _COARSE)[:, :: _COARSE // (NODES - 1)]
        return float(np.linalg.norm(np.diff(nodes, axis=0), axis=2).max(initial=0.0)) * _CHECKED


def moving_rope(
    rng: np.random.Generator, motion: Motion, speed: float, seconds: float, camera: Intrinsics
) -> MovingRope:
    """Draw a rope that stays in the image and does not pass through itself.

    Args:
        rng: Draws form, thickness, tilt, place and motion.
        motion: What moves. ``"crossing"`` crosses itself in the image for a part of the time, others never do.
        speed: Of the fastest node, metres per second.
        seconds: For which the rope is to stay in the image.
        camera: The projection.
    """
    speed = 0.0 if motion == "static" else speed
    for _ in range(_DRAWS):
        rope = _paced(_drawn(rng, motion), speed, seconds)
        paced = abs(rope.peak_speed(seconds) - speed) <= _OFF * speed and rope.rate <= _FASTEST
        if paced and _is_sound(rope, seconds, camera):
            return rope
    raise RuntimeError(f"no rope of {LENGTH} m stays in {camera.width} x {camera.height} pixels at {speed} m/s.")


def _drawn(rng: np.random.Generator, motion: Motion) -> MovingRope:
    """Draw a rope and its motion, which may leave the image."""
    loop, bending, phases = motion == "crossing", _sines(rng, _BENDING), rng.uniform(0, 2 * np.pi, (3, len(_MODES)))
    bent, rising = rng.normal(0, _BENT), _sines(rng, _RISING * _BENDING)
    raised = rng.normal(0, _RISING * _BENT)
    lean, swing = rng.uniform(0, _LEAN), rng.uniform(0, 2 * np.pi)
    middle, span = float(np.mean(_LOOP)), float(np.ptp(_LOOP)) / 2
    rise, small = rng.uniform(*_RISE) * rng.choice([-1, 1]), 0.3 if loop else 1.0
    begin, hand = rng.uniform(0, 2 * np.pi), rng.choice([-1, 1])

    def heading(phase: Array, at: Array) -> Array:
        waves = np.cos(np.pi * _MODES[:, None] * at + phases[0, :, None])  # (3, P)
        bends = small * (bent @ waves + bending.at(phase) @ waves)
        if not loop:
            return bends
        turned = np.clip((at * LENGTH - _ARM) / (LENGTH - 2 * _ARM), 0, 1)
        return bends + hand * (middle + span * np.sin(phase + begin))[:, None] * turned

    def elevation(phase: Array, at: Array) -> Array:
        waves = np.cos(np.pi * _MODES[:, None] * at + phases[1, :, None])
        if loop:
            return np.full((len(phase), len(at)), rise)
        return raised @ waves + rising.at(phase) @ waves

    axis = lean * np.array([np.cos(swing), np.sin(swing), 0.0])
    spin = cv2.Rodrigues(np.array([0.0, 0.0, rng.uniform(0, 2 * np.pi)]))[0]
    leaning = cv2.Rodrigues(cv2.Rodrigues(axis * (0.5 if loop else 1.0))[0] @ spin)[0]
    turned = np.asarray(leaning, np.float64).ravel()
    distance = rng.uniform(*_DISTANCE)
    place = np.array([*rng.uniform(-0.12, 0.12, 2) * distance, distance])
    radius = float(rng.uniform(*_RADIUS))
    way, turns = _sines(rng, [_WANDER, _WANDER, _WANDER]), _sines(rng, [_SWING / 2, _SWING / 2, _SWING])
    return MovingRope(motion, radius, 1.0, heading, elevation, way, turns, place, turned)


def _paced(rope: MovingRope, speed: float, seconds: float) -> MovingRope:
    """Return the motion at the rate at which its fastest node has a speed."""
    rate = 1.0 if speed else 0.0
    for _ in range(6 if speed else 0):
        rate *= speed / max(_with_rate(rope, rate).peak_speed(seconds), _SMALLEST)
    return _with_rate(rope, rate)


def _with_rate(rope: MovingRope, rate: float) -> MovingRope:
    return replace(rope, rate=rate)


def _is_sound(rope: MovingRope, seconds: float, camera: Intrinsics) -> bool:
    """Return whether a rope stays in the image, keeps off itself in space, and crosses itself if it should."""
    axis = rope.axis(np.arange(0, seconds, 3 / _CHECKED), _COARSE)
    if axis[..., 2].min() < 0.4:
        return False
    pixels = camera.project(axis)
    inside = (pixels > _MARGIN) & (pixels < np.array([camera.width, camera.height]) - 1 - _MARGIN)
    if not inside.all():
        return False
    first, second = np.triu_indices(_COARSE + 1, round(_NEAR / LENGTH * _COARSE))
    width = 2 * rope.radius * camera.fx / axis[..., 2].mean(axis=1)
    apart = np.stack([np.linalg.norm(uv[first] - uv[second], axis=1).min() for uv in pixels]) / width
    if rope.motion != "crossing":
        return bool(apart.min() > _CLEAR)
    in_space = np.stack([np.linalg.norm(xyz[first] - xyz[second], axis=1).min() for xyz in axis])
    crossed = apart < 0.7  # nearest sampled points of two strands that cross are half a piece from each other
    return bool(
        in_space.min() > 2.04 * rope.radius and crossed.mean() > 0.2 and (apart > _CLEAR).mean() > 0.2
        and apart[0] > _CLEAR
    )  # fmt: skip
