"""Patterns that surfaces are printed with: fields of numbers 0 ... 1, drawn anew for each episode."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

Field = NDArray[Any]  # float32
Shape = tuple[int, int]
Rng = np.random.Generator


def draw_pattern(rng: Rng, kind: str, shape: Shape, cell: float) -> Field:
    """Draw a pattern.

    Args:
        rng: Draws it.
        kind: One of `PATTERNS`.
        shape: (H, W) of the field.
        cell: How large its parts are, in texels.

    Returns:
        (H, W) float32, 0 ... 1.
    """
    return np.clip(PATTERNS[kind](rng, shape, max(cell, 1.0)), np.float32(0), np.float32(1))


def smooth_noise(rng: Rng, shape: Shape, cell: float) -> Field:
    """Smooth noise (H, W), 0 ... 1, whose hills are about `cell` texels apart."""
    coarse = [max(2, round(side / cell) + 1) for side in shape]
    grid = rng.random(coarse, np.float32)
    return np.clip(cv2.resize(grid, shape[::-1], interpolation=cv2.INTER_CUBIC), 0, 1)  # a cubic overshoots


def _plain(rng: Rng, shape: Shape, cell: float) -> Field:
    return np.zeros(shape, np.float32)


def _noise(rng: Rng, shape: Shape, cell: float) -> Field:
    octaves = [smooth_noise(rng, shape, size * cell) for size in (2.0, 1.0, 0.5)]
    return (4 * octaves[0] + 2 * octaves[1] + octaves[2]) / 7


def _checker(rng: Rng, shape: Shape, cell: float) -> Field:
    along, across = _turned(rng, shape, cell)
    return _part(np.float32(0.5) * (np.floor(along) + np.floor(across))) * np.float32(2)


def _stripes(rng: Rng, shape: Shape, cell: float) -> Field:
    along, _ = _turned(rng, shape, 2 * cell)
    return (_part(along) < rng.uniform(0.2, 0.8)).astype(np.float32)


def _tiles(rng: Rng, shape: Shape, cell: float) -> Field:
    along, across = _turned(rng, shape, 2 * cell)
    return (np.minimum(_part(along), _part(across)) < np.float32(0.08)).astype(np.float32)


def _wood(rng: Rng, shape: Shape, cell: float) -> Field:
    """Rings of a tree, cut along its trunk: stripes that noise has drawn out and bent."""
    along, across = _turned(rng, shape, cell)
    bend = np.float32(4) * smooth_noise(rng, shape, 12 * cell)
    grain = smooth_noise(rng, shape, max(1.0, cell / 8))
    rings = np.sin(np.float32(2 * np.pi) * (np.float32(0.7) * across + np.float32(0.03) * along + bend))
    return np.float32(0.4) + np.float32(0.4) * rings + np.float32(0.2) * grain


def _speckle(rng: Rng, shape: Shape, cell: float) -> Field:
    return np.clip(8 * (smooth_noise(rng, shape, cell / 2) - 0.7), 0, 1)


def _part(values: Field) -> Field:
    """What is behind the point."""
    return values - np.floor(values)


def _turned(rng: Rng, shape: Shape, cell: float) -> tuple[Field, Field]:
    """Coordinates (H, W) along two axes at right angles, in cells, turned and shifted at random."""
    turn = rng.uniform(0, np.pi)
    u, v = (np.arange(side, dtype=np.float32) / cell for side in shape[::-1])
    cos, sin = np.float32(np.cos(turn)), np.float32(np.sin(turn))
    first, second = rng.random(2, np.float32)
    return cos * u + sin * v[:, None] + first, cos * v[:, None] - sin * u + second


PATTERNS: Final[dict[str, Callable[[Rng, Shape, float], Field]]] = {
    "plain": _plain,
    "noise": _noise,
    "checker": _checker,
    "stripes": _stripes,
    "tiles": _tiles,
    "wood": _wood,
    "speckle": _speckle,
}
