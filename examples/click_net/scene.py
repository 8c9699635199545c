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
from curves import HEIGHT, SHAPE, SIZE, WIDTH, Array, Random, direction, noise, outline, resample, ring, rope, wrinkles
from grounds import ground
from materials import Strand, brown, cloth, colour, strand

Box = tuple[slice, slice]  # rows and columns of the canvas
_FINE: Final = 2  # drawn pixels per pixel of the photo, along x and along y
_DRAWN: Final = (WIDTH * _FINE, HEIGHT * _FINE)
_ALL: Final = np.s_[:, :]  # the whole picture
_SPACING: Final = 0.6  # drawn pixels between painted points: no holes on the outer side of tight bends


@dataclass
class Scene:
    """A photo and what it shows."""

    photo: Array  # (HEIGHT, WIDTH, 3) uint8, RGB
    whole: Array  # (HEIGHT, WIDTH) uint8, bit i: object i, with what ropes and rings hide of it, without the rest
    top: Array  # (HEIGHT, WIDTH) uint8, i + 1 where object i is seen
    kinds: list[str]  # "rope", "ring" or "sheet"


class _Canvas:
    """What has been drawn, ``_FINE`` times the size of the photo, and what is still to be drawn."""

    def __init__(self, under: Array, light: Array) -> None:
        self.light = light  # (2,) direction of the light in the image, its length 0...1
        self.image = under.repeat(_FINE, 0).repeat(_FINE, 1)
        self.whole, self.top = np.zeros((2, *_DRAWN[::-1]), np.uint8)
        self.arc = np.zeros(_DRAWN[::-1], np.float32)  # place along the rope that is seen
        self.jobs: list[tuple[float, Callable[[], None]]] = []  # height, and what to draw there

    def plan(self, level: float, draw: Callable[..., None], *arguments: Any) -> None:
        """Draw something later, after all that is lower."""
        self.jobs.append((level, partial(draw, *arguments)))

    def shade(self, box: Box, mask: Array, blur: float, darkness: float, spare: Array | bool = False) -> None:
        """Darken a part of the image where a mask, 0...255, is blurred to; not where ``spare`` is True."""
        dark = cv2.GaussianBlur(mask, (0, 0), blur) * np.float32(darkness / 255)
        self.image[box] *= np.where(spare, np.float32(1), 1 - dark)[..., None]

    def cover(self, box: Box, mask: Array, paint: Array, label: int) -> None:
        """Paint an opaque area. What it hides is no part of other objects."""
        self.image[box][mask > 0] = paint[mask > 0]
        self.whole[box][mask > 0], self.top[box][mask > 0] = 1 << label >> 1, label


@dataclass
class _Thin:
    """A rope, a band, a ring of it, or what is fixed to its end."""

    label: int  # as in ``Scene.top``, 0 for what is no object
    curve: Array  # (N, 2) drawn pixels, at steps of one
    width: Array  # (N,) drawn pixels
    strand: Strand
    blunt: bool  # no round ends

    def draw(self, canvas: _Canvas, start: int, stop: int) -> None:
        """Paint the points ``start`` to ``stop`` of the curve."""
        last, mean = len(self.curve) - 1, float(self.width.mean())
        tip = 0 if self.blunt else mean / 2
        at = np.arange(start - tip * (start == 0), stop + tip * (stop == last) + _SPACING, _SPACING)  # (S,)
        along = np.gradient(cv2.GaussianBlur(self.curve, (1, 9), 1e-3, sigmaY=2.0), axis=0)
        along /= np.maximum(np.hypot(*along.T), 1e-6)[:, None]
        columns = np.column_stack([self.curve, along, self.width]).T
        x, y, along_x, along_y, width = (np.interp(at, np.arange(last + 1), column) for column in columns)
        beyond = at - np.clip(at, 0, last)  # the ends, (S,)
        across = np.linspace(-1, 1, max(4, int(width.max() / _SPACING)))  # (V,)
        side = across * (width / 2)[:, None]  # (S, V)
        column = ((x + along_x * beyond)[:, None] - along_y[:, None] * side + 0.5).astype(np.int32)
        row = ((y + along_y * beyond)[:, None] + along_x[:, None] * side + 0.5).astype(np.int32)
        shown = (column >= 0) & (row >= 0) & (column < _DRAWN[0]) & (row < _DRAWN[1])
        s, v = np.nonzero(shown & ((2 * beyond / width)[:, None] ** 2 + across**2 <= 1))
        place, light = (row[s, v], column[s, v]), canvas.light @ np.stack([-along_y, along_x])
        arc, right, lit = np.stack([at[s], across[v], light[s]]).astype(np.float32)
        canvas.image[place], canvas.arc[place] = self.strand(arc / mean, right, lit), arc
        canvas.whole[place] = canvas.whole[place] | np.uint8(1 << self.label >> 1) if self.label else 0
        canvas.top[place] = self.label

    def place(self, canvas: _Canvas, start: int, stop: int, offset: Array, blur: float, darkness: float) -> None:
        """Paint a piece and, before it, its shadow on what lies below, not on the adjacent pieces."""
        points, width = self.curve[start : stop + 1 : 3] + offset, float(self.width.mean())
        low = np.clip(points.min(0) - width - 3 * blur, 0, _DRAWN).astype(int)
        high = np.clip(points.max(0) + width + 3 * blur, 0, _DRAWN).astype(int)
        if (high - low > 3).all():
            box = np.s_[low[1] : high[1], low[0] : high[0]]
            mask = _stroke(np.zeros((high - low)[::-1], np.uint8), points - low, width)
            near = np.abs(canvas.arc[box] - (start + stop) / 2) < (stop - start) / 2 + 2 * width
            canvas.shade(box, mask, blur, darkness, near & (canvas.top[box] == self.label))
        self.draw(canvas, start, stop)


def _stroke(mask: Array, points: Array, width: float) -> Array:
    sixteenths = np.round(points * 16).astype(np.int32)
    return cv2.polylines(mask, [sixteenths], False, 255, max(1, round(width)), cv2.LINE_8, 4)


def draw_scene(rng: Random) -> Scene:
    """Draw a scene of one to six objects: mostly sheets and rings, or mostly ropes."""
    if rng.random() < 0.4:
        counts, shares = (0.3, 0.34, 0.2, 0.1, 0.04, 0.02), (0.1, 0.2, 0.7)
    else:
        counts, shares = (0.12, 0.27, 0.27, 0.17, 0.1, 0.07), (0.92, 0.04, 0.04)
    count = 1 + int(rng.choice(6, p=counts))
    kinds: list[str] = rng.choice(["rope", "ring", "sheet"], count, p=shares).tolist()
    width = np.exp(rng.uniform(np.log(2.2), np.log(18))) if rng.random() < 0.93 else rng.uniform(18, 30)  # pixels
    widths = width * (rng.uniform(0.8, 1.2, count) if rng.random() < 0.7 else rng.uniform(0.5, 2, count))
    widths = np.clip(widths, 2.2, 30).tolist()
    shapes = [
        outline(rng) if kind == "sheet" else ring(rng) if kind == "ring" else rope(rng, own)
        for kind, own in zip(kinds, widths, strict=True)
    ]
    canvas = _Canvas(ground(rng), rng.uniform(0, 1) * np.array(direction(rng)))
    bases: list[Array] = []
    for label, (kind, own, shape) in enumerate(zip(kinds, widths, shapes, strict=True), 1):
        bases.append(_base(rng, bases, canvas.image))
        if kind == "sheet":
            _add_sheet(rng, canvas, shape, bases[-1], label)
        else:
            _add_thin(rng, canvas, shape, own, bases[-1], label, kind == "ring")
    for _ in range(rng.integers(1, 3) if rng.random() < 0.3 else 0):
        _add_obstacle(rng, canvas, shapes[rng.integers(count)])
    for _, draw in sorted(canvas.jobs, key=lambda job: job[0]):
        draw()
    return _finished(rng, canvas, kinds)


def _base(rng: Random, bases: list[Array], under: Array) -> Array:
    """Draw the colour of the next object: as of one before, as of the ground, or any."""
    kind, like = rng.random(), colour(rng)
    if bases and kind < 0.42:
        like = bases[rng.integers(len(bases))] + rng.normal(0, rng.choice([0, 6, 15]), 3)
    elif kind < 0.54:
        like = under[tuple(rng.integers(under.shape[:2]))] * rng.uniform(0.5, 1.5) + rng.normal(0, 20, 3)
    return np.clip(like, 0, 255).astype(np.float32)


def _finished(rng: Random, canvas: _Canvas, kinds: list[str]) -> Scene:
    """Scale the canvas down and take the photo."""
    if rng.random() < 0.15:  # the shadow of what stands outside the photo
        corners = (rng.random(2) * _DRAWN + rng.normal(0, 160, (5, 2))).astype(np.int32)
        mask = cv2.fillConvexPoly(np.zeros(_DRAWN[::-1], np.uint8), cv2.convexHull(corners), 255)
        canvas.shade(_ALL, mask, rng.uniform(2, 20), rng.uniform(0.1, 0.55))
    photo = photograph(rng, cv2.resize(canvas.image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA))
    whole, top = np.zeros(SHAPE, np.uint8), canvas.top[::_FINE, ::_FINE].copy()
    for index in range(len(kinds)):
        share = cv2.resize((canvas.whole >> index & 1) * np.uint8(255), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
        whole |= (share > 127).astype(np.uint8) << index
        top[(top == index + 1) & (share <= 127)] = 0
    return Scene(photo, whole, top, kinds)


def _add_thin(rng: Random, canvas: _Canvas, curve: Array, width: float, base: Array, label: int, closed: bool) -> None:
    """Plan the drawing of a rope or ring in pieces of different heights, and of what is fixed to its ends."""
    points, flat = resample(curve * _FINE), rng.random() < (0.4 if closed else 0.1)
    width = _FINE * (min(30.0, width * rng.uniform(1, 2.5)) if flat and not closed else width)
    swing = rng.uniform(0.75, 1.25, 4) if rng.random() < 0.35 else np.ones(4)
    swing[-1] = swing[0] if closed else swing[-1]
    widths = width * np.interp(np.linspace(0, 3, len(points)), range(4), swing)
    thin = _Thin(label, points, widths, strand(rng, base, flat), blunt=closed)
    cuts = np.unique([0, *rng.integers(0, len(points), max(0, rng.integers(-1, 6))), len(points) - 1]).tolist()
    level, mixed = (label - 1) * 0.4 * (rng.random() < 0.5), 1 if rng.random() < 0.7 else 0.01
    height = rng.choice([0.25, 0.25, 1])  # over the ground: far shadows are soft
    shadow = rng.normal(0, height, 2) * width, rng.uniform(1, 5) * 4 * height, max(0, rng.uniform(-0.5, 0.7))
    for start, stop in pairwise(cuts):
        canvas.plan(level + rng.random() * mixed, thin.place, canvas, start, stop, *shadow)
    for end in (points, points[::-1]) if not closed and rng.random() < 0.3 else ():  # plugs, ferrules, bare metal
        outwards = end[0] - end[min(len(end) - 1, 8)]
        tip = end[0] + outwards / max(float(np.hypot(*outwards)), 1e-6) * rng.uniform(0.2, 3.5) * width
        fitting = resample(np.concatenate([[tip], end[: int(rng.uniform(0.3, 2.5) * width) + 3]]))
        metal = strand(rng, colour(rng), flat=rng.random() < 0.5)
        plug = _Thin(0, fitting, np.full(len(fitting), width * rng.uniform(0.45, 1.7)), metal, blunt=True)
        canvas.plan(level + 1.1, plug.draw, canvas, 0, len(fitting) - 1)


def _add_sheet(rng: Random, canvas: _Canvas, edge: Array, base: Array, label: int) -> None:
    """Plan the drawing of a sheet or garment: its cloth, wrinkles, seam, and a part that is folded over."""
    low = np.clip(edge.min(0) - 8, 0, SIZE - 8).astype(int)
    wide, high = (np.clip(edge.max(0) + 8, low + 8, SIZE).astype(int) - low).tolist()
    box = np.s_[low[1] * _FINE : (low[1] + high) * _FINE, low[0] * _FINE : (low[0] + wide) * _FINE]
    scale, local = float(np.sqrt(np.prod(np.ptp(edge, 0)))), (edge - low) * _FINE
    mask = cv2.fillPoly(np.zeros_like(canvas.top[box]), [np.round(local).astype(np.int32)], 255)
    if rng.random() < 0.08:  # a hole in the middle
        hole = local.mean(0) + (local - local.mean(0)) * rng.uniform(0.25, 0.7)
        cv2.fillPoly(mask, [np.round(hole).astype(np.int32)], 0)
    paint = cloth(rng, base, (high, wide), scale) * wrinkles(rng, (high, wide), scale)[..., None]
    paint = cv2.resize(paint.astype(np.float32), mask.shape[::-1], interpolation=cv2.INTER_LINEAR)
    inwards = cv2.distanceTransform(mask, cv2.DIST_L2, 3)
    paint *= (1 - rng.uniform(0, 0.4) * np.exp(-inwards / rng.uniform(1, 6)))[..., None]
    if rng.random() < 0.4:  # a seam along the edge
        paint[np.abs(inwards - rng.uniform(3, 14)) < 0.8] *= rng.uniform(0.6, 1.2)
    if rng.random() < 0.4:
        paint, mask = _folded(rng, paint, mask, local)
    fallen, level = np.roll(mask, rng.normal(0, 3, 2).astype(int), (1, 0)), (label - 1) * 0.6 + rng.random()
    canvas.plan(level, canvas.shade, box, fallen, rng.uniform(1, 5), max(0, rng.uniform(-0.3, 0.6)))
    canvas.plan(level, canvas.cover, box, mask, np.clip(paint, 0, 255), label)


def _folded(rng: Random, paint: Array, mask: Array, edge: Array) -> tuple[Array, Array]:
    """Fold the part of a sheet beyond a line over the rest; returns its picture and mask."""
    normal, size = np.array(direction(rng)), mask.shape[::-1]
    at = np.quantile(edge @ normal, rng.uniform(0.6, 0.95))
    y, x = np.mgrid[0 : mask.shape[0], 0 : mask.shape[1]].astype(np.float32)
    beyond = x * float(normal[0]) + y * float(normal[1]) - float(at)
    mirror = np.concatenate([np.eye(2) - 2 * np.outer(normal, normal), 2 * at * normal[:, None]], 1)
    flap = cv2.warpAffine(np.where(beyond > 0, mask, np.uint8(0)), mirror, size, flags=cv2.INTER_NEAREST)
    back, side = cv2.warpAffine(paint, mirror, size), max(0, rng.uniform(-0.6, 0.6))  # how much its colour differs
    bend = 1 - rng.uniform(0, 0.35) * np.exp(np.minimum(beyond, 0) / rng.uniform(3, 15))
    back = (back + (colour(rng) - back) * side) * (rng.uniform(0.75, 1.2) * bend)[..., None]
    shadow = cv2.GaussianBlur(flap, (0, 0), rng.uniform(1, 6)) * np.float32(rng.uniform(0.1, 0.6) / 255)
    picture = np.where((flap > 0)[..., None], back, paint * (1 - shadow)[..., None])
    return picture, np.where(beyond > 0, flap, np.maximum(mask, flap))


def _add_obstacle(rng: Random, canvas: _Canvas, near: Array) -> None:
    """Plan the drawing of a hand, a gripper or a tool at a point of an object, of thick strokes."""
    at, (cosine, sine), size = near[rng.integers(len(near))] + rng.normal(0, 6, 2), direction(rng), rng.uniform(14, 30)
    ahead, across = size * np.array([cosine, sine]), size * np.array([-sine, cosine])
    paint, fingers = brown(rng) if rng.random() < 0.4 else colour(rng), rng.choice([0, 2, 5], p=[0.3, 0.3, 0.4])
    if fingers:
        wrist = at - 2.5 * ahead
        strokes = [(wrist - 30 * ahead, wrist, 1.6 * size), (wrist, wrist + 0.3 * ahead, 2 * size)]
        for spread in np.linspace(-1, 1, fingers) * rng.uniform(0.3, 1) + rng.normal(0, 0.1, fingers):
            knuckle = wrist + 0.9 * ahead + spread * across
            tip = knuckle + rng.uniform(0.7, 2) * ahead + 0.3 * spread * across
            strokes.append((knuckle, tip, size * rng.uniform(0.36, 0.5)))
    else:
        strokes = [(at, at + ahead * rng.exponential(0.7), rng.uniform(4, 40))]
    below, over = np.zeros((2, *SHAPE), np.uint8)
    rounding = rng.uniform(2, 12)
    for start, end, thick in strokes:
        _stroke(below if rng.random() < 0.2 else over, np.array([start, end]), thick)
    for level, part in ((-1, below), (rng.uniform(1, 5), over)):
        shade = 0.6 + 0.4 * np.clip(cv2.distanceTransform(part, cv2.DIST_L2, 3) / rounding, 0, 1)
        shade += 0.06 * noise(rng, SHAPE, 25, octaves=2)
        picture = cv2.resize(np.clip(paint * shade[..., None], 0, 255).astype(np.float32), _DRAWN)
        mask = np.where(cv2.resize(part, _DRAWN) > 127, np.uint8(255), np.uint8(0))
        canvas.plan(level, canvas.shade, _ALL, mask, 4, 0.3)
        canvas.plan(level, canvas.cover, _ALL, mask, picture, 0)
