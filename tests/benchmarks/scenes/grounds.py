"""Draw what objects lie on: tables, benches, boards with holes, mats, cloths, paper, carpets and floors.

A ground is its reflectance, linear and without light, on a raster that is twice as fine as the photo. All lengths are
pixels of that raster; every ground is a procedure, none a picture.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from tests.benchmarks.scenes.height_field import Field, Size, grain

Picture = npt.NDArray[np.floating]  # (H, W, 3) linear reflectance, or (H, W) of one share
_GAMMA: Final = 2.2
_TILT: Final = 0.12  # how far a corner of the ground moves when the camera leans, in widths of the photo


def linear(colour: str | Picture) -> Field:
    """Return the linear reflectance of an sRGB colour: ``"d0a070"``, or an array of 0 to 255."""
    values = np.array([int(colour[k : k + 2], 16) for k in (0, 2, 4)]) if isinstance(colour, str) else colour
    return np.asarray((np.clip(values, 3, 250) / 255) ** _GAMMA, np.float32)


def ground(rng: np.random.Generator, name: str, size: Size) -> Field:
    """Draw a ground as a camera that leans a little sees it: ``(H, W, 3)`` float32, 0 to 1."""
    picture = np.clip(GROUNDS[name](rng, size), 0.004, 1).astype(np.float32)
    height, width = size
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    seen = corners + np.sign(corners - corners[2] / 2) * rng.uniform(0, _TILT, (4, 2)).astype(np.float32) * width
    lean = cv2.getPerspectiveTransform(corners, seen)
    return np.asarray(cv2.warpPerspective(picture, lean, (width, height)), np.float32)


def one_of(rng: np.random.Generator, colours: str) -> Field:
    """Return the linear reflectance of one of some sRGB colours: ``"d0a070 ffffff"``."""
    some = colours.split()
    return linear(some[int(rng.integers(len(some)))])


def _one_of(rng: np.random.Generator, colours: str) -> Field:
    return one_of(rng, colours) * np.exp(rng.normal(0, (0.06, 0.03, 0.06))).astype(np.float32)


def _rough(rng: np.random.Generator, size: Size, *sizes: float) -> Field:
    """Return noise of about unit deviation, ``(H, W, 1)``, the sum of grains of some sizes."""
    total = sum(grain(rng, size, (max(int(each), 1), max(int(each), 1))) for each in sizes)
    return np.asarray(total / np.sqrt(len(sizes)), np.float32)


def raster(rng: np.random.Generator, size: Size, turn: float) -> tuple[Field, Field]:
    """Return coordinates u and v, ``(H, W)``, turned by at most ``turn`` radians."""
    v, u = np.mgrid[: size[0], : size[1]].astype(np.float32)
    angle = rng.uniform(-turn, turn)
    cos, sin = np.float32(np.cos(angle)), np.float32(np.sin(angle))
    return u * cos + v * sin, v * cos - u * sin


def _lines(coordinate: Picture, pitch: float, wide: float) -> Picture:
    """Return where lines at a pitch are, ``(H, W, 1)``, 0 to 1, with soft borders."""
    off = np.abs((coordinate / pitch + 0.5) % 1 - 0.5) * pitch
    return np.clip(wide / 2 + 0.5 - off, 0, 1)[..., None]


def _spots(rng: np.random.Generator, picture: Picture, count: int, reach: tuple[float, float], dark: float) -> Picture:
    """Darken, or lighten, round spots."""
    layer = np.zeros(picture.shape[:2], np.float32)
    for _ in range(count):
        at = rng.uniform((0, 0), picture.shape[1::-1]).astype(int).tolist()
        axes = (rng.uniform(*reach) * rng.uniform(0.6, 1.4, 2)).round().astype(int).tolist()
        cv2.ellipse(layer, at, axes, float(rng.uniform(0, 180)), 0, 360, rng.uniform(0.3, 1), -1, cv2.LINE_AA)
    return picture * (1 - dark * layer[..., None])


def _wood(rng: np.random.Generator, size: Size) -> Picture:
    u, v = raster(rng, size, 0.5 if rng.random() < 0.7 else 1.6)
    pale, deep = _one_of(rng, "d9b98c c89f6b b98a58 8a5f3c e3cfae 6b4a32"), rng.uniform(0.45, 0.75)
    away = v / rng.uniform(14, 40) + 0.6 * grain(rng, size, (500, 120))[..., 0]
    knots = np.zeros(size, np.float32)
    for _ in range(int(rng.integers(0, 5))):
        at, wide = rng.uniform((0, 0), size[::-1]), rng.uniform(14, 45)
        knot = np.exp(-np.sqrt(((u - at[0]) / 2.2) ** 2 + (v - at[1]) ** 2) / wide)
        away, knots = away + 5 * knot * np.sign(v - at[1]), knots + knot**3
    rings = (0.5 + 0.5 * np.sin(2 * np.pi * away))[..., None] ** 2
    fibre = grain(rng, size, (160, 2)) * 0.06 + grain(rng, size, (40, 1)) * 0.04
    picture = pale * (1 - (1 - deep) * rings * rng.uniform(0.25, 0.8)) * np.exp(fibre) * (1 - 0.6 * knots[..., None])
    if rng.random() < 0.5:  # planks
        pitch = rng.uniform(140, 380)
        board = rng.normal(0, 0.12, 64)[(v // pitch).astype(int) % 64][..., None]
        picture = picture * np.exp(board) * (1 - 0.75 * _lines(v + pitch / 2, pitch, 3))
    return picture


def _bench(rng: np.random.Generator, size: Size) -> Picture:
    picture = _one_of(rng, "a08c70 8c7b66 77706a b5a184 5f5a55") * np.exp(0.14 * _rough(rng, size, 220, 60, 12, 3))
    picture = _spots(rng, picture, int(rng.integers(3, 12)), (10, 90), rng.uniform(0.1, 0.45))
    picture = _spots(rng, picture, int(rng.integers(10, 60)), (1, 5), rng.uniform(0.2, 0.7))
    marks = np.zeros(size, np.float32)
    for _ in range(int(rng.integers(15, 60))):
        start, way = rng.uniform((0, 0), size[::-1]), rng.normal(0, 90, 2)
        ends = [np.round(each).astype(int).tolist() for each in (start, start + way)]
        cv2.line(marks, ends[0], ends[1], (rng.uniform(-0.4, 0.3),), int(rng.integers(1, 3)), cv2.LINE_AA)
    if rng.random() < 0.5:  # where a cup stood
        at, reach = rng.uniform((0, 0), size[::-1]).astype(int).tolist(), int(rng.uniform(50, 90))
        cv2.circle(marks, at, reach, -0.35, int(rng.integers(3, 9)), cv2.LINE_AA)
    return picture * np.exp(marks[..., None])


def _laminate(rng: np.random.Generator, size: Size) -> Picture:
    base = _one_of(rng, "d8d4cc b9b6b0 8f9092 e6e0d2 5a5d62 a7adb0 c9bda8") * np.exp(0.03 * _rough(rng, size, 300))
    for colour in ("303030 504840", "f4f2ee d0c8b8"):
        fleck = _rough(rng, size, float(rng.integers(2, 5)), 2)
        base = np.where(fleck > rng.uniform(1.3, 2.2), 0.5 * base + 0.5 * _one_of(rng, colour), base)
    return base


def _concrete(rng: np.random.Generator, size: Size) -> Picture:
    picture = _one_of(rng, "9a9890 b3b0a8 7f7d79 8b8780") * np.exp(0.1 * _rough(rng, size, 260, 90, 30, 8, 2))
    return _spots(rng, picture, int(rng.integers(40, 200)), (1, 4), rng.uniform(0.3, 0.7))


def _pegboard(rng: np.random.Generator, size: Size) -> Picture:
    """Draw a board with round holes: hardboard, or the aluminium plate of a laboratory."""
    u, v = raster(rng, size, 0.3)
    metal = rng.random() < 0.5
    shade = 0.05 * grain(rng, size, (240, 1)) if metal else 0.06 * _rough(rng, size, 90, 4)
    board = _one_of(rng, "b9bcc0 9b9ea3 6f7276" if metal else "9a7650 c2a77e ece8e0 83603f") * np.exp(shade)
    pitch, hole = rng.uniform(60, 130), rng.uniform(6, 14)
    du, dv = (((each / pitch) % 1 - 0.5) * pitch for each in (u, v))
    inside = np.clip(hole + 0.5 - np.hypot(du, dv), 0, 1)[..., None]
    rim = np.clip(2.5 - np.abs(np.hypot(du, dv - 1) - hole - 1), 0, 1)[..., None] * 0.5
    return board * (1 + rim) * (1 - 0.93 * inside)


def _breadboard(rng: np.random.Generator, size: Size) -> Picture:
    u, v = raster(rng, size, 1.6)
    pitch = rng.uniform(22, 40)
    row = np.floor(v / pitch) % 14
    away = np.maximum(*(np.abs((each / pitch) % 1 - 0.5) * pitch for each in (u, v)))  # from the nearest hole
    holes = ((away < 0.2 * pitch) & ~np.isin(row, (0, 6, 11)))[..., None]
    board = np.where(holes, 0.04, _one_of(rng, "ece9e2 f2f2ee d9d6cc") * np.exp(0.02 * _rough(rng, size, 200, 3)))
    for line, colour in ((0, "c03028"), (11, "2850b0")):
        rail = (np.abs(v % (14 * pitch) - (line + 0.5) * pitch) < 2.5)[..., None]
        board = np.where(rail, linear(colour), board)
    return np.where((row == 6)[..., None], board * 0.7, board)


def _mat(rng: np.random.Generator, size: Size) -> Picture:
    u, v = raster(rng, size, 0.6)
    mat = _one_of(rng, "2f6b52 2d5d6e 3b3f45 27415f 6a6f73 1f5a48") * np.exp(0.05 * _rough(rng, size, 120, 5, 2))
    ink, pitch = _one_of(rng, "d8d890 e8e8e8 c8d8d0"), rng.uniform(44, 90)
    for step, wide, strong in ((1.0, 1.4, 0.35), (5.0, 3.0, 0.6)):
        drawn = np.maximum(_lines(u, step * pitch, wide), _lines(v, step * pitch, wide)) * strong
        mat = mat * (1 - drawn) + ink * drawn
    across = _lines(u - v * np.float32(rng.choice([0.577, 1.0, 1.73])), 9 * pitch, 2.5) * 0.4
    return mat * (1 - across) + ink * across


def _cloth(rng: np.random.Generator, size: Size) -> Picture:
    u, v = raster(rng, size, 1.6)
    u, v = u + 4 * grain(rng, size, (150, 150))[..., 0], v + 4 * grain(rng, size, (150, 150))[..., 0]
    base = _one_of(rng, "c9c0b2 5d6b80 8a4f4a 404348 d9d4c9 6f7a5c b08d6a 2e3950 9a9aa2")
    thread = rng.uniform(4, 10)
    along_u = (np.floor(u / thread) + np.floor(v / thread)) % 2 > 0  # the thread on top
    bumps = rng.uniform(0.1, 0.3) * (np.abs(np.sin(np.pi * np.where(along_u, u, v) / thread)) - 0.5)[..., None]
    picture = base * np.exp(bumps + rng.uniform(0.03, 0.18) * grain(rng, size, (240, 130)))
    if rng.random() < 0.35:  # plaid
        other, pitch = _one_of(rng, "e8e4da 2a2d38 7a3038 34506e c8a860"), rng.uniform(90, 260)
        for coordinate in (u, v):
            picture = picture + (other - base) * 0.45 * _lines(coordinate, pitch, pitch * 0.35)
    return picture


def _paper(rng: np.random.Generator, size: Size) -> Picture:
    """Draw crumpled paper: facets that the light meets at unlike angles, with creases between them."""
    light = 0.05 * _rough(rng, size, 200, 40)[..., 0]
    for count, strength in ((rng.integers(25, 70), 0.13), (rng.integers(120, 300), 0.07)):
        free = np.ones(size, np.uint8)
        seeds = rng.uniform((0, 0), size, (count, 2)).astype(int)
        free[seeds[:, 0], seeds[:, 1]] = 0
        facet = cv2.distanceTransformWithLabels(free, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)[1]
        u, v = np.meshgrid(np.linspace(-1, 1, size[1], dtype=np.float32), np.linspace(-1, 1, size[0]))
        lean, bend = rng.normal(0, strength, (2, facet.max() + 1)).astype(np.float32)
        light += cv2.GaussianBlur(lean[facet] + bend[facet] * np.sin(9 * (u + v)), (0, 0), rng.uniform(1.5, 4))
    return _one_of(rng, "e9e6df c9a878 f2efe8 d8d2c0") * np.exp(np.clip(light, -0.5, 0.3))[..., None]


def _carpet(rng: np.random.Generator, size: Size) -> Picture:
    base, other = _one_of(rng, "6b6f76 7c6a5a 4a4f66 9a8f80 55604f 8a3f3f"), _one_of(rng, "3f4248 b0a592 30343c")
    tufts = grain(rng, size, (5, 4)) + 0.7 * grain(rng, size, (2, 2))
    share = np.clip(0.5 + 0.5 * _rough(rng, size, 40, 7), 0, 1) * rng.uniform(0.1, 0.8)
    return (base * (1 - share) + other * share) * np.exp(0.22 * tufts)


def _floor(rng: np.random.Generator, size: Size) -> Picture:
    """Draw tiles or vinyl with the strong light of a window at one side."""
    u, v = raster(rng, size, 1.6)
    pitch = rng.uniform(180, 520)
    tile = rng.normal(0, 0.08, (64, 64))[(u // pitch).astype(int) % 64, (v // pitch).astype(int) % 64][..., None]
    picture = _one_of(rng, "b8a890 8f8a84 cfc7ba 6d6a68 a98d70") * np.exp(tile + 0.07 * _rough(rng, size, 160, 30, 4))
    grout = np.maximum(_lines(u, pitch, rng.uniform(2, 7)), _lines(v, pitch, 4)) * rng.uniform(0, 0.6)
    ramp = (u - u.min()) / (u.max() - u.min())
    return picture * (1 - grout) * np.exp(rng.uniform(-1.8, -0.9) * ramp)[..., None]


def _plain(rng: np.random.Generator, size: Size) -> Picture:
    """Draw a painted table or a whiteboard with a few marks."""
    base = _one_of(rng, "dcdad6 c9c8c4 efeeea 9c9c9a 3a3b3d 6f8296 b8c4b0 d8c8a8")
    return _spots(rng, base * np.exp(0.03 * _rough(rng, size, 300, 80)), int(rng.integers(2, 9)), (2, 7), 0.25)


GROUNDS: Final[dict[str, Callable[[np.random.Generator, Size], Picture]]] = {
    "plain": _plain, "wood": _wood, "bench": _bench, "laminate": _laminate, "concrete": _concrete,
    "pegboard": _pegboard, "breadboard": _breadboard, "mat": _mat, "cloth": _cloth, "paper": _paper,
    "carpet": _carpet, "floor": _floor,
}  # fmt: skip
