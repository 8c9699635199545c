"""Draw blobs and garments with a known outline, at rest and moving."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal, get_args

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.outline import clockwise
from shape_obs.utils.documents import read_json
from tests.benchmarks.scenes.ropes import SIZE, resample, rotation

Array = npt.NDArray[np.float64]
Kind = Literal["smooth", "c", "horseshoe", "star"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)
_MARGIN: Final = 8.0
_ANGLES: Final = 2 * np.pi * np.arange(1440) / 1440


@dataclass(frozen=True)
class Blob:
    """A drawn blob.

    Args:
        outline: ``(P, 2)`` pixels, closed, clockwise as seen; point i of a moving blob stays the same material point.
        mask: ``(H, W)`` uint8, 0 or 255.
        kind: How the outline was made.
        hole: The outline of the hole in the same form, ``(Q, 2)`` pixels; None without a hole.
        corners: Visible annotated keypoints of a garment: name -> (u, v).
    """

    outline: Array
    mask: npt.NDArray[np.uint8]
    kind: str
    hole: Array | None = None
    corners: dict[str, Array] = field(default_factory=dict)


def random_blob(rng: np.random.Generator, kind: Kind = "smooth", size: tuple[int, int] = SIZE) -> Blob:
    """Draw a blob with rounded corners inside an image of ``size`` ``(H, W)``."""
    for _ in range(2000):
        outline = _MAKERS[kind](rng) @ rotation(rng.uniform(0, 2 * np.pi)).T
        low, high = outline.min(axis=0), outline.max(axis=0)
        room = np.array([size[1], size[0]]) - 2 * _MARGIN - (high - low)
        if np.all(room >= 0):
            return draw_blob(outline - low + _MARGIN + room * rng.uniform(size=2), size=size, kind=kind)
    raise RuntimeError(f"no {kind} blob found that fits {size[1]} x {size[0]} pixels.")


def draw_blob(outline: Array, hole: Array | None = None, *, size: tuple[int, int] = SIZE, kind: str = "given") -> Blob:
    """Fill a closed outline of ``(P, 2)`` pixels, except a hole: a pixel is inside if its centre is."""
    inside = _inside(outline, size)
    if hole is not None:
        inside &= ~_inside(hole, size)
    mask = np.where(inside, np.uint8(255), np.uint8(0))
    return Blob(_clockwise(outline), mask, kind, None if hole is None else _clockwise(hole))


def _clockwise(outline: Array) -> Array:
    return outline if clockwise(outline) else np.roll(outline[::-1], 1, axis=0)


def garments(path: str | Path, size: tuple[int, int] = SIZE) -> Iterator[Blob]:
    """Draw annotated garment outlines into images of ``size`` ``(H, W)``.

    Args:
        path: A JSON list of ``{kind, width, height, polygon: [[u, v], ...], keypoints: {name: [u, v, hidden]}}``.
        size: Size of the image in pixels; the annotated photo is shrunk to fit.
    """
    for item in read_json(path, "outlines"):
        scale = min(size[1] / item["width"], size[0] / item["height"])
        blob = draw_blob((np.array(item["polygon"]) + 0.5) * scale - 0.5, size=size, kind=item["kind"])
        for name, (u, v, hidden) in item["keypoints"].items():
            if not hidden:
                blob.corners[name] = (np.array([u, v]) + 0.5) * scale - 0.5
        yield blob


def moving_blob(
    rng: np.random.Generator,
    *,
    turn: float = 0.08,
    speed: float = 0.0,
    swell: float = 0.0,
    bumps: float = 0.15,
    hole: bool = False,
    radius: float = 100.0,
    size: tuple[int, int] = SIZE,
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
    waves, inner = _waves(rng, bumps), _waves(rng, bumps)
    pace, begin = 2 * np.pi / rng.uniform(60, 120, 3), rng.uniform(0, 2 * np.pi, 3)
    around = radius if speed else 0.0
    for i in range(frames):
        at = i * speed / max(around, 1e-9)
        centre = middle + around * np.array([np.cos(at), np.sin(at)])
        swollen = np.stack([1 + swell * np.sin(pace * i + begin), np.ones(3)], axis=1)
        outline = radius * _radial(waves * swollen) @ rotation(i * turn).T + centre
        inside = 0.45 * radius * _radial(inner * swollen) @ rotation(i * turn).T + centre if hole else None
        yield draw_blob(outline, inside, kind="moving", size=size)


def _inside(outline: Array, size: tuple[int, int]) -> npt.NDArray[np.bool_]:
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


def _waves(rng: np.random.Generator, size: float) -> Array:
    """Draw amplitudes and phases of the second to the fourth wave around a circle, ``(3, 2)``."""
    return np.stack([size * rng.uniform(0.5, 1, 3) / np.array([1, 1.5, 2]), rng.uniform(0, 2 * np.pi, 3)], axis=1)


def _radial(waves: Array) -> Array:
    """Return a circle of radius 1 with waves, (1440, 2)."""
    radius = 1 + sum(size * np.cos((k + 2) * _ANGLES + phase) for k, (size, phase) in enumerate(waves))
    return np.asarray(radius)[:, None] * np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)


def _smooth(rng: np.random.Generator) -> Array:
    return rng.uniform(50, 150) * _radial(_waves(rng, rng.uniform(0.05, 0.25)))


def _star(rng: np.random.Generator) -> Array:
    tips, depth = rng.integers(3, 8), rng.uniform(0.15, 0.35)
    radius = rng.uniform(90, 150) * (1 + depth * np.cos(tips * _ANGLES))
    return radius[:, None] * np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)


def _c(rng: np.random.Generator) -> Array:
    radius, opening = rng.uniform(70, 130), rng.uniform(0.5, 2.0)
    angle = np.linspace(opening / 2, 2 * np.pi - opening / 2, 400)
    return _thick(radius * np.stack([np.cos(angle), np.sin(angle)], axis=1), radius * rng.uniform(0.2, 0.5))


def _horseshoe(rng: np.random.Generator) -> Array:
    radius, leg = rng.uniform(50, 100), rng.uniform(60, 160)
    angle = np.linspace(np.pi, 2 * np.pi, 200)
    bow = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    line = np.concatenate([[[-radius, leg]], bow, [[radius, leg * rng.uniform(0.6, 1)]]])
    return _thick(resample(line, 1.0), radius * rng.uniform(0.2, 0.7))


def _thick(line: Array, width: float) -> Array:
    """Return the outline of a ribbon with round ends about a line of ``(P, 2)``."""
    along = np.gradient(line, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = width / 2 * np.stack([-along[:, 1], along[:, 0]], axis=1)
    half = np.linspace(0, np.pi, 60)[1:-1, None]
    last = line[-1] + np.cos(half) * side[-1] + np.sin(half) * width / 2 * along[-1]
    first = line[0] - np.cos(half) * side[0] - np.sin(half) * width / 2 * along[0]
    return np.concatenate([line + side, last, (line - side)[::-1], first])


_MAKERS: Final = dict(zip(KINDS, (_smooth, _c, _horseshoe, _star), strict=True))
