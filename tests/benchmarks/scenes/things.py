"""Draw what lies around on benches, and what reaches into a photo: tools, screws, boxes, papers, hands and grippers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from shape_obs.bench.scenes import SIZE
from tests.benchmarks.scenes.grounds import one_of
from tests.benchmarks.scenes.height_field import SQUARE, Array, axes
from tests.benchmarks.scenes.laid_objects import Look, Make, Print, Sheet, Strand

Things = list[Strand | Sheet]
_BRIGHT: Final = "c62f2b e0a020 2c62b0 222426 3a8a50 d8d8d4 6c7075"
_BOXES, _LABELS, _PAGES = "b08a5a 3a3c40 d8d6d0 285a8c 6f7478", "ecebe6 d0b040 303236", "efeeea 4a4c50 f4f2ec"
_METAL, _TAPES, _STEEL = "8f9296 b8babd 5c5a55 b09a60", "d8c8a0 202224 2858a0 e8e6e0 b83028", "26282b a9acb0 6d7074"
_SKIN, _CLOTH = "e0b090 c98f6c 8a5a3c f0c8a8 5c3b28 d8a07c", "38465c 9c9a94 20242a e6e2da"


def moved(each: Strand | Sheet, move: Callable[[Array], Array]) -> Strand | Sheet:
    """Return an object whose points are somewhere else."""
    if isinstance(each, Strand):
        return replace(each, curve=move(each.curve))
    return replace(each, outline=move(each.outline), flap=None if each.flap is None else move(each.flap))


def bent(rng: np.random.Generator, width: float) -> Array:
    """Return the axis of a rope that lies as it fell, ``(P, 2)`` at steps of a pixel, mostly inside the photo.

    Its heading is a sum of waves, so that it never bends more sharply than its width allows; it may cross itself.
    """
    length = float(np.clip(rng.uniform(300, 1100), 12 * width, 1400))
    share = np.linspace(0, 1, int(length))
    while True:
        bends = rng.normal(0, (1.7, 0.9, 0.5, 0.3, 0.15))
        heading = rng.uniform(0, 2 * np.pi) + sum(
            a * np.sin((k + 1) * np.pi * share + rng.uniform(0, 6)) for k, a in enumerate(bends)
        )
        if np.abs(np.gradient(heading)).max() > 1 / max(2.2 * width, 14):
            continue
        curve = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
        curve += rng.uniform((0.35, 0.35), (0.65, 0.65)) * SIZE[::-1] - (curve.min(axis=0) + curve.max(axis=0)) / 2
        inside = ((curve > 4) & (curve < np.array(SIZE[::-1]) - 4)).all(axis=1)
        if inside.mean() > rng.uniform(0.5, 1.0):
            return curve


def _look(rng: np.random.Generator, colours: str, gloss: float, make: Make = "smooth", print_: Print = "plain") -> Look:
    return Look(one_of(rng, colours), one_of(rng, colours), gloss, make, print_, seed=int(rng.integers(1 << 30)))


def _rod(at: Array, angle: float, begin: float, end: float, width: float, look: Look, *, lift: float = 0.0) -> Strand:
    """Return a straight strand between two distances from a place."""
    steps = np.linspace(begin, end, max(int(end - begin), 4))
    return Strand(at + steps[:, None] * axes(angle)[0], width, np.full(len(steps), lift), look, rounded=True)


def _slab(at: Array, angle: float, sides: Array, look: Look, thick: float) -> Sheet:
    """Return a rectangle."""
    outline = SQUARE * sides / 2 @ axes(angle) + at
    return Sheet(outline, outline, look, thick)


def clutter(rng: np.random.Generator, count: int) -> Things:
    """Return tools, screws, nuts, pens, boxes, papers and rolls of tape."""
    things: Things = []
    for _ in range(count):
        at, angle = rng.uniform((0, 0), SIZE[::-1]), float(rng.uniform(0, 2 * np.pi))
        what = int(rng.integers(8))
        if what == 0:  # a box, or a part of a machine, with a label
            sides = rng.uniform(40, 170, 2)
            things.append(_slab(at, angle, sides, _look(rng, _BOXES, 0.1), rng.uniform(4, 20)))
            sides *= rng.uniform(0.3, 0.7, 2)
            things.append(_slab(at, angle, sides, _look(rng, _LABELS, 0.1, print_="text"), 0.6))
        elif what == 1:
            sides = rng.uniform((150, 200), (260, 340))
            things.append(_slab(at, angle, sides, _look(rng, _PAGES, 0.05, print_="text"), 0.5))
        elif what == 2:  # a screwdriver
            wide, long = rng.uniform(16, 26), rng.uniform(60, 90)
            things.append(_rod(at, angle, 0, long, wide, _look(rng, _BRIGHT, 0.5, "ribbed")))
            end = long * rng.uniform(2, 2.6)
            things.append(_rod(at, angle, long, end, wide / 4, _look(rng, "a8abb0", 0.9), lift=wide / 3))
        elif what == 3:  # a pen with its cap
            long, wide, look = rng.uniform(120, 190), rng.uniform(6, 11), _look(rng, _BRIGHT, 0.6)
            things.append(_rod(at, angle, 0, long, wide, look))
            things.append(_rod(at, angle, 0.7 * long, long, 1.15 * wide, replace(look, colour=look.second)))
        elif what == 4:  # a roll of tape
            turn, radius, wide = np.linspace(0, 2 * np.pi, 300), rng.uniform(35, 70), rng.uniform(14, 26)
            ring = at + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
            things.append(Strand(ring, wide, np.full(300, 6.0), _look(rng, _TAPES, 0.3, "flat")))
        else:
            for _ in range(int(rng.integers(2, 9))):  # screws
                there, way = at + rng.normal(0, 45, 2), float(rng.uniform(0, 2 * np.pi))
                metal, wide = _look(rng, _METAL, 0.9), rng.uniform(4, 8)
                things.append(_rod(there, way, 0, rng.uniform(14, 34), wide, replace(metal, make="ribbed")))
                things.append(_rod(there, way, -0.7 * wide, 0.3 * wide, 1.9 * wide, metal, lift=1))
    return things


def hand(rng: np.random.Generator, at: Array, angle: float) -> Things:
    """Return a hand whose fingers are at a place, and that reaches to it from the direction opposite to ``angle``."""
    palm, skin = float(rng.uniform(75, 130)), _look(rng, _SKIN, 0.12)
    way, side = axes(angle)
    wrist, sleeve = at - way * 1.5 * palm, _look(rng, _CLOTH, 0.03) if rng.random() < 0.5 else skin
    parts: Things = [_rod(wrist, angle, -900, 0.2 * palm, 0.72 * palm, sleeve, lift=6)]
    parts.append(_rod(wrist, angle, 0, 0.55 * palm, palm, skin, lift=2))
    steps = np.linspace(0, 1, 80)
    for k, long in enumerate((0.8, 0.95, 1.0, 0.85)):
        bend = rng.normal(0, 0.12) + 0.12 * (k - 1.5)
        finger = palm * long * (steps[:, None] * way + (bend * steps**2)[:, None] * side)
        base = wrist + way * 0.5 * palm + side * (k - 1.5) * 0.23 * palm
        parts.append(Strand(base + finger, 0.24 * palm, np.linspace(0.5 * palm, 12, 80), skin, rounded=True))
    thumb = wrist + way * 0.2 * palm - side * 0.4 * palm
    parts.append(_rod(thumb, angle - rng.uniform(0.2, 0.8), 0, 0.75 * palm, 0.27 * palm, skin, lift=0.3 * palm))
    return parts


def gripper(rng: np.random.Generator, at: Array, angle: float) -> Things:
    """Return the two jaws of a gripper that closes at a place, and its palm."""
    look, wide, long = _look(rng, _STEEL, 0.4), rng.uniform(14, 30), rng.uniform(50, 110)
    way, side = axes(angle)
    parts: Things = []
    for k in (-1, 1):
        middle = at - way * long / 2 + side * k * rng.uniform(0.8, 1.4) * wide
        parts.append(_slab(middle, angle, np.array([long, wide]), look, 30))
    palm = replace(look, colour=look.second)
    return [*parts, _slab(at - way * (long + 200), angle, np.array([420, 5 * wide]), palm, 40)]
