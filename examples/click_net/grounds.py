"""Grounds that objects lie on: crops of pictures that scikit-image ships, and procedures.

The pictures show no rope and no cable. Their licences, as ``skimage.data`` states them: astronaut, hubble_deep_field:
NASA, public domain; text: public domain; brick, camera (Lav Varshney), chelsea (Stefan van der Walt), coffee (Rachel
Michetti), grass (linolafett), gravel, retina: CC0; coins (Brooklyn Museum), ihc: no known copyright restrictions.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np
import skimage
from curves import HEIGHT, SHAPE, SIZE, WIDTH, Array, Random, noise
from materials import cloth, colour, from_hsv

_PICTURES: Final = "astronaut brick camera chelsea coffee coins grass gravel hubble_deep_field ihc retina text"


def ground(rng: Random) -> Array:
    """Draw a ground ``(HEIGHT, WIDTH, 3)``, 0...255: one of a kind, or two that meet at an edge, as of a desk."""
    under, over = rng.choice(np.array([_photo, _plain, _wood, _clutter]), 2, p=(0.22, 0.45, 0.16, 0.17))
    picture = under(rng)
    if rng.random() < 0.2:
        corners = SIZE * ([[0, 0], [1, 0], [1, 1], [0, 1]] + rng.uniform(-0.45, 0.45, (4, 2)))
        mask = cv2.fillConvexPoly(np.zeros((*SHAPE, 1), np.float32), corners.astype(np.int32), 1, cv2.LINE_AA)
        shadow = cv2.GaussianBlur(mask, (0, 0), rng.uniform(1, 6))[..., None]
        picture = picture * (1 - max(0, rng.uniform(-0.6, 0.6)) * shadow) * (1 - mask) + over(rng) * mask
    return np.clip(picture, 0, 255)


def _photo(rng: Random) -> Array:
    """Crop a picture, in other colours at times."""
    file = next((Path(skimage.__file__).parent / "data").glob(f"{rng.choice(_PICTURES.split())}.*"))
    picture = np.asarray(cv2.imread(str(file)), np.float32)[..., rng.permutation(3)]
    high = int(min(picture.shape[0], picture.shape[1] * HEIGHT / WIDTH) * rng.uniform(0.35, 1))
    wide = int(high * WIDTH / HEIGHT)
    y, x = rng.integers(picture.shape[:2] - np.array([high, wide]) + 1)
    crop = cv2.resize(picture[y : y + high, x : x + wide], (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    return crop if rng.random() < 0.5 else crop * (from_hsv(rng, (0, 0.7), (1, 1)) / 255)


def _plain(rng: Random) -> Array:
    """Draw a light, dark or coloured surface with stains and speckles, as of paper, stone or a carpet; or cloth."""
    if rng.random() < 0.35:
        return cloth(rng, from_hsv(rng, (0, 0.8), (0.1, 0.95)), SHAPE, rng.uniform(60, 400))
    ranges = (((0, 0.25), (0.5, 1)), ((0, 0.5), (0.02, 0.14)), ((0, 1), (0.1, 1)))[rng.choice(3, p=[0.45, 0.2, 0.35])]
    stains, fine = noise(rng, SHAPE, 100), noise(rng, SHAPE, rng.uniform(1, 5), rng.uniform(1, 3))
    shade = 1 + rng.uniform(0, 0.1) * stains + min(0.3, rng.exponential(0.05)) * fine
    return from_hsv(rng, *ranges) * shade[..., None]


def _wood(rng: Random) -> Array:
    """Draw boards: fibres along x, years as waves, gaps at times."""
    base = from_hsv(rng, (0.2, 0.6), (0.25, 0.92), hue=(0.03, 0.12) if rng.random() < 0.8 else (0, 1))
    fibres = noise(rng, SHAPE, rng.uniform(2, 9), rng.uniform(8, 30), 2)
    years = np.sin(noise(rng, SHAPE, 70, 3) * rng.uniform(4, 18)) * rng.uniform(0, 0.8)
    shade = 1 + rng.uniform(0.02, 0.15) * (fibres + years)
    if rng.random() < 0.5:
        shade[(np.arange(HEIGHT) + rng.uniform(0, 80)) % rng.uniform(25, 90) < rng.integers(1, 4)] = 0.3
    angle, zoom = rng.choice([0, 90, rng.uniform(0, 360)]), rng.uniform(1, 1.7)
    turn = cv2.getRotationMatrix2D((WIDTH / 2, HEIGHT / 2), angle, zoom)
    return cv2.warpAffine(base * shade[..., None], turn, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT)


def _clutter(rng: Random) -> Array:
    """Draw many small objects on a plain ground: discs, scraps and sticks."""
    picture = np.clip(_plain(rng), 0, 255).astype(np.uint8)
    palette, size = [colour(rng).tolist() for _ in range(rng.integers(2, 7))], np.exp(rng.uniform(0.7, 3.4))
    for _ in range(int(np.clip(rng.uniform(100, 3000) / size, 5, 350))):
        kind = rng.choice(["disc", "scrap", "stick"], p=[0.34, 0.42, 0.24])
        paint, place = palette[rng.integers(len(palette))], rng.random(2) * SIZE
        corners = (place + rng.normal(0, 1.3 * size, (rng.integers(3, 5), 2))).astype(np.int32)
        if kind == "disc":
            cv2.ellipse(picture, cv2.minAreaRect(corners), paint, cv2.FILLED, cv2.LINE_AA)
        elif kind == "scrap":
            cv2.fillPoly(picture, [corners], paint, cv2.LINE_AA)
        else:
            cv2.polylines(picture, [corners], False, paint, int(rng.integers(1, 4)), cv2.LINE_AA)
    return picture.astype(np.float32)
