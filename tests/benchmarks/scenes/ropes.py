"""Draw ropes of many forms, at rest and bending, with a known centreline."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, Literal, get_args

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from shape_obs.bench.scenes import SIZE, Rope, draw_rope, from_heading, resample, rotation

Curve = npt.NDArray[np.float64]
Kind = Literal["smooth", "u", "s", "hairpin", "loop", "spiral", "fat"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)
Bend = Literal["hairpin", "s-bends", "omega", "coil", "waves"]
BENDS: Final[tuple[Bend, ...]] = get_args(Bend)
_TRIES: Final = 2000
_FINE: Final = 100  # steps to a width of a bent rope


def random_rope(rng: np.random.Generator, kind: Kind = "smooth", size: tuple[int, int] = SIZE) -> Rope:
    """Draw a rope 8 to 16 px thick that neither crosses nor touches itself, inside an image of ``size`` ``(H, W)``."""
    for _ in range(_TRIES):
        width = float(rng.uniform(8, 16))
        curve = place(resample(_formed(rng, kind, width), 1.0), rng, size, width)
        if curve is not None and not _touches(curve, width):
            return draw_rope(curve, width, flat_caps=bool(rng.integers(2)), size=size, kind=kind)
    raise RuntimeError(f"no {kind} rope found that fits {size[1]} x {size[0]} pixels without touching itself.")


def bent_rope(rng: np.random.Generator, bend: Bend, radius: float, width: float) -> Rope:
    """Draw a rope ``width`` px thick that touches itself nowhere; its tightest bends measure ``radius`` widths."""
    for _ in range(_TRIES):
        curve = place(resample(_bent(rng, bend, radius) * width, 1.0), rng, SIZE, width)
        if curve is not None and not _touches(curve, width):
            return draw_rope(curve, width, flat_caps=bool(rng.integers(2)), kind=bend)
    raise RuntimeError(f"no {bend} of radius {radius} widths found that fits the image without touching itself.")


def bending_rope(radius: float, width: float, frames: int = 60, length: float = 24.0) -> Iterator[Rope]:
    """Draw a straight rope that bends in its middle, frame by frame, to a hairpin; its middle stays in place.

    Args:
        radius: Of the bend at the end, widths.
        width: Thickness in pixels.
        frames: How many.
        length: Of the rope, widths.
    """
    at = np.arange(-length * width / 2, length * width / 2)
    for share in np.linspace(0, 1, frames):
        curve = from_heading(np.clip(at / (np.pi * radius * width), -0.5, 0.5) * np.pi * share)
        yield draw_rope(curve - curve[len(curve) // 2] + np.array(SIZE[::-1]) / 2 + 0.37, width, kind="bending")


def bend_radius(rope: Rope) -> float:
    """Return the radius of a rope's tightest bend in pixels, measured over half a turn of it."""
    heading, reach = headings(rope.curve), max(round(1.5 * rope.width), 1)
    turn = np.abs(heading[reach:] - heading[:-reach]).max(initial=0.0)
    return float(reach * rope.length / len(heading) / max(turn, 1e-6))


def headings(curve: Curve) -> npt.NDArray[np.float64]:
    """Return the direction from each point to the next in radians, without jumps, ``(P - 1,)``."""
    step = np.diff(curve, axis=0)
    return np.unwrap(np.arctan2(step[:, 1], step[:, 0]))


def normals(curve: Curve) -> Curve:
    """Return the unit normal at each point, to the right of the direction as seen, ``(P, 2)``."""
    along = np.gradient(curve, axis=0)
    return np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)


def arcs(*pieces: tuple[float, float]) -> Curve:
    """Join pieces of (length, turned angle) smoothly."""
    return from_heading(np.cumsum(np.concatenate([np.full(int(n), angle / int(n)) for n, angle in pieces])))


def place(curve: Curve, rng: np.random.Generator, size: tuple[int, int], width: float) -> Curve | None:
    """Turn a curve at random, maybe mirror it, and move it inside the image; None if it does not fit."""
    curve = curve @ rotation(rng.uniform(0, 2 * np.pi)).T
    if rng.integers(2):
        curve = curve[:, ::-1]
    low, high = curve.min(axis=0), curve.max(axis=0)
    room = np.array([size[1], size[0]]) - 2 * (width + 4) - (high - low)
    return None if np.any(room < 0) else curve - low + width + 4 + room * rng.uniform(size=2)


def _formed(rng: np.random.Generator, kind: Kind, width: float) -> Curve:
    """Return the axis of a rope of some kind in pixels."""
    if kind == "smooth":
        t = np.linspace(0, 1, int(rng.uniform(250, 800)))
        waves = [rng.normal(0, 1.6 / k) * np.sin(np.pi * k * t + rng.uniform(0, 2 * np.pi)) for k in range(1, 5)]
        return from_heading(np.sum(waves, axis=0))
    if kind == "u":
        radius, arm = rng.uniform(2.5, 7) * width, rng.uniform(60, 220)
        return arcs((arm, 0.0), (np.pi * radius, np.pi), (arm * rng.uniform(0.5, 1), 0.0))
    if kind == "s":
        bend, arm = np.pi * rng.uniform(2.5, 6) * width, rng.uniform(40, 160)
        return arcs((arm, 0.0), (bend, np.pi), (arm, 0.0), (bend, -np.pi), (arm, 0.0))
    if kind == "hairpin":
        radius, arm = rng.uniform(0.95, 1.4) * width, rng.uniform(100, 260)
        return arcs((arm, 0.0), (np.pi * radius, np.pi), (arm * rng.uniform(0.6, 1), 0.0))
    if kind == "loop":
        radius = rng.uniform(60, 150)
        around = 2 * np.pi - width * rng.uniform(1.8, 2.5) / radius
        return arcs((around * radius, around))
    if kind == "spiral":
        turns, pitch = rng.uniform(1.3, 2.4), rng.uniform(2.0, 3.5) * width
        return _coil(rng.uniform(1.8, 3) * width, pitch, turns)
    half = rng.uniform(4, 7) * width / 2
    return arcs((half, rng.uniform(-0.6, 0.6)), (half, rng.uniform(-0.6, 0.6)))


def _bent(rng: np.random.Generator, bend: Bend, radius: float) -> Curve:
    """Return the axis of a rope of width 1."""
    first, last, many = rng.uniform(6, 14), rng.uniform(8, 14), int(rng.integers(2, 9))
    pieces = [(np.pi * radius, np.pi)]
    if bend == "coil":
        turns, pitch = rng.uniform(1.2, 5), rng.uniform(1.9, 2.5)
        return _coil(radius, pitch, turns)
    if bend == "waves":
        angle, height = np.linspace(0, 2 * np.pi * many, 3000), rng.uniform(1.0, 3.0)
        return np.stack([angle * np.sqrt(radius * height), height * np.cos(angle)], axis=1)
    if bend == "s-bends":
        turn, between = rng.uniform(2.2, np.pi), rng.uniform(0, 14)
        pieces = [piece for sign in (1, -1) for piece in ((turn * radius, sign * turn), (between, 0.0))] * many
    elif bend == "omega":
        neck = rng.uniform(0.2, 0.6)
        side, around = (radius * (neck + np.pi / 2), -neck - np.pi / 2), np.pi + 2 * neck
        pieces = [side, (radius * around, around), side]
    pieces = [(first, 0.0), *pieces, (last, 0.0)]
    return arcs(*((_FINE * length, turn) for length, turn in pieces if length > 0.1)) / _FINE


def _coil(radius: float, pitch: float, turns: float) -> Curve:
    angle = np.linspace(0, 2 * np.pi * turns, 3000)
    return (radius + pitch * angle / (2 * np.pi))[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _touches(curve: Curve, width: float) -> bool:
    """Return whether strands are closer than the width and a gap of 3 px, or bend tighter than the ribbon allows."""
    pairs = KDTree(curve).query_pairs(width + 3, output_type="ndarray")
    return bool(np.any(np.abs(pairs[:, 1] - pairs[:, 0]) > np.pi / 2 * (width + 3) + 2))
