"""Draw scenes: ropes, rings and sheets over and under each other on a ground, their shadows, and what hides them.

All is drawn at twice the size of the photo and scaled down, as a camera averages over a pixel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, Final

import cv2
import numpy as np
from camera import photograph
from curves import HEIGHT, SHAPE, WIDTH, Array, Random, outline, resample, ring, rope, rotation, wrinkles
from grounds import ground
from materials import Strand, cloth, colour, from_hsv, strand
from scipy.ndimage import gaussian_filter1d

Box = tuple[slice, slice]  # rows and columns of the canvas
Ends = tuple[int, int]  # of a piece of a rope, in drawn pixels along it
Shadow = tuple[Array, float, float]  # its offset and blur, in drawn pixels, and how dark it is, 0...1
_FINE: Final = 2  # drawn pixels per pixel of the photo, along x and along y
_DRAWN: Final = (WIDTH * _FINE, HEIGHT * _FINE)
_SPACING: Final = 0.6  # drawn pixels between painted points: no holes on the outer side of tight bends


@dataclass
class Scene:
    """A photo and what it shows."""

    photo: Array  # (HEIGHT, WIDTH, 3) uint8, RGB
    whole: Array  # (HEIGHT, WIDTH) uint8, bit i: object i, with what ropes and rings hide of it, without the rest
    top: Array  # (HEIGHT, WIDTH) uint8, i + 1 where object i is seen
    kinds: list[str]  # "rope", "ring" or "sheet"


def draw_scene(rng: Random) -> Scene:
    """Draw a scene of one to six objects: mostly sheets and rings, or mostly ropes."""
    more, shares = (1.9, (0.92, 0.04, 0.04)) if rng.random() < 0.6 else (1.3, (0.1, 0.2, 0.7))
    kinds: list[str] = rng.choice(["rope", "ring", "sheet"], 1 + min(5, rng.poisson(more)), p=shares).tolist()
    canvas = _Canvas(ground(rng), rng.uniform(0, 1) * rotation(rng)[0])
    thickness, unlike = np.exp(rng.uniform(np.log(2.2), np.log(22))), rng.choice([1.2, 2])  # pixels, and a factor
    bases: list[Array] = []
    for label, kind in enumerate(kinds, 1):
        source, base = rng.random(), colour(rng)
        if bases and source < 0.42:  # of nearly the colour of another object
            base = bases[rng.integers(len(bases))] + rng.normal(0, rng.choice([0, 6, 15]), 3)
        elif source < 0.54:  # of that of the ground
            base = canvas.image[tuple(rng.integers(SHAPE))] * rng.uniform(0.5, 1.5) + rng.normal(0, 20, 3)
        bases.append(np.clip(base, 0, 255).astype(np.float32))
        width = float(np.clip(thickness * rng.uniform(1 / unlike, unlike), 2.2, 30))
        shape = outline(rng) if kind == "sheet" else ring(rng) if kind == "ring" else rope(rng, width)
        if kind == "sheet":
            _add_sheet(rng, canvas, shape * _FINE, bases[-1], label)
        else:
            _add_thin(rng, canvas, resample(shape * _FINE), width * _FINE, bases[-1], label, kind == "ring")
        if rng.random() < 0.15:
            _add_obstacle(rng, canvas, shape[rng.integers(len(shape))] * _FINE)
    for _, draw in sorted(canvas.jobs, key=lambda job: job[0]):
        draw()
    photo = photograph(rng, cv2.resize(canvas.image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA))
    whole, top = (cv2.medianBlur(each, 3)[::_FINE, ::_FINE].copy() for each in (canvas.whole, canvas.top))  # no specks
    return Scene(photo, whole, top, kinds)


class _Canvas:
    """What has been drawn, ``_FINE`` times the size of the photo, and what is still to be drawn."""

    def __init__(self, under: Array, light: Array) -> None:
        self.light = light  # (2,) direction of the light in the image, its length 0...1
        self.image = under.repeat(_FINE, 0).repeat(_FINE, 1)
        self.whole, self.top = np.zeros((2, *_DRAWN[::-1]), np.uint8)
        self.arc = np.zeros(_DRAWN[::-1], np.float32)  # place along the rope that is seen
        self.jobs: list[tuple[float, Callable[[], None]]] = []  # height, and what to draw there

    def plan(self, level: float, draw: Callable[..., None], *arguments: Any) -> None:
        self.jobs.append((level, partial(draw, *arguments)))

    def shade(self, box: Box, mask: Array, blur: float, darkness: float, spare: Array | bool = False) -> None:
        """Darken a part of the image where a mask, 0...255, is blurred to; not where ``spare`` is True."""
        dark = cv2.GaussianBlur(mask, (0, 0), blur) * np.float32(darkness / 255)
        self.image[box] *= np.where(spare, np.float32(1), 1 - dark)[..., None]

    def cover(self, box: Box, mask: Array, paint: Array, label: int) -> None:
        """Paint an opaque area. What it hides is no part of other objects."""
        self.image[box][mask > 0] = paint[mask > 0]
        self.whole[box][mask > 0], self.top[box][mask > 0] = 1 << label >> 1, label

    def thread(self, label: int, curve: Array, width: float, look: Strand, ends: Ends, shadow: Shadow) -> None:
        """Paint a piece of a rope, or of a stroke that is no object (0), and its shadow, but not on the next pieces."""
        (start, stop), (offset, blur, darkness) = ends, shadow
        fallen = (curve[start : stop + 1 : 3] + offset).round().astype(np.int32)
        box = _box(fallen, width + 3 * blur)
        near = np.abs(self.arc[box] - (start + stop) / 2) < (stop - start) / 2 + 2 * width
        mask = cv2.polylines(np.zeros_like(self.top), [fallen], False, 255, max(1, round(width)))[box]
        self.shade(box, mask, blur, darkness, near & (self.top[box] == label) & (label > 0))
        last, line = len(curve) - 1, curve @ [1, 1j]  # complex numbers: times 1j is a turn to the right
        tip = width / 2 * np.array([-(start == 0), stop == last])  # the ends are round
        at = np.arange(start + tip[0], stop + tip[1] + _SPACING, _SPACING)  # (S,)
        across = np.linspace(-1, 1, max(4, int(width / _SPACING)))  # (V,)
        along = np.gradient(gaussian_filter1d(line, 2.0))
        middle, along = (np.interp(at, np.arange(last + 1), each) for each in (line, along / np.abs(along)))
        beyond = (at - np.clip(at, 0, last))[:, None]  # the ends, (S, 1)
        pixels = middle[:, None] + along[:, None] * (beyond + 1j * width / 2 * across)  # (S, V)
        column, row = np.floor([pixels.real + 0.5, pixels.imag + 0.5]).astype(int)
        shown = (column >= 0) & (row >= 0) & (column < _DRAWN[0]) & (row < _DRAWN[1])
        s, v = np.nonzero(shown & ((2 * beyond / width) ** 2 + across**2 <= 1))
        place, lit = (row[s, v], column[s, v]), (1j * along * (self.light @ [1, -1j])).real
        arc, right, lit = np.stack([at[s], across[v], lit[s]]).astype(np.float32)
        self.image[place], self.arc[place] = look(arc / width, right, lit), arc
        self.whole[place] = self.whole[place] | np.uint8(1 << label >> 1) if label else 0
        self.top[place] = label


def _box(points: Array, margin: float) -> Box:
    """Return the part of the canvas with some points and a margin around them."""
    low = np.clip(points.min(0) - margin, 0, np.subtract(_DRAWN, 8)).astype(int)
    high = np.clip(points.max(0) + margin, low + 8, _DRAWN).astype(int)
    return np.s_[low[1] : high[1], low[0] : high[0]]


def _add_thin(rng: Random, canvas: _Canvas, points: Array, width: float, base: Array, label: int, closed: bool) -> None:
    """Plan the drawing of a rope or ring in pieces of different heights, and of what is fixed to its ends."""
    look = strand(rng, base)
    cuts = np.unique([0, *rng.integers(0, len(points), max(0, rng.integers(-1, 6))), len(points) - 1]).tolist()
    level, mixed = (label - 1) * 0.4 * (rng.random() < 0.5), 1 if rng.random() < 0.7 else 0.01
    height = rng.choice([0.25, 0.25, 1])  # over the ground: far shadows are soft
    shadow = rng.normal(0, height, 2) * width, rng.uniform(1, 5) * 4 * height, max(0, rng.uniform(-0.5, 0.7))
    for ends in pairwise(cuts):
        canvas.plan(level + rng.random() * mixed, canvas.thread, label, points, width, look, ends, shadow)
    for end in (points, points[::-1]) if not closed and rng.random() < 0.3 else ():  # plugs, ferrules, bare metal
        tip = end[0] + (end[0] - end[7]) / 7 * rng.uniform(0.2, 3.5) * width
        fitting = resample(np.concatenate([[tip], end[: int(rng.uniform(0.3, 2.5) * width) + 3]]))
        plug = fitting, width * rng.uniform(0.45, 1.7), strand(rng, colour(rng)), (0, len(fitting) - 1)
        canvas.plan(level + 1.1, canvas.thread, 0, *plug, shadow)


def _add_sheet(rng: Random, canvas: _Canvas, edge: Array, base: Array, label: int) -> None:
    """Plan the drawing of a sheet or garment, with a part that is folded over the rest at times."""
    box, scale, parts = _box(edge, 16), float(np.sqrt(np.prod(np.ptp(edge, 0)))) / _FINE, [edge]
    if rng.random() < 0.4:  # what lies beyond a line is mirrored in it
        normal = rotation(rng)[0]
        beyond = (edge @ normal - np.quantile(edge @ normal, rng.uniform(0.6, 0.95)))[:, None]
        parts = [edge - np.maximum(beyond, 0) * normal, edge - np.maximum(beyond, 2 * beyond) * normal]
    drawn = canvas.top[box].shape
    coarse = drawn[0] // _FINE, drawn[1] // _FINE
    paint = cloth(rng, base, coarse, scale) * wrinkles(rng, coarse, scale)[..., None]
    paint, level = cv2.resize(paint.astype(np.float32), drawn[::-1]), (label - 1) * 0.6 + rng.random()
    for part in parts:
        filled = cv2.fillPoly(np.zeros_like(canvas.top), [part.round().astype(np.int32)], 255)
        mask = cv2.morphologyEx(filled[box], cv2.MORPH_OPEN, np.ones((3, 3)))  # no spikes where it is folded
        edge_shade = rng.uniform(0, 0.4) * np.exp(cv2.distanceTransform(mask, cv2.DIST_L2, 3) / -rng.uniform(1, 6))
        fallen = np.roll(mask, rng.normal(0, 3, 2).astype(int), (1, 0))
        canvas.plan(level, canvas.shade, box, fallen, rng.uniform(1, 5), max(0, rng.uniform(-0.3, 0.6)))
        canvas.plan(level, canvas.cover, box, mask, np.clip(paint * (1 - edge_shade)[..., None], 0, 255), label)
        back = paint + (colour(rng) - paint) * max(0, rng.uniform(-0.6, 0.6))  # of another colour at times
        paint = (back * rng.uniform(0.75, 1.2)).astype(np.float32)


def _add_obstacle(rng: Random, canvas: _Canvas, at: Array) -> None:
    """Plan the drawing of a clip, a tool, a gripper or a hand at a place: thick strokes, some below the objects."""
    size, (ahead, across) = rng.uniform(28, 60), rotation(rng)
    look = strand(rng, from_hsv(rng, (0.2, 0.6), (0.25, 0.92), (0.03, 0.1)) if rng.random() < 0.4 else colour(rng))
    long, fingers = ((15, 5), (15, 2), (15, 0), (0.5, 0))[rng.choice(4)]
    wrist = at - rng.uniform(-0.5, 2.5) * size * ahead
    strokes = [(wrist, wrist - long * size * ahead, rng.uniform(0.3, 1.8))]
    for spread in np.linspace(-0.7, 0.7, fingers):
        knuckle = wrist + size * spread * across
        tip = knuckle + size * rng.uniform(0.7, 2) * (ahead + rng.uniform(-0.2, 0.3) * spread * across)
        strokes.append((knuckle, tip, 0.4))
    for start, end, thick in strokes:
        line, level = resample(np.array([start, end])), rng.choice([-1, 5], p=[0.2, 0.8])
        canvas.plan(level, canvas.thread, 0, line, thick * size, look, (0, len(line) - 1), (np.zeros(2), 8, 0.3))
