"""Draw what objects lie on: plain tables, cloth, wood, concrete, cutting mats, checks, and tables with clutter."""

from __future__ import annotations

from typing import Final, Literal, get_args

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.float32]
Ground = Literal["plain", "cloth", "wood", "concrete", "mat", "checks", "clutter"]
GROUNDS: Final = get_args(Ground)


def background(rng: np.random.Generator, ground: Ground, size: tuple[int, int]) -> Image:
    """Return the colour of a ground without light, ``(H, W, 3)`` float32 sRGB, 0 to 255.

    Args:
        rng: Draws its colours and its pattern.
        ground: What it is.
        size: ``(H, W)``.
    """
    base = _colour(rng)
    if ground == "plain":
        picture = base * (1 + 0.03 * _noise(rng, size, (64, 64)))
    elif ground == "cloth":
        picture = _weave(rng, size, base)
    elif ground == "wood":
        brown = np.array([rng.uniform(110, 220), 0, 0], np.float32)
        brown[1], brown[2] = brown[0] * rng.uniform(0.68, 0.85), brown[0] * rng.uniform(0.4, 0.65)
        rings = np.sin(_noise(rng, size, (200, 30)) * 6 + 3 * _noise(rng, size, (400, 80)))
        grain = 0.07 * rings[..., :1] + 0.06 * _noise(rng, size, (60, 3))
        picture = brown * (1 + grain)
        if rng.integers(2):
            picture = cv2.rotate(cv2.resize(picture, size), cv2.ROTATE_90_CLOCKWISE)
    elif ground == "concrete":
        rough = sum(_noise(rng, size, (s, s)) * a for s, a in ((96, 0.06), (24, 0.05), (6, 0.05), (2, 0.06)))
        picture = np.full(3, base.mean(), np.float32) * (1 + rough) + base - base.mean()
    elif ground == "mat":
        picture = _mat(rng, size)
    elif ground == "checks":
        picture = _checks(rng, size, base)
    else:
        picture = np.asarray(base * (1 + 0.04 * _noise(rng, size, (48, 48))), np.float32)
        _clutter(rng, picture)
    return np.clip(picture, 0, 255).astype(np.float32)


def _colour(rng: np.random.Generator) -> Image:
    """Return the RGB of a ground: mostly gray, at times of a colour."""
    tint = 12 if rng.random() < 0.7 else 40
    return np.clip(rng.uniform(25, 235) + rng.normal(0, tint, 3), 12, 245).astype(np.float32)


def _noise(rng: np.random.Generator, size: tuple[int, int], grain: tuple[int, int]) -> Image:
    """Return smooth noise of unit deviation, ``(H, W, 1)``, with grains of (width, height) pixels."""
    coarse = rng.normal(0, 1, (size[0] // grain[1] + 3, size[1] // grain[0] + 3)).astype(np.float32)
    field = cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(field / max(float(field.std()), 1e-6), np.float32)[..., None]


def _weave(rng: np.random.Generator, size: tuple[int, int], base: Image) -> Image:
    rows, columns = np.mgrid[: size[0], : size[1]].astype(np.float32)
    pitch, angle = rng.uniform(3, 9), rng.uniform(0, np.pi)
    u = (columns * np.cos(angle) + rows * np.sin(angle)) * 2 * np.pi / pitch
    v = (rows * np.cos(angle) - columns * np.sin(angle)) * 2 * np.pi / pitch
    threads = rng.uniform(0.04, 0.12) * np.sin(u) * np.sign(np.sin(v)) + 0.04 * _noise(rng, size, (3, 3))[..., 0]
    folds = rng.uniform(0.03, 0.12) * _noise(rng, size, (220, 120))[..., 0]
    return np.asarray(base * (1 + threads + folds)[..., None], np.float32)


def _mat(rng: np.random.Generator, size: tuple[int, int]) -> Image:
    """Return a cutting mat: one colour, with fine and coarse lines."""
    colour = np.array([(30, 90, 70), (40, 60, 110), (60, 60, 62)][int(rng.integers(3))], np.float32)
    picture = np.asarray(colour * (1 + 0.04 * _noise(rng, size, (3, 3))), np.float32)
    step = int(rng.integers(30, 70))
    for k in range(0, max(size), step):
        wide = 4 if k // step % 5 == 0 else 2
        light = colour + rng.uniform(50, 120)
        cv2.line(picture, (k, 0), (k, size[0]), light.tolist(), wide)
        cv2.line(picture, (0, k), (size[1], k), light.tolist(), wide)
    return picture


def _checks(rng: np.random.Generator, size: tuple[int, int], base: Image) -> Image:
    """Return tiles or a tablecloth of two colours, turned."""
    rows, columns = np.mgrid[: size[0], : size[1]].astype(np.float32)
    pitch, angle = rng.uniform(50, 200), rng.uniform(0, np.pi / 2)
    u = (columns * np.cos(angle) + rows * np.sin(angle)) / pitch
    v = (rows * np.cos(angle) - columns * np.sin(angle)) / pitch
    other = np.clip(base + rng.choice([-1, 1]) * rng.uniform(25, 60) + rng.normal(0, 10, 3), 10, 245)
    odd = ((np.floor(u) + np.floor(v)) % 2)[..., None]
    colours = base * (1 - odd) + other * odd
    return np.asarray(colours * (1 + 0.03 * _noise(rng, size, (4, 4))), np.float32)


def _clutter(rng: np.random.Generator, picture: Image) -> None:
    """Draw papers, boxes and discs of any colour in place."""
    height, width = picture.shape[:2]
    for _ in range(int(rng.integers(3, 9))):
        centre = rng.uniform((0, 0), (width, height))
        colour = rng.uniform(15, 245, 3).tolist()
        if rng.integers(3):
            wide, high = rng.uniform(0.05, 0.3, 2) * width
            box = cv2.boxPoints((tuple(centre.tolist()), (wide, high), float(rng.uniform(0, 180))))
            cv2.fillPoly(picture, [np.round(box).astype(np.int32)], colour, cv2.LINE_AA)
        else:
            middle = int(centre[0]), int(centre[1])
            cv2.circle(picture, middle, int(rng.uniform(0.02, 0.1) * width), colour, -1, cv2.LINE_AA)
