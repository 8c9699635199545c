"""Draw ropes of many forms with a known centreline, which neither cross nor touch themselves."""

from __future__ import annotations

from typing import Final, Literal, get_args

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from shape_obs.bench.scenes import SIZE, Rope, draw_rope, from_heading, resample, rotation

Curve = npt.NDArray[np.float64]
Kind = Literal["smooth", "u", "s", "hairpin", "omega", "waves", "loop", "spiral", "fat"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)
_TRIES: Final = 4000


def random_rope(
    rng: np.random.Generator, kind: Kind = "smooth", size: tuple[int, int] = SIZE, width: float | None = None
) -> Rope:
    """Draw a rope inside an image of ``size`` ``(H, W)``; it is ``width`` pixels thick, by default 8 to 16."""
    for _ in range(_TRIES):
        thick = float(rng.uniform(8, 16)) if width is None else width
        curve = place(resample(_formed(rng, kind, thick), 1.0), rng, size, thick)
        if curve is not None and not _touches(curve, thick):
            return draw_rope(curve, thick, flat_caps=bool(rng.integers(2)), size=size, kind=kind)
    raise RuntimeError(f"no {kind} rope found that fits {size[1]} x {size[0]} pixels without touching itself.")


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
    tight = rng.uniform(1.5, 3) * width
    if kind == "smooth":
        t = np.linspace(0, 1, int(rng.uniform(250, 800)))
        waves = [rng.normal(0, 1.6 / k) * np.sin(np.pi * k * t + rng.uniform(0, 2 * np.pi)) for k in range(1, 5)]
        return from_heading(np.sum(waves, axis=0))
    if kind == "waves":
        angle, height = np.linspace(0, 2 * np.pi * rng.integers(2, 6), 3000), rng.uniform(1, 3) * width
        return np.stack([angle * np.sqrt(tight * height), height * np.cos(angle)], axis=1)
    if kind == "spiral":
        angle, pitch = np.linspace(0, 2 * np.pi * rng.uniform(1.2, 4), 3000), rng.uniform(1.9, 3.5) * width
        return (tight + pitch * angle / (2 * np.pi))[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    if kind == "loop":
        radius = rng.uniform(60, 150)
        around = 2 * np.pi - width * rng.uniform(1.8, 2.5) / radius
        return arcs((around * radius, around))
    if kind == "fat":
        half = rng.uniform(4, 7) * width / 2
        return arcs((half, rng.uniform(-0.6, 0.6)), (half, rng.uniform(-0.6, 0.6)))
    neck = np.pi / 2 + rng.uniform(0.2, 0.6)
    bends = {  # radius and turned angle
        "u": [(rng.uniform(2.5, 7) * width, np.pi)],
        "hairpin": [(rng.uniform(0.95, 1.4) * width, np.pi)],
        "s": [(tight, np.pi), (tight, -np.pi)] * int(rng.integers(1, 5)),
        "omega": [(tight, -neck), (tight, 2 * neck), (tight, -neck)],
    }[kind]
    first, last = rng.uniform(60, 220, 2)
    return arcs((first, 0.0), *((radius * abs(turn), turn) for radius, turn in bends), (last, 0.0))


def _touches(curve: Curve, width: float) -> bool:
    """Return whether strands are closer than the width and a gap of 3 px, or bend tighter than the ribbon allows."""
    pairs = KDTree(curve).query_pairs(width + 3, output_type="ndarray")
    return bool(np.any(np.abs(pairs[:, 1] - pairs[:, 0]) > np.pi / 2 * (width + 3) + 2))
