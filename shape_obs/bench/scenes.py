"""Draw ropes, blobs and sheets whose every point is known, at rest and moving; ``shape_obs.bench.photos`` adds depth.

Nothing here uses the library's own methods, so that a detector can be compared with the truth:

    for rope in moving_rope(np.random.default_rng(0), speed=6.0):
        error = distance(detector.detect_mask(rope.mask).shapes[0].pixels, rope.curve)

Pixels are (u, v), u to the right and v down, and whole at the centre of a pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]
Size = tuple[int, int]

SIZE: Final[Size] = (480, 640)  # rows and columns of an image
_SUPERSAMPLING: Final = 4
_HARMONICS: Final = 3  # of the heading along a moving rope
_ANGLES: Final = 2 * np.pi * np.arange(1440) / 1440
_FINE: Final = 65  # points along each side of a sheet
# Cloth bends and shears in the image plane and hardly stretches: points slide along a side by a fifth of its bend.
_BEND: Final = 0.035  # standard deviation, short sides
_SLIDE: Final = 0.2
_CORNER_TURN: Final = 55.0  # smallest turn of the outline at a corner in degrees
_SHEET_MARGIN: Final = 12.0  # pixels


@dataclass(frozen=True)
class Rope:
    """A drawn rope.

    Args:
        curve: The centreline from tip to tip, round caps included: ``(P, 2)`` pixels, at steps of about a pixel.
        width: Thickness in pixels.
        mask: ``(H, W)`` uint8, 0 or 255.
        kind: How the curve was made.
    """

    curve: Array
    width: float
    mask: Mask
    kind: str = "given"

    @property
    def length(self) -> float:
        """Arc length from tip to tip, in pixels."""
        return float(np.linalg.norm(np.diff(self.curve, axis=0), axis=1).sum())


@dataclass(frozen=True)
class Blob:
    """A drawn blob, or a ring if it has a hole.

    Args:
        outline: ``(P, 2)`` pixels, closed, clockwise as seen.
        mask: ``(H, W)`` uint8, 0 or 255.
        kind: How the outline was made.
        hole: The outline of the hole in the same form, ``(Q, 2)`` pixels; None without a hole.
    """

    outline: Array
    mask: Mask
    kind: str = "given"
    hole: Array | None = None


@dataclass(frozen=True)
class Sheet:
    """A drawn cloth.

    Args:
        points: The material lattice up to the border, (65, 65, 2) pixels: rows from top to bottom.
        mask: ``(H, W)`` uint8, 0 or 255.
    """

    points: Array
    mask: Mask


Object: TypeAlias = "Rope | Blob | Sheet"


def truth_of(thing: Object) -> Array:
    """Return the known points in order, ``(P, 2)`` pixels: an axis, an outline, or a cloth's lattice row by row."""
    if isinstance(thing, Sheet):
        return thing.points.reshape(-1, 2)
    return thing.curve if isinstance(thing, Rope) else thing.outline


# Ropes


def draw_rope(curve: Array, width: float, *, flat_caps: bool = True, size: Size = SIZE, kind: str = "given") -> Rope:
    """Draw a ribbon of ``width`` about a curve of ``(P, 2)`` pixels; round caps add half a width at both ends.

    OpenCV fills borders too, so the mask is about 0.2 px larger on every side.
    """
    canvas = blank(size)
    tangent = np.gradient(curve, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) * width / 2
    left, right = subpixel(curve + normal), subpixel(curve - normal)
    for i in range(len(curve) - 1):
        cv2.fillConvexPoly(canvas, np.stack([left[i], left[i + 1], right[i + 1], right[i]]), (255,), shift=8)
    if not flat_caps:
        for end in subpixel(curve[[0, -1]]):
            cv2.circle(canvas, end.tolist(), round(width / 2 * _SUPERSAMPLING * 256), (255,), -1, shift=8)
        curve = np.concatenate([curve[:1] - tangent[:1] * width / 2, curve, curve[-1:] + tangent[-1:] * width / 2])
    return Rope(curve, width, covered(canvas), kind)


def moving_rope(
    rng: np.random.Generator, speed: float, frames: int = 180, *, length: float = 320.0, width: float = 11.0
) -> Iterator[Rope]:
    """Draw a rope that wanders, turns and bends, see ``moving_curve``."""
    for curve in moving_curve(rng, speed, frames, length=length, width=width):
        yield draw_rope(curve, width, kind="moving")


def moving_curve(
    rng: np.random.Generator, speed: float, frames: int = 180, *, length: float = 320.0, width: float = 11.0
) -> Iterator[Array]:
    """Yield the axis of a rope that wanders, turns and bends; its fastest point moves ``speed`` pixels per frame.

    The heading along the rope is a sum of sines whose amplitudes swing; the middle follows a Lissajous curve. Point i
    is the same material point in every frame; ``length`` and ``width`` are pixels, and speed 0 keeps the rope at rest.
    """
    rates = rng.uniform(0.3, 0.9, _HARMONICS)
    phases, bends = rng.uniform(0, 2 * np.pi, _HARMONICS), 1.1 / np.arange(1, _HARMONICS + 1)
    turn = rng.uniform(0.1, 0.25) * rng.choice([-1, 1])
    start = rng.uniform(0, 2 * np.pi, 3)
    image, along = np.array([SIZE[1], SIZE[0]]), np.arange(0.0, length + 0.5) / length
    sway = np.maximum((image - length) / 2 - width, 20)

    def curve_at(time: float) -> Array:
        heading = start[0] + turn * time
        for k in range(_HARMONICS):
            heading = heading + bends[k] * np.sin(rates[k] * time + phases[k]) * np.cos(np.pi * (k + 1) * along)
        curve = from_heading(np.asarray(heading))
        return curve - curve.mean(axis=0) + image / 2 + sway * np.sin(np.array([0.7, 0.5]) * time + start[1:])

    for time in times(curve_at, speed, frames):
        yield curve_at(time)


# Blobs and rings


def draw_blob(outline: Array, hole: Array | None = None, *, size: Size = SIZE, kind: str = "given") -> Blob:
    """Fill a closed outline of ``(P, 2)`` pixels, except a hole: a pixel is inside if its centre is."""
    inside = _inside(outline, size)
    if hole is not None:
        inside &= ~_inside(hole, size)
    mask = np.where(inside, np.uint8(255), np.uint8(0))
    return Blob(_clockwise(outline), mask, kind, None if hole is None else _clockwise(hole))


def moving_blob(
    rng: np.random.Generator,
    *,
    turn: float = 0.08,
    speed: float = 0.0,
    swell: float = 0.0,
    bumps: float = 0.15,
    hole: bool = False,
    radius: float = 100.0,
    size: Size = SIZE,
    frames: int = 180,
) -> Iterator[Blob]:
    """Draw a blob that turns, wanders and deforms; point i of its outline is the same material point in every frame.

    Args:
        rng: Draws the shape.
        turn: Radians per frame, clockwise as seen.
        speed: Pixels per frame, along a circle of the same radius about the middle of the image.
        swell: Share by which its waves grow and shrink, each with a period of 60 to 120 frames.
        bumps: Size of the waves relative to the radius; 0 is a circle.
        hole: Whether the blob has a hole of another shape.
        radius: In pixels.
        size: Of the image, rows and columns.
        frames: Number of frames.
    """
    middle = np.array([size[1], size[0]]) / 2
    waves, inner = random_waves(rng, bumps), random_waves(rng, bumps)
    pace, begin = 2 * np.pi / rng.uniform(60, 120, 3), rng.uniform(0, 2 * np.pi, 3)
    around = radius if speed else 0.0
    for i in range(frames):
        at = i * speed / max(around, 1e-9)
        centre = middle + around * np.array([np.cos(at), np.sin(at)])
        swollen = np.stack([1 + swell * np.sin(pace * i + begin), np.ones(3)], axis=1)
        outline = radius * wavy_circle(waves * swollen) @ rotation(i * turn).T + centre
        inside = 0.45 * radius * wavy_circle(inner * swollen) @ rotation(i * turn).T + centre if hole else None
        yield draw_blob(outline, inside, kind="moving", size=size)


def random_waves(rng: np.random.Generator, size: float) -> Array:
    """Draw amplitudes and phases of the second to the fourth wave around a circle, ``(3, 2)``."""
    return np.stack([size * rng.uniform(0.5, 1, 3) / np.array([1, 1.5, 2]), rng.uniform(0, 2 * np.pi, 3)], axis=1)


def wavy_circle(waves: Array) -> Array:
    """Return the outline of a circle of radius 1 with ``(3, 2)`` waves, (1440, 2)."""
    radius = 1 + sum(size * np.cos((k + 2) * _ANGLES + phase) for k, (size, phase) in enumerate(waves))
    return np.asarray(radius)[:, None] * np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)


# Sheets


def draw_sheet(points: Array, size: Size = SIZE) -> Sheet:
    """Draw the cloth with a given lattice, (65, 65, 2) pixels: a pixel is inside if its centre is."""
    return Sheet(points, np.where(_inside(border_of(points), size), np.uint8(255), np.uint8(0)))


def moving_sheet(rng: np.random.Generator, speed: float, frames: int = 180, *, aspect: float = 1.5) -> Iterator[Sheet]:
    """Draw a cloth that wanders, turns and bends; its fastest point moves ``speed`` pixels per frame.

    ``aspect`` is width over height in the cloth's frame; speed 0 keeps the cloth at rest.
    """
    flat = flat_cloth(aspect) * 0.8  # leaves room to move
    while True:
        bend, turn = swinging_bend(rng, flat), rng.uniform(0.15, 0.4) * rng.choice([-1, 1])
        start = rng.uniform(0, 2 * np.pi, 3)
        if all(is_cloth(flat + bend(time)) for time in np.linspace(0, 60, 121)):
            break
    image = np.array([SIZE[1], SIZE[0]])
    sway = np.maximum(image / 2 - np.linalg.norm(flat, axis=-1).max() * 1.15 - _SHEET_MARGIN, 10.0)

    def lattice_at(time: float) -> Array:
        middle = image / 2 + sway * np.sin(np.array([0.7, 0.5]) * time + start[1:])
        return (flat + bend(time)) @ rotation(start[0] + turn * time).T + middle

    for time in times(lattice_at, speed, frames):
        yield draw_sheet(lattice_at(time))


def flat_cloth(aspect: float) -> Array:
    """Return a flat cloth about the origin whose diagonal fits an image at any angle, (65, 65, 2) pixels."""
    width = 330.0 * aspect / np.hypot(1.0, aspect)
    across, down = np.linspace(-0.5, 0.5, _FINE) * width, np.linspace(-0.5, 0.5, _FINE) * width / aspect
    return np.stack(np.meshgrid(across, down), axis=-1)


def swinging_bend(rng: np.random.Generator, flat: Array, bend: float = _BEND) -> Callable[[float], Array]:
    """Return a smooth displacement of a cloth that swings with time: time -> (65, 65, 2) pixels.

    ``bend`` is the standard deviation of each bending mode, in short sides of the ``flat`` cloth.
    """
    width, height = np.ptp(flat[..., 0]), np.ptp(flat[..., 1])
    u, v = flat[..., 0] / width + 0.5, flat[..., 1] / height + 0.5
    modes = []
    for across in range(4):
        for down in range(4):
            if 1 <= across + down <= 3:
                wave = np.cos(np.pi * across * u) * np.cos(np.pi * down * v)
                # A displacement along the direction of the wave would stretch the cloth.
                shares = np.array([1.0 if across == 0 else _SLIDE, 1.0 if down == 0 else _SLIDE])
                amplitude = rng.normal(0, bend, 2) * shares * min(width, height) / (across + down)
                modes.append((wave[..., None] * amplitude, rng.uniform(0, 2 * np.pi), rng.uniform(0.3, 0.9)))
    return lambda time: np.sum([wave * 2**0.5 * np.cos(rate * time + phase) for wave, phase, rate in modes], axis=0)


def is_cloth(points: Array) -> bool:
    """Return whether a lattice of (R, C, 2) pixels has no folds and four corners."""
    right, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
    area = right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0]
    lengths = np.linalg.norm(right, axis=-1) * np.linalg.norm(down, axis=-1)
    corners = (area / lengths)[[0, 0, -1, -1], [0, -1, 0, -1]]
    return bool(area.min() > 0.5 * area.mean() and corners.min() > np.sin(np.radians(_CORNER_TURN)))


def border_of(points: Array) -> Array:
    """Return the border of a cloth from its top left corner, ``(P, 2)``, clockwise in the cloth's frame."""
    return np.concatenate([points[0, :-1], points[:-1, -1], points[-1, :0:-1], points[:0:-1, 0]])


# Parts of drawings


def blank(size: Size) -> Mask:
    """Return an empty, supersampled canvas for an image of ``size`` ``(H, W)``."""
    return np.zeros((size[0] * _SUPERSAMPLING, size[1] * _SUPERSAMPLING), np.uint8)


def covered(canvas: Mask) -> Mask:
    """Return the mask of the pixels that are at least half drawn on a supersampled canvas."""
    height, width = (side // _SUPERSAMPLING for side in canvas.shape)
    small = cv2.resize(canvas, (width, height), interpolation=cv2.INTER_AREA)
    return np.where(small > 127, np.uint8(255), np.uint8(0))


def subpixel(points: Array) -> npt.NDArray[np.int32]:
    """Convert pixels to OpenCV's fixed-point coordinates on the supersampled canvas."""
    return np.round(((points + 0.5) * _SUPERSAMPLING - 0.5) * 256).astype(np.int32)


def resample(curve: Array, step: float) -> Array:
    """Resample a curve at equal arc-length steps of about ``step``."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    at = np.linspace(0, arc[-1], max(round(arc[-1] / step) + 1, 2))
    return np.stack([np.interp(at, arc, curve[:, d]) for d in range(curve.shape[1])], axis=1)


def from_heading(heading: Array) -> Array:
    """Return a curve with steps of a pixel in the given directions: (P,) radians -> (P, 2)."""
    return np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)


def rotation(radians: float) -> Array:
    """Return a rotation that is clockwise as seen, since v points down, ``(2, 2)``."""
    return np.array([[np.cos(radians), -np.sin(radians)], [np.sin(radians), np.cos(radians)]])


def times(at: Callable[[float], Array], speed: float, frames: int) -> Iterator[float]:
    """Yield the times of frames between which the fastest point moves ``speed`` pixels.

    ``at`` takes a time and returns (..., 2) pixels; speed 0 repeats the first time.
    """
    time = 0.0
    for frame in range(frames):
        if frame and speed > 0:
            before = at(time)

            def lead(step: float, time: float = time, before: Array = before) -> float:
                return float(np.linalg.norm(at(time + step) - before, axis=-1).max()) - speed

            high = 0.05
            while lead(high) < 0:
                high *= 1.5
            time += float(brentq(lead, 0.0, high, xtol=1e-10))  # type: ignore[arg-type]
        yield time


def _clockwise(outline: Array) -> Array:
    """Return a closed outline in clockwise order, as seen; the first point stays."""
    u, v = outline.T
    area = u @ np.roll(v, -1) - v @ np.roll(u, -1)
    return outline if area > 0 else np.roll(outline[::-1], 1, axis=0)


def _inside(outline: Array, size: Size) -> npt.NDArray[np.bool_]:
    """Return whether the centre of each pixel is inside, ``(H, W)``, by counting crossings to its left.

    OpenCV's ``fillPoly`` also fills the border, which makes objects 0.15 px larger even with supersampling.
    """
    following = np.roll(outline, -1, axis=0)
    first, last = (np.ceil(end(outline[:, 1], following[:, 1])).astype(int) for end in (np.minimum, np.maximum))
    edge = np.repeat(np.arange(len(outline)), last - first)
    row = np.arange(len(edge)) - np.repeat(np.cumsum(last - first) - last, last - first)
    (u, v), (along_u, along_v) = outline[edge].T, (following - outline)[edge].T
    column = np.ceil(u + (row - v) / along_v * along_u).astype(int).clip(0, size[1])
    kept = (row >= 0) & (row < size[0])
    place = row[kept] * (size[1] + 1) + column[kept]
    crossings = np.bincount(place, minlength=size[0] * (size[1] + 1)).reshape(size[0], -1) & 1
    return np.logical_xor.accumulate(crossings.astype(bool), axis=1)[:, :-1]
