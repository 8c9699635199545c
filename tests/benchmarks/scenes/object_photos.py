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
from tests.benchmarks.scenes.height_field import Array, Field, HeightField, Size, grain, photographed, unit
from tests.benchmarks.scenes.several_ropes import lifts
from tests.scenes.layouts import Table, place_ropes
from tests.scenes.ropes import normals

Kind = Literal["rope", "wire", "harness", "cloth", "ring"]
Ground = Literal["plain", "cloth", "wood", "concrete", "checks", "clutter"]
KINDS: Final = get_args(Kind)
GROUNDS: Final = get_args(Ground)
_APART: Final = 22.0  # least distance of an object's colour from the ground, and from the others, in Lab
_SIMILAR: Final = 16.0  # the same for objects of similar colours


@dataclass(frozen=True)
class ObjectPhoto:
    """A drawn photo."""

    rgb: npt.NDArray[np.uint8]  # (H, W, 3) uint8
    mask: npt.NDArray[np.bool_]  # (H, W) bool, where the object covers more than half of a pixel
    kind: Kind  # what the object is


def object_photos(count: int, seed: int) -> Iterator[ObjectPhoto]:
    """Yield ``count`` photos that go through all kinds of objects and grounds."""
    pairs = [(kind, ground) for ground in GROUNDS for kind in KINDS]
    for k in range(count):
        yield object_photo(np.random.default_rng([seed, k]), *pairs[k % len(pairs)])


def object_photo(rng: np.random.Generator, kind: Kind, ground: Ground) -> ObjectPhoto:
    """Draw a photo of 640 x 480 pixels of one kind of object on one kind of ground."""
    light = unit(np.array([*rng.uniform(-0.7, 0.7, 2), 1.0]))
    surface = {"harness": _harness, "cloth": _flat, "ring": _flat}.get(kind, _strands)(rng, kind, light)
    scene = _ground(rng, ground, surface.owner.shape)
    seen = cv2.resize((surface.owner == 0).astype(np.float32), SIZE[::-1], interpolation=cv2.INTER_AREA)
    colours = _colours(rng, int(surface.owner.max()) + 1, scene[::8, ::8].reshape(-1, 3))
    on, weave = surface.owner >= 0, 1 + rng.uniform(0, 0.12) * grain(rng, surface.owner.shape, (3, 3))
    scene[on] = colours[surface.owner[on]] * weave[on]
    return ObjectPhoto(photographed(rng, surface, scene, light, rough=True), seen > 0.5, kind)


def _strands(rng: np.random.Generator, kind: Kind, light: Array) -> HeightField:
    """Return one to five ropes or wires that cross; the first is the object."""
    placed, thick, count = None, 0.0, 0
    while placed is None:
        thick, most = (float(rng.uniform(9, 24)), 4) if kind == "rope" else (float(rng.uniform(3.5, 9)), 6)
        count = int(rng.integers(1, most))
        placed = place_ropes(rng, count, int(rng.integers(2 * count)), Table(SIZE, thick, 0.4, np.deg2rad(20)))
    above = rng.integers(2, size=len(placed[1])).astype(bool).tolist()
    return HeightField.of_ropes(placed[0], [thick] * count, lifts(*placed, above, thick), SIZE, light)


def _harness(rng: np.random.Generator, kind: Kind, light: Array) -> HeightField:
    """Return three to seven wires that run side by side and fan out at both ends."""
    placed, thick = None, 0.0
    while placed is None:
        thick = float(rng.uniform(3.5, 7))
        placed = place_ropes(rng, 1, 0, Table(SIZE, 4 * thick, 0.3))
    axis, curves = placed[0][0], []
    normal, share = normals(axis), np.linspace(0, 1, len(axis))
    count = int(rng.integers(3, 8))
    for place in rng.permutation(count) - (count - 1) / 2:
        fan = sum(rng.uniform(0.5, 3) * np.clip(np.abs(share - end) * -5 + 1, 0, 1) ** 2 for end in (0, 1))
        offset = place * thick * (rng.uniform(0.95, 1.15) + fan)
        sway = 0.25 * thick * np.sin(share * rng.uniform(4, 14) + rng.uniform(0, 6))
        curves.append(axis + (offset + sway)[:, None] * normal)
    return HeightField.of_ropes(curves, [thick] * count, [np.zeros(len(axis))] * count, SIZE, light)


def _flat(rng: np.random.Generator, kind: Kind, light: Array) -> HeightField:
    """Return a cloth with folds or a closed band, and sometimes a second one of another place."""
    surface = HeightField.empty(SIZE)
    rows, columns = surface.owner.shape
    for owner in range(int(rng.integers(1, 3)) - 1, -1, -1):
        around = np.linspace(0, 2 * np.pi, 200, endpoint=False)
        reach = np.full(200, rng.uniform(0.16, 0.34) * rows * (1 - 0.3 * owner))
        if kind == "cloth":
            reach /= np.maximum(np.abs(np.cos(around)), np.abs(np.sin(around)) * rng.uniform(0.8, 1.6))
        reach *= 1 + sum(rng.uniform(0, 0.06) * np.cos(k * around + rng.uniform(0, 6)) for k in (2, 3, 4))
        turned, middle = around + rng.uniform(0, 2 * np.pi), rng.uniform(0.35, 0.65, 2) * (columns, rows)
        outline = reach[:, None] * np.stack([np.cos(turned), np.sin(turned)], axis=1)
        shape = np.zeros((rows, columns), np.uint8)
        cv2.fillPoly(shape, [np.round(middle + outline).astype(np.int32)], (1,))
        if kind == "ring":
            cv2.fillPoly(shape, [np.round(middle + outline * rng.uniform(0.65, 0.85)).astype(np.int32)], (0,))
        on, folds = shape > 0, 0.02 * grain(rng, (rows, columns), (160, 160))[..., 0]
        slope = cv2.Sobel(folds, cv2.CV_32F, 1, 0) * light[0] + cv2.Sobel(folds, cv2.CV_32F, 0, 1) * light[1]
        surface.shade[on] = np.clip(0.85 + rng.uniform(40, 200) * slope, 0.3, 1.15)[on]
        surface.height[on], surface.owner[on] = 6.0, owner
    return surface


def _lab(rgb: npt.NDArray[np.floating]) -> Array:
    """Return CIE Lab of ``(K, 3)`` sRGB values of 0 to 255."""
    return np.asarray(cv2.cvtColor((rgb[None] / 255).astype(np.float32), cv2.COLOR_RGB2LAB)[0], np.float64)


def _colours(rng: np.random.Generator, count: int, ground: Field) -> Field:
    """Return RGB of each object; the first stands out from most of the ground, as an object that is looked for does.

    Three times in ten the second one has a similar colour.
    """
    under, first, similar = _lab(ground), ground[0], rng.random() < 0.3
    while np.quantile(np.linalg.norm(under - _lab(first[None]), axis=1), 0.1) <= _APART:
        first = rng.uniform(15, 245, 3)
        if rng.random() < 0.35:  # black, gray and white ropes are common
            first = first.mean() + rng.normal(0, 4, 3)
    colours = [first]
    while len(colours) < count:
        near = similar and len(colours) == 1
        other = np.clip(first + rng.normal(0, 30, 3), 5, 250) if near else rng.uniform(15, 245, 3)
        distance = np.linalg.norm(_lab(other[None]) - _lab(first[None]))
        if _SIMILAR < distance < 1.7 * _SIMILAR if near else distance > _APART:
            colours.append(other)
    return np.array(colours, np.float32)


def _ground(rng: np.random.Generator, ground: Ground, size: Size) -> Field:
    """Return the colour of a ground without light, ``(H, W, 3)`` float32 sRGB, 0 to 255: mostly gray."""
    base = np.clip(rng.uniform(25, 235) + rng.normal(0, 12 if rng.random() < 0.7 else 40, 3), 12, 245)
    rough = sum(grain(rng, size, (s, s)) * a for s, a in ((96, 0.06), (24, 0.05), (6, 0.05), (2, 0.06)))
    v, u = np.mgrid[: size[0], : size[1]].astype(np.float32)
    if ground == "cloth":
        pitch = rng.uniform(3, 9) / (2 * np.pi)
        threads = rng.uniform(0.04, 0.12) * np.sin((u + 0.3 * v) / pitch) * np.sign(np.sin((v - 0.3 * u) / pitch))
        picture = base * (1 + threads[..., None] + rng.uniform(0.03, 0.12) * grain(rng, size, (220, 120)))
    elif ground == "wood":
        brown = rng.uniform(110, 220) * np.array([1.0, rng.uniform(0.68, 0.85), rng.uniform(0.4, 0.65)])
        rings = np.sin(grain(rng, size, (200, 30)) * 6 + 3 * grain(rng, size, (400, 80)))
        picture = brown * (1 + 0.07 * rings + 0.06 * grain(rng, size, (60, 3)))
    elif ground == "concrete":
        picture = base.mean() * rough + base
    elif ground == "checks":  # tiles or a tablecloth of two colours
        pitch, other = rng.uniform(50, 200), base + rng.choice([-1, 1]) * rng.uniform(25, 60) + rng.normal(0, 10, 3)
        odd = (np.floor((u + 0.4 * v) / pitch) + np.floor((v - 0.4 * u) / pitch)) % 2
        picture = np.where(odd[..., None] > 0, np.clip(other, 10, 245), base) * (1 + 0.3 * rough)
    else:
        picture = base * (1 + 0.3 * rough)
        for _ in range(int(rng.integers(3, 9)) if ground == "clutter" else 0):  # papers, boxes and discs of any colour
            centre, colour = rng.uniform((0, 0), size[::-1]).tolist(), rng.uniform(15, 245, 3).tolist()
            sides = (rng.uniform(0.05, 0.3, 2) * size[1]).tolist()
            if rng.integers(3):
                box = cv2.boxPoints((centre, sides, float(rng.uniform(0, 180))))
                cv2.fillPoly(picture, [np.round(box).astype(np.int32)], colour, cv2.LINE_AA)
            else:
                cv2.circle(picture, [round(x) for x in centre], round(sides[0] / 3), colour, -1)
    return np.clip(picture, 0, 255).astype(np.float32)
