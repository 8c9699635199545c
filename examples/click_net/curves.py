"""Curves of ropes and rings, outlines of sheets and garments, wrinkles; pixels of the photo, x right and y down."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline
from scipy.ndimage import gaussian_filter1d

Array = npt.NDArray[Any]  # pictures ``(h, w, 3)`` float32, 0...255; masks ``(h, w)`` uint8; points ``(N, 2)`` float64
Random = np.random.Generator

WIDTH, HEIGHT = 320, 240  # of the photos that the network is trained on
SHAPE: Final = (HEIGHT, WIDTH)
SIZE: Final = np.array([WIDTH, HEIGHT], float)

_GARMENTS: Final = (  # lying flat, the half right of x = 0 from the collar to the hem, y down; about 2 high
    ((0, -0.9), (0.2, -1), (0.45, -0.95), (1, -0.45), (0.8, -0.2), (0.5, -0.45), (0.52, 0.2), (0.5, 1), (0, 1)),
    ((0, -0.95), (0.2, -1), (0.5, -0.9), (1, 0.5), (0.8, 0.6), (0.5, -0.2), (0.5, 0.9), (0, 0.92)),
    ((0, -1), (0.42, -1), (0.5, -0.3), (0.55, 1), (0.2, 1), (0.06, -0.3), (0, -0.3)),  # trousers
    ((0, -0.8), (0.12, -0.8), (0.18, -1), (0.28, -1), (0.3, -0.5), (0.25, -0.2), (0.65, 1), (0, 1.03)),
    ((0, -0.6), (0.35, -0.6), (0.75, 0.6), (0, 0.68)),
)


def rotation(rng: Random) -> Array:
    """Draw a rotation ``(2, 2)``; each of its rows is a direction."""
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]], np.float32)


def resample(points: Array, step: float = 1.0) -> Array:
    """Return the points of a polyline at equal distances of about ``step`` pixels."""
    arc = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    at = np.linspace(0, arc[-1], max(8, int(arc[-1] / step)))
    return np.stack([np.interp(at, arc, column) for column in points.T], 1)


def _spline(controls: Array) -> Array:
    """Return a uniform cubic B-spline near control points, from the second one to the last but one."""
    return resample(BSpline(np.arange(len(controls) + 4), controls, 3)(np.arange(3, len(controls), 1 / 40)))


def rope(rng: Random, width: float) -> Array:
    """Draw the centreline of a rope: as it was thrown down, across the photo, or through random places."""
    if rng.random() < 0.36:  # a random curvature: bows, loops, straight parts, coils at times
        arc = np.arange(0.0, rng.uniform(120, 1100))
        waves = [rng.uniform(-1, 1) * np.sin(arc / rng.uniform(25, 160) + rng.uniform(0, 7)) for _ in range(4)]
        curvature = np.sum(waves[: rng.integers(1, 5)], 0) + rng.choice([rng.uniform(-0.4, 0.4), 3], p=[0.8, 0.2])
        tightest = max(1.6 * width, rng.uniform(14, 90))  # radius in pixels
        heading = rng.uniform(0, 7) + np.cumsum(curvature / np.abs(curvature).max() / tightest)
        curve = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], 1), 0)
        return curve + rng.uniform(0.15, 0.85, 2) * SIZE - curve.mean(0)
    controls = rng.uniform(-1, 1, (rng.integers(5, 11), 2)) * (rng.uniform(100, 280), rng.uniform(5, 180))
    if rng.random() < 0.7:
        controls = controls[controls[:, 0].argsort()]
    curve = gaussian_filter1d(_spline(controls @ rotation(rng)), 1 + width, axis=0) + rng.normal(0.5, 0.15, 2) * SIZE
    return curve[int(max(0, rng.uniform(-0.8, 0.5)) * len(curve)) :]  # at times it ends in the photo


def _round(rng: Random, bumps: float, count: int = 48) -> Array:
    """Draw a closed curve around the origin of radius 1, with dents of strength ``bumps``, at times elongated."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    dents = [rng.normal(0, bumps / k) * np.cos(k * angle + rng.uniform(0, 7)) for k in range(2, 6)]
    stretched = [1, rng.uniform(0.25, 1) if rng.random() < 0.5 else 1]
    return np.stack([np.cos(angle), np.sin(angle)], 1) * np.clip(1 + np.sum(dents, 0), 0.3, None)[:, None] * stretched


def ring(rng: Random) -> Array:
    """Draw a closed curve, the first point twice: round, elongated or dented."""
    shape = _round(rng, 0.16) @ rotation(rng) * np.exp(rng.uniform(np.log(22), np.log(110)))
    return _spline(np.concatenate([shape, shape[:4]]) + rng.uniform(0.2, 0.8, 2) * SIZE)


def outline(rng: Random) -> Array:
    """Draw the outline of a sheet: cloth with four corners, a garment, a disc or a rounded blob."""
    kind = rng.choice(["cloth", "garment", "disc", "blob"], p=[0.42, 0.33, 0.12, 0.13])
    shape, scale = _round(rng, 0.15 * (kind == "blob")), np.exp(rng.uniform(np.log(35), np.log(120)))
    if kind == "cloth":
        corners = np.multiply([(-1, -1), (1, -1), (1, 1), (-1, 1)], [1, rng.uniform(0.35, 1)])
        shape = corners + rng.normal(0, 0.06, (4, 2))
    elif kind == "garment":
        half = np.multiply(_GARMENTS[rng.integers(len(_GARMENTS))], [rng.uniform(0.8, 1.25), 1])
        shape = np.concatenate([half, half[::-1] * [-1, 1]])
    shape = scale * (shape @ rotation(rng) if rng.random() < 0.6 else shape) + rng.uniform(0.25, 0.75, 2) * SIZE
    edge, softness = resample(np.concatenate([shape, shape[:1]]), 2.0), rng.uniform(0.02, 0.08) * scale
    edge = gaussian_filter1d(edge, softness, axis=0, mode="wrap")  # no corner of cloth is sharp
    sway = gaussian_filter1d(rng.standard_normal(edge.shape), rng.uniform(8, 30), axis=0, mode="wrap")
    return edge + sway / sway.std() * rng.uniform(0.003, 0.03) * scale  # and no edge quite straight


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
    for _ in range(rng.integers(0, 4)):
        crease = noise(rng, shape, rng.uniform(0.4, 1) * scale, rng.uniform(0.4, 3)) * rng.uniform(2, 8)
        crease *= 2 * np.exp(-crease * crease)  # a lit and a dark side
        field += crease * np.clip(noise(rng, shape, 0.5 * scale) + 0.3, 0, 1)
    return 1 + rng.uniform(0.03, 0.16) * field
