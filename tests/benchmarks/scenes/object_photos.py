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

from tests.benchmarks.scenes.backgrounds import GROUNDS, Ground, background
from tests.benchmarks.scenes.rope_layouts import Table, lay_ropes
from tests.benchmarks.scenes.rope_pictures import Relief, lift, relief
from tests.benchmarks.scenes.ropes import SIZE

Array = npt.NDArray[np.float64]
Field = npt.NDArray[np.float32]
Kind = Literal["rope", "wire", "harness", "cloth", "ring"]
KINDS: Final = get_args(Kind)
_FINER: Final = 2  # supersampling in each direction, as in a relief
_GAMMA: Final = 2.2
_APART: Final = 22.0  # least distance of an object's colour from the ground, and from the others, in Lab
_SIMILAR: Final = 16.0  # the same for objects of similar colours
_BUNDLE: Final = (3, 7)  # wires of a harness


@dataclass(frozen=True)
class ObjectPhoto:
    """A drawn photo.

    Args:
        rgb: ``(H, W, 3)`` uint8.
        mask: ``(H, W)`` bool, where the object covers more than half of a pixel.
        kind: What the object is.
        ground: What it lies on.
        similar: Whether another object has a similar colour.
    """

    rgb: npt.NDArray[np.uint8]
    mask: npt.NDArray[np.bool_]
    kind: Kind
    ground: Ground
    similar: bool


def object_photo(rng: np.random.Generator, kind: Kind, ground: Ground) -> ObjectPhoto:
    """Draw a photo of 640 x 480 pixels.

    Args:
        rng: Draws everything.
        kind: What the object is.
        ground: What it lies on.
    """
    light = np.array([*rng.uniform(-0.7, 0.7, 2), 1.0])
    light /= np.linalg.norm(light)
    if kind == "harness":
        surface = _harness(rng, light)
    else:
        surface = _strands(rng, kind, light) if kind in ("rope", "wire") else _flat(rng, kind, light)
    under = background(rng, ground, surface.owner.shape)
    seen = cv2.resize((surface.owner == 0).astype(np.float32), SIZE[::-1], interpolation=cv2.INTER_AREA)
    similar = bool(rng.random() < 0.3)
    colours = _colours(rng, int(surface.owner.max()) + 1, _mean_colour(under), similar=similar)
    rgb = _photographed(rng, surface, _painted(rng, surface, under, colours), light)
    return ObjectPhoto(rgb, seen > 0.5, kind, ground, similar and len(colours) > 1)


def object_photos(count: int, seed: int) -> Iterator[ObjectPhoto]:
    """Yield ``count`` photos that go through all kinds of objects and grounds."""
    pairs = [(kind, ground) for ground in GROUNDS for kind in KINDS]
    for k in range(count):
        yield object_photo(np.random.default_rng([seed, k]), *pairs[k % len(pairs)])


def _strands(rng: np.random.Generator, kind: Kind, light: Array) -> Relief:
    """Return one to five ropes or wires that cross; the first is the object."""
    while True:
        thick = float(rng.uniform(9, 24) if kind == "rope" else rng.uniform(3.5, 9))
        count = int(rng.integers(1, 4) if kind == "rope" else rng.integers(1, 6))
        crossings = int(rng.integers(0, 2 * count))
        laid = lay_ropes(rng, count, crossings, Table(SIZE, thick, 0.4, False, np.deg2rad(20), 2.0))
        if laid is not None:
            break
    curves, found, _ = laid
    above = rng.integers(2, size=len(found)).astype(bool).tolist()
    lifts = []
    for index, curve in enumerate(curves):
        at = [(m.a, up) for m, up in zip(found, above, strict=True) if m.i == index]
        at += [(m.b, not up) for m, up in zip(found, above, strict=True) if m.j == index]
        lifts.append(lift(len(curve), [a for a, _ in at], [up for _, up in at], thick))
    return relief(curves, [thick] * count, lifts, SIZE, light)


def _harness(rng: np.random.Generator, light: Array) -> Relief:
    """Return wires that run side by side and fan out at both ends."""
    while True:
        thick = float(rng.uniform(3.5, 7))
        laid = lay_ropes(rng, 1, 0, Table(SIZE, 4 * thick, 0.3, False, np.deg2rad(20), 4.0))
        if laid is not None:
            break
    axis = laid[0][0]
    along = np.gradient(axis, axis=0)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    share = np.linspace(0, 1, len(axis))
    curves = []
    count = int(rng.integers(*_BUNDLE, endpoint=True))
    for place in rng.permutation(count) - (count - 1) / 2:
        fan = sum(rng.uniform(0.5, 3) * np.clip(np.abs(share - end) * -5 + 1, 0, 1) ** 2 for end in (0, 1))
        offset = place * thick * (rng.uniform(0.95, 1.15) + fan)
        sway = 0.25 * thick * np.sin(share * rng.uniform(4, 14) + rng.uniform(0, 6))
        curves.append(axis + (offset + sway)[:, None] * normal)
    return relief(curves, [thick] * count, [np.zeros(len(axis))] * count, SIZE, light)


def _flat(rng: np.random.Generator, kind: Kind, light: Array) -> Relief:
    """Return a cloth with folds or a closed band, and sometimes a second one of another place."""
    rows, columns = (_FINER * edge for edge in SIZE)
    surface = Relief(
        np.zeros((rows, columns), np.float32),
        np.zeros((rows, columns), np.float32),
        np.full((rows, columns), -1, np.int8),
    )
    for owner in range(int(rng.integers(1, 3)) - 1, -1, -1):
        around = np.linspace(0, 2 * np.pi, 200, endpoint=False)
        radius = rng.uniform(0.16, 0.34) * rows * (1 - 0.3 * owner)
        if kind == "cloth":
            corner = np.maximum(np.abs(np.cos(around)), np.abs(np.sin(around)) * rng.uniform(0.8, 1.6))
            reach = radius / corner
        else:
            reach = np.full(200, radius)
        reach = reach * (1 + sum(rng.uniform(0, 0.06) * np.cos(k * around + rng.uniform(0, 6)) for k in (2, 3, 4)))
        turned = around + rng.uniform(0, 2 * np.pi)
        middle = rng.uniform((0.35, 0.35), (0.65, 0.65)) * (columns, rows)
        outline = middle + reach[:, None] * np.stack([np.cos(turned), np.sin(turned)], axis=1)
        shape = np.zeros((rows, columns), np.uint8)
        cv2.fillPoly(shape, [np.round(outline).astype(np.int32)], 1)
        if kind == "ring":
            inner = middle + (outline - middle) * rng.uniform(0.65, 0.85)
            cv2.fillPoly(shape, [np.round(inner).astype(np.int32)], 0)
        on = shape > 0
        folds = cv2.resize(rng.normal(0, 1, (6, 8)).astype(np.float32), (columns, rows), interpolation=cv2.INTER_CUBIC)
        slope = cv2.Sobel(folds, cv2.CV_32F, 1, 0) * light[0] + cv2.Sobel(folds, cv2.CV_32F, 0, 1) * light[1]
        surface.shade[on] = np.clip(0.85 + rng.uniform(2, 9) * slope, 0.3, 1.15)[on]
        surface.height[on] = 6.0
        surface.owner[on] = owner
    return surface


def _mean_colour(picture: Field) -> Field:
    return np.asarray(picture[::8, ::8].reshape(-1, 3), np.float32)


def _lab(rgb: npt.NDArray[np.floating]) -> Array:
    """Return CIE Lab of ``(K, 3)`` sRGB values of 0 to 255."""
    return np.asarray(cv2.cvtColor((rgb[None] / 255).astype(np.float32), cv2.COLOR_RGB2LAB)[0], np.float64)


def _colours(rng: np.random.Generator, count: int, ground: Field, *, similar: bool) -> Array:
    """Return RGB of each object; the first stands out from most of the ground, as an object that is looked for does."""
    under = _lab(ground)
    while True:
        first = rng.uniform(15, 245, (1, 3))
        if rng.random() < 0.35:  # black, gray and white ropes are common
            first[:] = first.mean() + rng.normal(0, 4, 3)
        if np.quantile(np.linalg.norm(under - _lab(first), axis=1), 0.1) > _APART:
            break
    colours = [first[0]]
    while len(colours) < count:
        near = similar and len(colours) == 1
        other = np.clip(first[0] + rng.normal(0, 30, 3), 5, 250) if near else rng.uniform(15, 245, 3)
        distance = np.linalg.norm(_lab(other[None]) - _lab(first))
        if _SIMILAR < distance < 1.7 * _SIMILAR if near else distance > _APART:
            colours.append(other)
    return np.array(colours)


def _painted(rng: np.random.Generator, surface: Relief, under: Field, colours: Array) -> Field:
    """Return the colour of everything without light: objects have a weave, and some a stripe or a change of colour."""
    scene = under.copy()
    on = surface.owner >= 0
    scene[on] = colours.astype(np.float32)[surface.owner[on]]
    fibre = cv2.resize(
        rng.normal(0, 1, (surface.owner.shape[0] // 3, surface.owner.shape[1] // 3)).astype(np.float32),
        surface.owner.shape[::-1],
    )
    scene[on] *= (1 + rng.uniform(0, 0.12) * fibre[on, None]).astype(np.float32)
    return scene


def _photographed(rng: np.random.Generator, surface: Relief, scene: Field, light: Array) -> npt.NDArray[np.uint8]:
    rows, columns = surface.owner.shape
    on = surface.owner >= 0
    linear = (np.clip(scene, 0, 255) / 255) ** _GAMMA
    shade = np.where(on, surface.shade, 1.0).astype(np.float32)
    linear *= shade[..., None]
    if rng.random() < 0.6:  # something shiny: the light itself is seen in it
        shine = np.clip((surface.shade - 0.9) / 0.3, 0, 1) ** 2 * on
        linear += (rng.uniform(0.1, 0.6) * shine)[..., None].astype(np.float32)
    linear *= (1 - _shadows(rng, surface, light))[..., None]
    linear *= _lighting(rng, (rows, columns))
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
    shift = -light[:2] / light[2] * top * _FINER
    matrix = np.array([[1, 0, shift[0]], [0, 1, shift[1]]], dtype=np.float64)
    cast = np.clip((cv2.warpAffine(surface.height, matrix, (columns, rows)) - surface.height) / top, 0, 1)
    dark = np.maximum(dark, rng.uniform(0.2, 0.7) * cv2.GaussianBlur(cast, (0, 0), 0.2 * top + 0.5))
    if rng.random() < 0.4:
        angle, through = rng.uniform(0, 2 * np.pi), rng.uniform((0.2, 0.2), (0.8, 0.8)) * (columns, rows)
        u, v = np.meshgrid(np.arange(columns) - through[0], np.arange(rows) - through[1])
        side = (u * np.cos(angle) + v * np.sin(angle)) / rng.uniform(4, 80)
        dark = 1 - (1 - dark) * (1 - rng.uniform(0.3, 0.65) / (1 + np.exp(-np.clip(side, -30, 30))))
    return np.asarray(np.clip(dark, 0, 0.9), np.float32)


def _lighting(rng: np.random.Generator, size: tuple[int, int]) -> Field:
    """Return the light at each place, ``(H, W, 3)``: it falls off from one side, and has a tint."""
    away = rng.uniform((-0.2, -0.2), (1.2, 1.2))
    u, v = np.meshgrid(np.linspace(0, 1, size[1]) - away[0], np.linspace(0, 1, size[0]) - away[1])
    fall = 1 / (1 + rng.uniform(0, 1.5) * (u**2 + v**2))
    tint = 1 + rng.normal(0, 0.06, 3)
    return np.asarray(fall[..., None] * tint, np.float32)
