"""Curves of ropes and rings, outlines of sheets and garments, wrinkles; pixels of the photo, x right and y down."""

from __future__ import annotations

import math
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]  # pictures ``(h, w, 3)`` float32, 0...255; masks ``(h, w)`` uint8; points ``(N, 2)`` float64
Random = np.random.Generator

WIDTH, HEIGHT = 320, 240  # of the photos that the network is trained on
SHAPE: Final = (HEIGHT, WIDTH)
SIZE: Final = np.array([WIDTH, HEIGHT], float)

# Garments lying flat, the half right of x = 0 from the collar to the hem, y down; about 2 high.
_SHIRT = ((0, -0.9), (0.2, -1), (0.45, -0.95), (1, -0.45), (0.8, -0.2), (0.5, -0.45), (0.52, 0.2), (0.5, 1), (0, 1))
_SWEATER = ((0, -0.95), (0.2, -1), (0.5, -0.9), (1, 0.5), (0.8, 0.6), (0.5, -0.2), (0.5, 0.9), (0, 0.92))
_TROUSERS = ((0, -1), (0.42, -1), (0.5, -0.3), (0.55, 1), (0.2, 1), (0.06, -0.3), (0, -0.3))
_DRESS = ((0, -0.8), (0.12, -0.8), (0.18, -1), (0.28, -1), (0.3, -0.5), (0.25, -0.2), (0.65, 1), (0, 1.03))
_SKIRT = ((0, -0.6), (0.35, -0.6), (0.75, 0.6), (0, 0.68))
_GARMENTS: Final = (_SHIRT, _SWEATER, _TROUSERS, _DRESS, _SKIRT)
_SOCK: Final = ((-0.25, -1), (0.2, -1), (0.22, 0.2), (0.9, 0.75), (0.95, 1), (0.7, 1.1), (0, 1), (-0.25, 0.6))


def direction(rng: Random) -> tuple[float, float]:
    """Draw a direction, as cosine and sine."""
    angle = rng.uniform(0, 2 * math.pi)
    return math.cos(angle), math.sin(angle)


def _turned(rng: Random, points: Array) -> Array:
    cosine, sine = direction(rng)
    return points @ np.array([[cosine, sine], [-sine, cosine]])


def resample(points: Array, step: float = 1.0) -> Array:
    """Return the points of a polyline at equal distances of about ``step`` pixels."""
    arc = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    at = np.linspace(0, arc[-1], max(8, int(arc[-1] / step)))
    return np.stack([np.interp(at, arc, points[:, 0]), np.interp(at, arc, points[:, 1])], 1)


def _spline(controls: Array) -> Array:
    """Return a uniform cubic B-spline near control points, from the second one to the last but one."""
    u = np.linspace(0, 1, 40, endpoint=False)[:, None]
    basis = ((1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3)
    spans = [sum(b * controls[i + k] for k, b in enumerate(basis)) / 6 for i in range(len(controls) - 3)]
    return resample(np.concatenate(spans))


def rope(rng: Random, width: float) -> Array:
    """Draw the centreline of a rope: across the photo, a U, through random places, or as it was thrown down."""
    kind, count = rng.choice(["across", "U", "places", "thrown"], p=[0.38, 0.1, 0.18, 0.34]), int(rng.integers(5, 11))
    if kind == "thrown":
        return _thrown(rng, width)
    u = np.linspace(-1, 1, count)
    if kind == "across":
        controls = np.stack([u * rng.uniform(180, 330), rng.normal(0, rng.uniform(3, 60), count)], 1)
    else:  # a U
        controls = np.stack([u * rng.uniform(max(20, 3 * width), 150), (1 - u**2) * rng.uniform(60, 250) - 60], 1)
    controls = _turned(rng, controls + rng.normal(0, 9, (count, 2))) + rng.normal(0.5, 0.2, 2) * SIZE
    curve = _spline(controls if kind != "places" else rng.uniform(-0.12, 1.12, (count, 2)) * SIZE)
    return curve[int(rng.uniform(0.1, 0.5) * len(curve)) if rng.random() < 0.3 else 0 :]


def _thrown(rng: Random, width: float) -> Array:
    """Integrate a random curvature: bows, loops, straight parts, coils at times."""
    arc = np.arange(0.0, rng.uniform(120, 1100))
    curvature = np.zeros(len(arc))
    for _ in range(rng.integers(1, 5)):
        curvature += rng.uniform(-1, 1) * np.sin(arc / rng.uniform(25, 160) + rng.uniform(0, 7))
    curvature += rng.uniform(-0.4, 0.4) if rng.random() < 0.8 else rng.choice([-3, 3])
    tightest = max(1.6 * width, rng.uniform(14, 90))  # radius in pixels
    heading = rng.uniform(0, 7) + np.cumsum(curvature / np.abs(curvature).max() / tightest)
    curve = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], 1), 0)
    centre = curve.mean(0) if rng.random() < 0.6 else curve[rng.integers(len(curve))]
    return curve + rng.uniform(0.15, 0.85, 2) * SIZE - centre


def _round(rng: Random, bumps: float, count: int = 48) -> Array:
    """Draw a closed curve around the origin of radius 1, with dents of strength ``bumps``, at times elongated."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    dents = [rng.normal(0, bumps / k) * np.cos(k * angle + rng.uniform(0, 7)) for k in range(2, 6)]
    stretched = [1, rng.uniform(0.25, 1) if rng.random() < 0.5 else 1]
    return np.stack([np.cos(angle), np.sin(angle)], 1) * np.clip(1 + np.sum(dents, 0), 0.3, None)[:, None] * stretched


def ring(rng: Random) -> Array:
    """Draw a closed curve, the first point twice: round, elongated or dented."""
    shape = _turned(rng, _round(rng, 0.16)) * np.exp(rng.uniform(np.log(22), np.log(110)))
    curve = _spline(np.concatenate([shape, shape[:3]]) + rng.uniform(0.2, 0.8, 2) * SIZE)
    return np.concatenate([curve, curve[:1]])


def outline(rng: Random) -> Array:
    """Draw the outline of a sheet: cloth with four corners, a garment, a sock, a disc or a rounded blob."""
    kind = rng.choice(["cloth", "garment", "sock", "disc", "blob"], p=[0.4, 0.3, 0.06, 0.12, 0.12])
    shape, scale = _round(rng, 0.15 * (kind == "blob")), np.exp(rng.uniform(np.log(35), np.log(120)))
    if kind == "cloth":
        high = rng.choice([1.0, rng.uniform(0.35, 1)])
        shape = np.array([(-1, -high), (1, -high), (1, high), (-1, high)]) + rng.normal(0, 0.06, (4, 2))
    elif kind == "garment":
        half = np.array(_GARMENTS[rng.integers(len(_GARMENTS))]) * [rng.uniform(0.8, 1.25), 1]
        shape = np.concatenate([half, half[::-1] * [-1, 1]])
    elif kind == "sock":
        shape = np.array(_SOCK) * [rng.choice([-1, 1]), 1]
    shape = scale * (_turned(rng, shape) if rng.random() < 0.6 else shape)
    edge = resample(np.concatenate([shape, shape[:1]]) + rng.uniform(0.25, 0.75, 2) * SIZE, 2.0)
    edge = _smooth(edge, rng.uniform(1, 5) * scale / 60)  # no corner of cloth is sharp
    sway = _smooth(rng.standard_normal(edge.shape), rng.uniform(8, 30))  # and no edge quite straight
    return edge + sway / sway.std() * rng.uniform(0.003, 0.03) * scale


def _smooth(closed: Array, sigma: float) -> Array:
    """Smooth values along a closed curve by a Gaussian of ``sigma`` points."""
    reach = min(len(closed) - 1, int(3 * sigma) + 1)
    padded = np.concatenate([closed[-reach:], closed, closed[:reach]])
    return cv2.GaussianBlur(padded, (1, 2 * reach + 1), 1e-3, sigmaY=sigma)[reach:-reach]


def noise(rng: Random, shape: tuple[int, int], scale: float, stretch: float = 1.0, octaves: int = 1) -> Array:
    """Draw smooth noise of unit strength: ``scale`` in pixels, ``stretch`` times as long along x."""
    total = np.zeros(shape, np.float32)
    for octave in range(octaves):
        fine = max(1.0, scale / 2**octave)
        size = max(2, round(shape[0] / fine) + 1), max(2, round(shape[1] / fine / stretch) + 1)
        values = rng.standard_normal(size, np.float32) * 0.6**octave
        total += cv2.resize(values, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return total


def wrinkles(rng: Random, shape: tuple[int, int], scale: float) -> Array:
    """Draw the shading of cloth ``scale`` pixels wide, about 1: soft waves, and creases that fade along their way."""
    field = noise(rng, shape, rng.uniform(0.2, 0.6) * scale, octaves=2) * rng.uniform(0.2, 1)
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32)
    bend = noise(rng, shape, 0.5 * scale) * rng.uniform(0.02, 0.15) * scale
    for _ in range(rng.integers(0, 5)):
        (cosine, sine), fade = direction(rng), noise(rng, shape, 0.5 * scale)
        middle = cosine * shape[1] * rng.uniform(0.2, 0.8) + sine * shape[0] * rng.uniform(0.2, 0.8)
        crease = (x * cosine + y * sine + bend - middle) / (rng.uniform(0.02, 0.08) * scale)
        field += 2 * crease * np.exp(-crease * crease) * np.clip(fade + 0.3, 0, 1)  # a lit and a dark side
    return 1 + rng.uniform(0.03, 0.16) * field
