"""Draw photos of one object among others, and its mask: ropes, wires, cloths and rings in the light of a room.

What makes real photos hard is in them: textured grounds, other objects of similar colours, shadows that end sharply,
light that falls off, highlights, a white balance that is off, noise, and the colours that a JPEG file smears.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal, get_args

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import SIZE
from tests.benchmarks.scenes.layouts import Table, lay_ropes
from tests.benchmarks.scenes.ropes import normals
from tests.benchmarks.scenes.several_ropes import Array, Field, Relief, lifts, relief, shifted, unit

Kind = Literal["rope", "wire", "harness", "cloth", "ring"]
Ground = Literal["plain", "cloth", "wood", "concrete", "mat", "checks", "clutter"]
KINDS: Final = get_args(Kind)
GROUNDS: Final = get_args(Ground)
_GAMMA: Final = 2.2
_APART: Final = 22.0  # least distance of an object's colour from the ground, and from the others, in Lab
_SIMILAR: Final = 16.0  # the same for objects of similar colours


@dataclass(frozen=True)
class ObjectPhoto:
    """A drawn photo."""

    rgb: npt.NDArray[np.uint8]  # (H, W, 3) uint8
    mask: npt.NDArray[np.bool_]  # (H, W) bool, where the object covers more than half of a pixel
    kind: Kind  # what the object is
    ground: Ground  # what it lies on
    similar: bool  # whether another object has a similar colour


def object_photos(count: int, seed: int) -> Iterator[ObjectPhoto]:
    """Yield ``count`` photos that go through all kinds of objects and grounds."""
    pairs = [(kind, ground) for ground in GROUNDS for kind in KINDS]
    for k in range(count):
        yield object_photo(np.random.default_rng([seed, k]), *pairs[k % len(pairs)])


def object_photo(rng: np.random.Generator, kind: Kind, ground: Ground) -> ObjectPhoto:
    """Draw a photo of 640 x 480 pixels.

    Args:
        rng: Draws everything.
        kind: What the object is.
        ground: What it lies on.
    """
    light = unit(np.array([*rng.uniform(-0.7, 0.7, 2), 1.0]))
    surface = {"harness": _harness, "cloth": _flat, "ring": _flat}.get(kind, _strands)(rng, kind, light)
    under = _ground(rng, ground, surface.owner.shape)
    seen = cv2.resize((surface.owner == 0).astype(np.float32), SIZE[::-1], interpolation=cv2.INTER_AREA)
    similar = bool(rng.random() < 0.3)
    colours = _colours(rng, int(surface.owner.max()) + 1, under[::8, ::8].reshape(-1, 3), similar=similar)
    scene, on = under.copy(), surface.owner >= 0
    fibre = rng.normal(0, 1, (surface.owner.shape[0] // 3, surface.owner.shape[1] // 3)).astype(np.float32)
    weave = 1 + rng.uniform(0, 0.12) * cv2.resize(fibre, surface.owner.shape[::-1])
    scene[on] = colours[surface.owner[on]] * weave[on, None]
    return ObjectPhoto(
        _photographed(rng, surface, scene, light), seen > 0.5, kind, ground, similar and len(colours) > 1
    )


def _strands(rng: np.random.Generator, kind: Kind, light: Array) -> Relief:
    """Return one to five ropes or wires that cross; the first is the object."""
    laid, thick, count = None, 0.0, 0
    while laid is None:
        thick, most = (float(rng.uniform(9, 24)), 4) if kind == "rope" else (float(rng.uniform(3.5, 9)), 6)
        count = int(rng.integers(1, most))
        crossings = int(rng.integers(0, 2 * count))
        laid = lay_ropes(rng, count, crossings, Table(SIZE, thick, 0.4, np.deg2rad(20)))
    curves, found = laid
    above = rng.integers(2, size=len(found)).astype(bool).tolist()
    return relief(curves, [thick] * count, lifts(curves, found, above, thick), SIZE, light)


def _harness(rng: np.random.Generator, kind: Kind, light: Array) -> Relief:
    """Return three to seven wires that run side by side and fan out at both ends."""
    laid, thick = None, 0.0
    while laid is None:
        thick = float(rng.uniform(3.5, 7))
        laid = lay_ropes(rng, 1, 0, Table(SIZE, 4 * thick, 0.3, np.deg2rad(20), 4.0))
    axis, curves = laid[0][0], []
    normal, share = normals(axis), np.linspace(0, 1, len(axis))
    count = int(rng.integers(3, 8))
    for place in rng.permutation(count) - (count - 1) / 2:
        fan = sum(rng.uniform(0.5, 3) * np.clip(np.abs(share - end) * -5 + 1, 0, 1) ** 2 for end in (0, 1))
        offset = place * thick * (rng.uniform(0.95, 1.15) + fan)
        sway = 0.25 * thick * np.sin(share * rng.uniform(4, 14) + rng.uniform(0, 6))
        curves.append(axis + (offset + sway)[:, None] * normal)
    return relief(curves, [thick] * count, [np.zeros(len(axis))] * count, SIZE, light)


def _flat(rng: np.random.Generator, kind: Kind, light: Array) -> Relief:
    """Return a cloth with folds or a closed band, and sometimes a second one of another place."""
    surface = Relief.empty(SIZE)
    rows, columns = surface.owner.shape
    for owner in range(int(rng.integers(1, 3)) - 1, -1, -1):
        around = np.linspace(0, 2 * np.pi, 200, endpoint=False)
        reach = np.full(200, rng.uniform(0.16, 0.34) * rows * (1 - 0.3 * owner))
        if kind == "cloth":
            reach /= np.maximum(np.abs(np.cos(around)), np.abs(np.sin(around)) * rng.uniform(0.8, 1.6))
        reach *= 1 + sum(rng.uniform(0, 0.06) * np.cos(k * around + rng.uniform(0, 6)) for k in (2, 3, 4))
        turned = around + rng.uniform(0, 2 * np.pi)
        middle = rng.uniform((0.35, 0.35), (0.65, 0.65)) * (columns, rows)
        outline = reach[:, None] * np.stack([np.cos(turned), np.sin(turned)], axis=1)
        shape = np.zeros((rows, columns), np.uint8)
        cv2.fillPoly(shape, [np.round(middle + outline).astype(np.int32)], (1,))
        if kind == "ring":
            cv2.fillPoly(shape, [np.round(middle + outline * rng.uniform(0.65, 0.85)).astype(np.int32)], (0,))
        folds = cv2.resize(rng.normal(0, 1, (6, 8)).astype(np.float32), (columns, rows), interpolation=cv2.INTER_CUBIC)
        slope = cv2.Sobel(folds, cv2.CV_32F, 1, 0) * light[0] + cv2.Sobel(folds, cv2.CV_32F, 0, 1) * light[1]
        on = shape > 0
        surface.shade[on] = np.clip(0.85 + rng.uniform(2, 9) * slope, 0.3, 1.15)[on]
        surface.height[on], surface.owner[on] = 6.0, owner
    return surface


def _lab(rgb: npt.NDArray[np.floating]) -> Array:
    """Return CIE Lab of ``(K, 3)`` sRGB values of 0 to 255."""
    return np.asarray(cv2.cvtColor((rgb[None] / 255).astype(np.float32), cv2.COLOR_RGB2LAB)[0], np.float64)


def _colours(rng: np.random.Generator, count: int, ground: Field, *, similar: bool) -> Field:
    """Return RGB of each object; the first stands out from most of the ground, as an object that is looked for does."""
    under = _lab(ground)
    while True:
        first = rng.uniform(15, 245, 3)
        if rng.random() < 0.35:  # black, gray and white ropes are common
            first = first.mean() + rng.normal(0, 4, 3)
        own = _lab(first[None])
        if np.quantile(np.linalg.norm(under - own, axis=1), 0.1) > _APART:
            break
    colours = [first]
    while len(colours) < count:
        near = similar and len(colours) == 1
        other = np.clip(first + rng.normal(0, 30, 3), 5, 250) if near else rng.uniform(15, 245, 3)
        distance = np.linalg.norm(_lab(other[None]) - own)
        if _SIMILAR < distance < 1.7 * _SIMILAR if near else distance > _APART:
            colours.append(other)
    return np.array(colours, np.float32)


def _photographed(rng: np.random.Generator, surface: Relief, scene: Field, light: Array) -> npt.NDArray[np.uint8]:
    """Return the picture of a scene, given its colours without light: shade, shine, shadows, noise, a JPEG file."""
    on = surface.owner >= 0
    linear = (np.clip(scene, 0, 255) / 255) ** _GAMMA * np.where(on, surface.shade, np.float32(1))[..., None]
    if rng.random() < 0.6:  # something shiny: the light itself is seen in it
        shine = np.clip((surface.shade - 0.9) / 0.3, 0, 1) ** 2 * on
        linear += (rng.uniform(0.1, 0.6) * shine)[..., None].astype(np.float32)
    linear *= (1 - _shadows(rng, surface, light))[..., None]
    # The light falls off from one side, and has a tint.
    rows, columns = surface.owner.shape
    away = rng.uniform((-0.2, -0.2), (1.2, 1.2))
    u, v = np.meshgrid(np.linspace(0, 1, columns) - away[0], np.linspace(0, 1, rows) - away[1])
    linear *= (1 / (1 + rng.uniform(0, 1.5) * (u**2 + v**2)))[..., None] * (1 + rng.normal(0, 0.06, 3))
    small = cv2.resize(linear, SIZE[::-1], interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), rng.uniform(0.4, 1.0))
    picture = 255 * np.clip(small * rng.uniform(0.75, 1.2), 0, 1) ** (1 / _GAMMA)
    picture += rng.normal(0, rng.uniform(1, 5), picture.shape)
    rgb = np.clip(np.round(picture), 0, 255).astype(np.uint8)
    packed = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(60, 97))])[1]
    return np.ascontiguousarray(np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR), np.uint8)[..., ::-1])


def _shadows(rng: np.random.Generator, surface: Relief, light: Array) -> Field:
    """Return how much of the light is missing at each place, 0 to 1.

    There is less next to objects, in their shadows, and in the shadow of something outside the picture.
    """
    rows, columns = surface.owner.shape
    top = max(float(np.quantile(surface.height[surface.owner >= 0], 0.95)), 1.0)
    nearby = cv2.GaussianBlur(surface.height, (0, 0), 0.5 * top)
    dark = 0.8 * np.clip((nearby - surface.height) / top, 0, 1)
    cast = np.clip((shifted(surface.height, light, top) - surface.height) / top, 0, 1)
    dark = np.maximum(dark, rng.uniform(0.2, 0.7) * cv2.GaussianBlur(cast, (0, 0), 0.2 * top + 0.5))
    if rng.random() < 0.4:
        angle, through = rng.uniform(0, 2 * np.pi), rng.uniform((0.2, 0.2), (0.8, 0.8)) * (columns, rows)
        u, v = np.meshgrid(np.arange(columns) - through[0], np.arange(rows) - through[1])
        side = (u * np.cos(angle) + v * np.sin(angle)) / rng.uniform(4, 80)
        dark = 1 - (1 - dark) * (1 - rng.uniform(0.3, 0.65) / (1 + np.exp(-np.clip(side, -30, 30))))
    return np.asarray(np.clip(dark, 0, 0.9), np.float32)


def _ground(rng: np.random.Generator, ground: Ground, size: tuple[int, int]) -> Field:
    """Return the colour of a ground without light, ``(H, W, 3)`` float32 sRGB, 0 to 255: mostly gray."""
    base = np.clip(rng.uniform(25, 235) + rng.normal(0, 12 if rng.random() < 0.7 else 40, 3), 12, 245)
    if ground == "plain":
        picture = base * (1 + 0.03 * _noise(rng, size, (64, 64)))
    elif ground == "cloth":
        u, v = _turned(rng.uniform(3, 9), rng.uniform(0, np.pi), size)
        threads = rng.uniform(0.04, 0.12) * np.sin(2 * np.pi * u) * np.sign(np.sin(2 * np.pi * v))
        threads = threads[..., None] + 0.04 * _noise(rng, size, (3, 3))
        picture = base * (1 + threads + rng.uniform(0.03, 0.12) * _noise(rng, size, (220, 120)))
    elif ground == "wood":
        red = rng.uniform(110, 220)
        brown = red * np.array([1.0, rng.uniform(0.68, 0.85), rng.uniform(0.4, 0.65)])
        rings = np.sin(_noise(rng, size, (200, 30)) * 6 + 3 * _noise(rng, size, (400, 80)))
        picture = brown * (1 + 0.07 * rings + 0.06 * _noise(rng, size, (60, 3)))
        if rng.integers(2):
            picture = cv2.rotate(cv2.resize(picture, size), cv2.ROTATE_90_CLOCKWISE)
    elif ground == "concrete":
        rough = sum(_noise(rng, size, (s, s)) * a for s, a in ((96, 0.06), (24, 0.05), (6, 0.05), (2, 0.06)))
        picture = base.mean() * rough + base
    elif ground == "mat":  # a cutting mat: one colour, with fine and coarse lines
        colour = np.array([(30, 90, 70), (40, 60, 110), (60, 60, 62)][int(rng.integers(3))])
        picture, step = colour * (1 + 0.04 * _noise(rng, size, (3, 3))), int(rng.integers(30, 70))
        for k in range(0, max(size), step):
            wide, lines = 4 if k // step % 5 == 0 else 2, (colour + rng.uniform(50, 120)).tolist()
            cv2.line(picture, (k, 0), (k, size[0]), lines, wide)
            cv2.line(picture, (0, k), (size[1], k), lines, wide)
    elif ground == "checks":  # tiles or a tablecloth of two colours
        u, v = _turned(rng.uniform(50, 200), rng.uniform(0, np.pi / 2), size)
        other = np.clip(base + rng.choice([-1, 1]) * rng.uniform(25, 60) + rng.normal(0, 10, 3), 10, 245)
        odd = ((np.floor(u) + np.floor(v)) % 2)[..., None]
        picture = (base * (1 - odd) + other * odd) * (1 + 0.03 * _noise(rng, size, (4, 4)))
    else:
        picture = base * (1 + 0.04 * _noise(rng, size, (48, 48)))
        for _ in range(int(rng.integers(3, 9))):  # papers, boxes and discs of any colour
            centre, colour = rng.uniform((0, 0), size[::-1]), rng.uniform(15, 245, 3).tolist()
            if rng.integers(3):
                sides = (rng.uniform(0.05, 0.3, 2) * size[1]).tolist()
                box = cv2.boxPoints((centre.tolist(), sides, float(rng.uniform(0, 180))))
                cv2.fillPoly(picture, [np.round(box).astype(np.int32)], colour, cv2.LINE_AA)
            else:
                cv2.circle(picture, centre.astype(int).tolist(), int(rng.uniform(0.02, 0.1) * size[1]), colour, -1)
    return np.clip(picture, 0, 255).astype(np.float32)


def _noise(rng: np.random.Generator, size: tuple[int, int], grain: tuple[int, int]) -> Field:
    """Return smooth noise of unit deviation, ``(H, W, 1)``, with grains of (width, height) pixels."""
    coarse = rng.normal(0, 1, (size[0] // grain[1] + 3, size[1] // grain[0] + 3)).astype(np.float32)
    field = cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(field / max(float(field.std()), 1e-6), np.float32)[..., None]


def _turned(pitch: float, angle: float, size: tuple[int, int]) -> tuple[Field, Field]:
    """Return coordinates along two turned axes in units of ``pitch`` pixels, each ``(H, W)``."""
    rows, columns = np.mgrid[: size[0], : size[1]].astype(np.float32)
    cosine, sine = np.cos(angle) / pitch, np.sin(angle) / pitch
    return columns * cosine + rows * sine, rows * cosine - columns * sine
