"""Draw ropes with a known centreline, at rest and moving."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

Curve = npt.NDArray[np.float64]
Kind = Literal["smooth", "u", "s", "hairpin", "loop", "spiral", "fat"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)
Bend = Literal["hairpin", "s-bends", "omega", "coil", "waves"]
BENDS: Final[tuple[Bend, ...]] = get_args(Bend)
SIZE: Final = (480, 640)
_STEP: Final = 1.0
_SUPERSAMPLING: Final = 4
Array = npt.NDArray[np.float64]
_HARMONICS: Final = 3
_BISECTIONS: Final = 30
_FINE: Final = 100  # steps to a width


@dataclass(frozen=True)
class Rope:
    """A drawn rope.

    Args:
        curve: The centreline from tip to tip, round caps included: ``(P, 2)`` pixels, at steps of about a pixel.
        width: Thickness in pixels.
        mask: ``(H, W)`` uint8, 0 or 255.
        kind: How the curve was made.
    """

    curve: Curve
    width: float
    mask: npt.NDArray[np.uint8]
    kind: str

    @property
    def length(self) -> float:
        """Arc length from tip to tip, in pixels."""
        return float(np.linalg.norm(np.diff(self.curve, axis=0), axis=1).sum())

    @property
    def bend_radius(self) -> float:
        """Radius of the tightest bend in pixels, measured over half a turn of it."""
        step = np.diff(self.curve, axis=0)
        heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
        reach = max(round(1.5 * self.width), 1)
        turn = np.abs(heading[reach:] - heading[:-reach]).max(initial=0.0) if len(heading) > reach else 0.0
        return float(reach * self.length / len(step) / max(turn, 1e-6))


def random_rope(rng: np.random.Generator, kind: Kind = "smooth", size: tuple[int, int] = SIZE) -> Rope:
    """Draw a rope 8 to 16 px thick that neither crosses nor touches itself, inside an image of ``size`` ``(H, W)``."""
    for _ in range(2000):
        width = float(rng.uniform(8, 16))
        curve = place(resample(_MAKERS[kind](rng, width), _STEP), rng, size, width)
        if curve is not None and not _touches(curve, width):
            flat = bool(rng.integers(2))
            return draw_rope(curve, width, flat_caps=flat, size=size, kind=kind)
    raise RuntimeError(f"no {kind} rope found that fits {size[1]} x {size[0]} pixels without touching itself.")


def draw_rope(
    curve: Curve, width: float, *, flat_caps: bool = True, size: tuple[int, int] = SIZE, kind: str = "given"
) -> Rope:
    """Draw a ribbon of ``width`` about a curve of ``(P, 2)`` pixels; round caps add half a width at both ends."""
    canvas = blank(size)
    tangent = np.gradient(curve, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) * width / 2
    left, right = subpixel(curve + normal), subpixel(curve - normal)
    for i in range(len(curve) - 1):
        cv2.fillConvexPoly(canvas, np.stack([left[i], left[i + 1], right[i + 1], right[i]]), 255, shift=8)
    if not flat_caps:
        for end in subpixel(curve[[0, -1]]):
            cv2.circle(canvas, end.tolist(), round(width / 2 * _SUPERSAMPLING * 256), 255, -1, shift=8)
        curve = np.concatenate([curve[:1] - tangent[:1] * width / 2, curve, curve[-1:] + tangent[-1:] * width / 2])
    return Rope(curve, width, covered(canvas), kind)


def blank(size: tuple[int, int]) -> npt.NDArray[np.uint8]:
    """Return an empty, supersampled canvas for an image of ``size`` ``(H, W)``."""
    return np.zeros((size[0] * _SUPERSAMPLING, size[1] * _SUPERSAMPLING), np.uint8)


def covered(canvas: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Return the mask of the pixels that are at least half drawn on a supersampled canvas."""
    height, width = (side // _SUPERSAMPLING for side in canvas.shape)
    small = cv2.resize(canvas, (width, height), interpolation=cv2.INTER_AREA)
    return np.where(small > 127, np.uint8(255), np.uint8(0))


def resample(curve: Curve, step: float) -> Curve:
    """Resample a curve at equal arc-length steps of about ``step``."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    at = np.linspace(0, arc[-1], max(round(arc[-1] / step) + 1, 2))
    return np.stack([np.interp(at, arc, curve[:, d]) for d in range(curve.shape[1])], axis=1)


def subpixel(points: Curve) -> npt.NDArray[np.int32]:
    """Convert pixels to OpenCV's fixed-point coordinates on the supersampled canvas."""
    return np.round(((points + 0.5) * _SUPERSAMPLING - 0.5) * 256).astype(np.int32)


def from_heading(heading: npt.NDArray[Any]) -> Curve:
    """Return a curve with steps of a pixel in the given directions, in radians."""
    return np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)


def rotation(radians: float) -> Array:
    """Return a rotation that is clockwise as seen, since v points down, ``(2, 2)``."""
    return np.array([[np.cos(radians), -np.sin(radians)], [np.sin(radians), np.cos(radians)]])


def _smooth(rng: np.random.Generator, width: float) -> Curve:
    length = rng.uniform(250, 800)
    t = np.linspace(0, 1, int(length))
    heading = sum(rng.normal(0, 1.6 / k) * np.sin(np.pi * k * t + rng.uniform(0, 2 * np.pi)) for k in range(1, 5))
    return from_heading(np.asarray(heading))


def arcs(*pieces: tuple[float, float]) -> Curve:
    """Join pieces of (length, turned angle) smoothly."""
    turn = np.concatenate([np.full(int(length), angle / int(length)) for length, angle in pieces])
    return from_heading(np.cumsum(turn))


def _u(rng: np.random.Generator, width: float) -> Curve:
    radius, arm = rng.uniform(2.5, 7) * width, rng.uniform(60, 220)
    return arcs((arm, 0.0), (np.pi * radius, np.pi), (arm * rng.uniform(0.5, 1), 0.0))


def _s(rng: np.random.Generator, width: float) -> Curve:
    radius, arm = rng.uniform(2.5, 6) * width, rng.uniform(40, 160)
    bend = (np.pi * radius, np.pi)
    return arcs((arm, 0.0), bend, (arm, 0.0), (bend[0], -bend[1]), (arm, 0.0))


def _hairpin(rng: np.random.Generator, width: float) -> Curve:
    radius, arm = rng.uniform(0.95, 1.4) * width, rng.uniform(100, 260)
    return arcs((arm, 0.0), (np.pi * radius, np.pi), (arm * rng.uniform(0.6, 1), 0.0))


def _loop(rng: np.random.Generator, width: float) -> Curve:
    radius = rng.uniform(60, 150)
    gap = (width * rng.uniform(1.8, 2.5)) / radius
    return arcs(((2 * np.pi - gap) * radius, 2 * np.pi - gap))


def _spiral(rng: np.random.Generator, width: float) -> Curve:
    turns, pitch = rng.uniform(1.3, 2.4), rng.uniform(2.0, 3.5) * width
    angle = np.linspace(0, 2 * np.pi * turns, 3000)
    radius = rng.uniform(1.8, 3) * width + pitch * angle / (2 * np.pi)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def _fat(rng: np.random.Generator, width: float) -> Curve:
    length = rng.uniform(4, 7) * width
    return arcs((length / 2, rng.uniform(-0.6, 0.6)), (length / 2, rng.uniform(-0.6, 0.6)))


_MAKERS: Final = dict(zip(KINDS, (_smooth, _u, _s, _hairpin, _loop, _spiral, _fat), strict=True))


def bent_rope(rng: np.random.Generator, bend: Bend, radius: float, width: float) -> Rope:
    """Draw a rope ``width`` px thick that touches itself nowhere; its tightest bends measure ``radius`` widths."""
    for _ in range(2000):
        curve = place(resample(_bent(rng, bend, radius) * width, _STEP), rng, SIZE, width)
        if curve is not None and not _touches(curve, width):
            return draw_rope(curve, width, flat_caps=bool(rng.integers(2)), kind=bend)
    raise RuntimeError(f"no {bend} of radius {radius} widths found that fits the image without touching itself.")


def _bent(rng: np.random.Generator, bend: Bend, radius: float) -> Curve:
    """Return the axis of a rope of width 1."""
    first, last, many = rng.uniform(6, 14), rng.uniform(8, 14), int(rng.integers(2, 9))
    pieces = [(np.pi * radius, np.pi)]
    if bend == "coil":
        angle, pitch = np.linspace(0, 2 * np.pi * rng.uniform(1.2, 5), 3000), rng.uniform(1.9, 2.5)
        return (radius + pitch * angle / (2 * np.pi))[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    if bend == "waves":
        angle, height = np.linspace(0, 2 * np.pi * many, 3000), rng.uniform(1.0, 3.0)
        return np.stack([angle * np.sqrt(radius * height), height * np.cos(angle)], axis=1)
    if bend == "s-bends":
        turn, between = rng.uniform(2.2, np.pi), rng.uniform(0, 14)
        pieces = [piece for sign in (1, -1) for piece in ((turn * radius, sign * turn), (between, 0.0))] * many
    elif bend == "omega":
        neck = rng.uniform(0.2, 0.6)
        side, around = (radius * (neck + np.pi / 2), -neck - np.pi / 2), np.pi + 2 * neck
        pieces = [side, (radius * around, around), side]
    pieces = [(first, 0.0), *pieces, (last, 0.0)]
    return arcs(*((_FINE * length, turn) for length, turn in pieces if length > 0.1)) / _FINE


def bending_rope(radius: float, width: float, frames: int = 60, length: float = 24.0) -> Iterator[Rope]:
    """Draw a straight rope that bends in its middle, frame by frame, to a hairpin; its middle stays in place.

    Args:
        radius: Of the bend at the end, widths.
        width: Thickness in pixels.
        frames: How many.
        length: Of the rope, widths.
    """
    size, bent = length * width, np.pi * radius * width
    at = np.arange(-size / 2, size / 2)
    for share in np.linspace(0, 1, frames):
        curve = from_heading(np.clip(at / bent, -0.5, 0.5) * np.pi * share)
        middle = np.array([SIZE[1], SIZE[0]]) / 2 + 0.37
        yield draw_rope(curve - curve[len(curve) // 2] + middle, width, kind="bending")


def place(curve: Curve, rng: np.random.Generator, size: tuple[int, int], width: float) -> Curve | None:
    """Turn the curve at random and move it inside the image; None if it does not fit."""
    curve = curve @ rotation(rng.uniform(0, 2 * np.pi)).T
    if rng.integers(2):
        curve = curve[:, ::-1]
    low, high = curve.min(axis=0), curve.max(axis=0)
    room = np.array([size[1], size[0]]) - 2 * (width + 4) - (high - low)
    if np.any(room < 0):
        return None
    return curve - low + width + 4 + room * rng.uniform(size=2)


def _touches(curve: Curve, width: float) -> bool:
    """Return whether strands are closer than the width and a gap of 3 px, or bend tighter than the ribbon allows."""
    pairs = KDTree(curve).query_pairs(width + 3, output_type="ndarray")
    return bool(np.any(np.abs(pairs[:, 1] - pairs[:, 0]) * _STEP > np.pi / 2 * (width + 3) + 2))


def moving_rope(
    rng: np.random.Generator, speed: float, frames: int = 180, *, length: float = 320.0, width: float = 11.0
) -> Iterator[Rope]:
    """Draw a rope that wanders, turns and bends, see ``moving_curve``."""
    for curve in moving_curve(rng, speed, frames, length=length, width=width):
        yield draw_rope(curve, width, flat_caps=True, kind="moving")


def moving_curve(
    rng: np.random.Generator, speed: float, frames: int = 180, *, length: float = 320.0, width: float = 11.0
) -> Iterator[Curve]:
    """Yield the axis of a rope that wanders, turns and bends; its fastest point moves ``speed`` pixels per frame.

    The heading along the rope is a sum of sines whose amplitudes swing; the middle follows a Lissajous curve. Point i
    of the curve is the same material point in every frame.

    Args:
        rng: Draws the motion.
        speed: Speed in pixels per frame; 0 for a rope at rest.
        frames: Number of frames.
        length: Length of the rope in pixels.
        width: Width of the rope in pixels.
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
        curve = from_heading(heading)
        room = (np.array([SIZE[1], SIZE[0]]) - length) / 2 - width
        middle = np.array([SIZE[1], SIZE[0]]) / 2 + np.maximum(room, 20) * np.sin([0.7 * time, 0.5 * time] + start[1:])
        return curve - curve.mean(axis=0) + middle

    time, curve = 0.0, curve_at(0.0)
    for _ in range(frames):
        yield curve
        if speed > 0:
            time = _after(curve_at, curve, time, speed)
            curve = curve_at(time)


def _after(curve_at: Callable[[float], Array], curve: Array, time: float, speed: float) -> float:
    """Return the next time at which some point has moved ``speed`` pixels."""
    low, high = 0.0, 0.05
    while np.linalg.norm(curve_at(time + high) - curve, axis=1).max() < speed:
        low, high = high, high * 1.5
    for _ in range(_BISECTIONS):
        step = (low + high) / 2
        near = np.linalg.norm(curve_at(time + step) - curve, axis=1).max() < speed
        low, high = (step, high) if near else (low, step)
    return time + low
