"""Grounds that objects lie on: crops of pictures that scikit-image ships, and procedures.

The pictures show no rope and no cable. Their licences, as ``skimage.data`` states them: astronaut, hubble_deep_field:
NASA, public domain; clock_motion, text: public domain; brick, camera (Lav Varshney), chelsea (Stefan van der Walt),
coffee (Rachel Michetti), grass (linolafett), gravel, retina: CC0; coins (Brooklyn Museum), ihc: no known copyright
restrictions.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import skimage
from curves import HEIGHT, SHAPE, SIZE, WIDTH, Array, Random, direction, noise
from materials import brown, colour, from_hsv

_PICTURES: Final = (
    "astronaut.png clock_motion.png text.png brick.png camera.png chelsea.png coffee.png grass.png gravel.png "
    "coins.png ihc.png hubble_deep_field.jpg retina.jpg"
)
_Y, _X = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)


@cache
def _pictures() -> list[Array]:
    read = [cv2.imread(str(Path(skimage.__file__).parent / "data" / name)) for name in _PICTURES.split()]
    return [picture[..., ::-1].astype(np.float32) for picture in read if picture is not None]


def ground(rng: Random) -> Array:
    """Draw a ground ``(HEIGHT, WIDTH, 3)``, 0...255: one of a kind, or two that meet at an edge, as of a desk."""
    picture = _one(rng)
    if rng.random() < 0.2:
        corners = SIZE * ([[0, 0], [1, 0], [1, 1], [0, 1]] + rng.uniform(-0.45, 0.45, (4, 2)))
        mask = cv2.fillConvexPoly(np.zeros((*SHAPE, 1), np.float32), corners.astype(np.int32), 1, cv2.LINE_AA)
        shadow = cv2.GaussianBlur(mask, (0, 0), rng.uniform(1, 6))[..., None]
        picture = picture * (1 - max(0, rng.uniform(-0.6, 0.6)) * shadow) * (1 - mask) + _one(rng) * mask
    return np.clip(picture, 0, 255)


def _one(rng: Random) -> Array:
    kinds = (_photo, _flat, _wood, _tiles, _weave, _stones, _clutter)
    return kinds[rng.choice(len(kinds), p=(0.18, 0.26, 0.12, 0.14, 0.1, 0.05, 0.15))](rng)


def _photo(rng: Random) -> Array:
    """Crop a picture, in other colours at times."""
    picture = _pictures()[rng.integers(len(_pictures()))]
    height, width = picture.shape[:2]
    high = int(min(height, width * HEIGHT / WIDTH) * rng.uniform(0.35, 1))
    wide = int(high * WIDTH / HEIGHT)
    y, x = rng.integers(height - high + 1), rng.integers(width - wide + 1)
    crop = cv2.resize(picture[y : y + high, x : x + wide], (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    if rng.random() < 0.5:
        hls = cv2.cvtColor(crop / 255, cv2.COLOR_RGB2HLS)
        hls[..., 0], hls[..., 2] = (hls[..., 0] + rng.uniform(0, 360)) % 360, hls[..., 2] * rng.uniform(0.2, 1)
        crop = cv2.cvtColor(hls, cv2.COLOR_HLS2RGB) * 255
    return crop if rng.random() < 0.6 else crop * (from_hsv(rng, (0, 0.6), (1, 1)) / 255)


def _flat(rng: Random) -> Array:
    """Draw a plain surface: light, dark or coloured, with a gradient, stains and fine speckles."""
    ranges = (((0, 0.25), (0.5, 1)), ((0, 0.5), (0.02, 0.14)), ((0, 1), (0.1, 1)))
    cosine, sine = direction(rng)
    shade = 1 + ((_X - WIDTH / 2) * cosine + (_Y - HEIGHT / 2) * sine) * rng.uniform(0, 0.0015)
    shade += noise(rng, SHAPE, 100) * rng.uniform(0, 0.1) + noise(rng, SHAPE, rng.uniform(1, 5)) * rng.uniform(0, 0.05)
    return from_hsv(rng, *ranges[rng.choice(3, p=[0.45, 0.2, 0.35])]) * shade[..., None]


def _wood(rng: Random) -> Array:
    """Draw boards: fibres along x, years as waves, gaps at times."""
    base = brown(rng) if rng.random() < 0.8 else from_hsv(rng, (0, 0.6), (0.2, 0.95))
    fibres = noise(rng, SHAPE, rng.uniform(2, 9), rng.uniform(8, 30), 2)
    fibres += np.sin(noise(rng, SHAPE, 70, 3) * rng.uniform(4, 18)) * rng.uniform(0, 0.8)
    picture = base * (1 + rng.uniform(0.02, 0.15) * fibres)[..., None]
    for y in np.arange(rng.uniform(0, 80), HEIGHT, rng.uniform(25, 90)) if rng.random() < 0.5 else ():
        cv2.line(picture, (0, int(y)), (WIDTH, int(y)), (base * 0.3).tolist(), int(rng.integers(1, 4)))
    return _turned(rng, picture)


def _tiles(rng: Random) -> Array:
    """Draw tiles or bricks with joints, checks of two colours, or a board with holes."""
    kind, base = rng.choice(["tiles", "checks", "holes"], p=[0.6, 0.25, 0.15]), from_hsv(rng, (0, 0.35), (0.25, 0.95))
    high, shift = rng.uniform(20, 140), rng.choice([0, 0.5])
    wide = high * rng.choice([1, 1, rng.uniform(1.2, 4)])
    along = _X / wide + shift * (_Y // high)
    row, column = (_Y // high).astype(int), np.floor(along).astype(int)
    picture = base * (1 + rng.normal(0, rng.uniform(0, 0.12), (64, 64, 1)))[row % 64, column % 64]
    away_y, away_x = _Y % high, along % 1 * wide
    if kind == "checks":
        picture = np.where(((row + column) % 2 > 0)[..., None], colour(rng), colour(rng))
    else:
        tone, holes = base * rng.uniform(0.2, 1.3), np.hypot(away_y - high / 2, away_x - wide / 2)
        picture[(holes if kind == "holes" else np.minimum(away_y, away_x)) < rng.uniform(0.8, 4)] = tone
    shade = 1 + rng.uniform(0.02, 0.1) * noise(rng, SHAPE, rng.uniform(1, 6), octaves=3)
    return _turned(rng, (picture * shade[..., None]).astype(np.float32))


def _weave(rng: Random) -> Array:
    """Draw cloth, a carpet or grass: fine structure, a weave or a rib."""
    shade = 1 + rng.uniform(0.03, 0.3) * noise(rng, SHAPE, rng.uniform(1, 3), rng.uniform(1, 4))
    shade += rng.uniform(0, 0.15) * noise(rng, SHAPE, 40, octaves=2)
    turns = 2 * np.pi / rng.uniform(2.5, 9)
    shade += rng.uniform(0, 0.2) * np.sin(_X * turns) * (np.sin(_Y * turns) if rng.random() < 0.6 else 1)
    return _turned(rng, from_hsv(rng, (0, 0.8), (0.1, 0.95)) * shade[..., None])


def _stones(rng: Random) -> Array:
    """Draw patches around random points, as stones or a mosaic."""
    seeds, count = np.ones(SHAPE, np.uint8), int(rng.integers(8, 120))
    seeds[rng.integers(HEIGHT, size=count), rng.integers(WIDTH, size=count)] = 0
    label = np.asarray(cv2.distanceTransformWithLabels(seeds, cv2.DIST_L2, 5)[1], int)
    colours = from_hsv(rng, (0, 1), (0.2, 1)) + rng.normal(0, rng.uniform(10, 80), (label.max() + 1, 3))
    return np.clip(colours, 0, 255).astype(np.float32)[label] * (1 + 0.06 * noise(rng, SHAPE, 6, octaves=2))[..., None]


def _clutter(rng: Random) -> Array:
    """Draw many small objects on a plain ground: discs, sticks, scraps, boxes, text."""
    picture = np.clip(_flat(rng) if rng.random() < 0.7 else _weave(rng), 0, 255).astype(np.uint8)
    palette = [colour(rng).tolist() for _ in range(rng.integers(2, 7))]
    size = np.exp(rng.uniform(np.log(2), np.log(30)))
    for _ in range(int(np.clip(rng.uniform(100, 3000) / size, 5, 350))):
        paint, place = palette[rng.integers(len(palette))], (rng.random(2) * SIZE).astype(int)
        long = rng.exponential(size, 2) + 1
        kind = rng.choice(["disc", "stick", "scrap", "box", "text"], p=[0.3, 0.22, 0.2, 0.18, 0.1])
        if kind == "disc":
            filled = -1 if rng.random() < 0.8 else 1
            cv2.ellipse(picture, (place.tolist(), (2 * long).tolist(), rng.uniform(0, 180)), paint, filled, cv2.LINE_AA)
        elif kind == "stick":
            bend = place + np.cumsum(rng.normal(0, 1.5 * size, (rng.integers(2, 6), 2)), 0)
            cv2.polylines(picture, [bend.astype(np.int32)], False, paint, int(rng.integers(1, 4)), cv2.LINE_AA)
        elif kind == "text":
            word = "".join(rng.choice(list("abcdeghiklmnoprstuvw0123456789"), rng.integers(1, 9)))
            cv2.putText(picture, word, place.tolist(), cv2.FONT_HERSHEY_SIMPLEX, min(2, size / 14), paint)
        else:
            box = cv2.boxPoints((place.tolist(), (2 * long).tolist(), rng.uniform(0, 90)))
            corners = box if kind == "box" else place + rng.normal(0, 1.3 * size, (3, 2))
            cv2.fillConvexPoly(picture, corners.astype(np.int32), paint, cv2.LINE_AA)
    return picture.astype(np.float32)


def _turned(rng: Random, picture: Array) -> Array:
    """Turn a ground by a random angle, in perspective at times."""
    angle, zoom = rng.choice([0, 90, rng.uniform(0, 360)]), rng.uniform(1.0, 1.7)
    tilt = rng.normal(0, 0.0008, 2) * (rng.random() < 0.4)
    matrix = np.concatenate([cv2.getRotationMatrix2D((WIDTH / 2, HEIGHT / 2), angle, zoom), [[*tilt, 1]]])
    return cv2.warpPerspective(picture, matrix, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT)
