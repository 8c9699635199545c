"""Propose the axis of a rope on a table: anywhere, across another one, to and fro across it, or in contact with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from tests.benchmarks.scenes.ropes import Curve, from_heading, resample, rotation

GAP: Final = 3.0  # pixels between the borders of strands that do not touch
_LENGTH: Final = (350.0, 1100.0)  # pixels, before the axis is cut
# In widths:
_BESIDE: Final = (0.9, 1.1)  # distance of the axes of ropes in contact
_CONTACT: Final = (3.0, 16.0)  # length of the contact
_AGAINST: Final = (0.2, 0.6)  # distance of a tip from the axis of the rope on whose border it lies


@dataclass(frozen=True)
class Table:
    """What ropes are laid on, and how.

    Args:
        size: ``(H, W)`` of the image.
        width: Thickness of the ropes in pixels.
        leaving: Probability that a rope may leave the image.
        touching: Whether one of the ropes touches another one.
        smallest_angle: The smallest angle of crossings, in radians.
        narrowest: The smallest inner radius of loops, in widths.
    """

    size: tuple[int, int]
    width: float
    leaving: float
    touching: bool
    smallest_angle: float
    narrowest: float


class Meeting(NamedTuple):
    """A crossing of curves ``i`` and ``j`` at indices ``a`` and ``b``; or a contact, over ``reach`` points each way."""

    i: int
    a: float
    j: int
    b: float
    place: Curve
    angle: float
    reach: float = 0.0


def axis(rng: np.random.Generator, table: Table, loops: int) -> Curve:
    """Return a curve with slow waves, a steady curl and loops."""
    width = table.width
    n = int(rng.uniform(max(_LENGTH[0], min(200.0 * loops, 600.0)), _LENGTH[1]))
    t = np.linspace(0, 1, n)
    wild = rng.uniform(0.5, 2.0)
    waves = sum(rng.normal(0, wild / k) * np.sin(np.pi * k * t + rng.uniform(0, 2 * np.pi)) for k in range(1, 7))
    bend = np.gradient(np.asarray(waves) + rng.normal(0, 0.5 * np.pi) * t)
    for k in range(loops):
        radius = (rng.uniform(table.narrowest, table.narrowest + 4.0) + 0.5) * width
        turn = rng.uniform(7, 10) * np.pi / 6
        middle = (k + rng.uniform(0.3, 0.7)) / loops * n
        bend[np.abs(np.arange(n) - middle) < turn * radius / 2] = int(rng.choice([-1, 1])) / radius
    return from_heading(np.cumsum(gaussian_filter1d(bend, 0.7 * width)))


def anywhere(rng: np.random.Generator, flat: Curve, table: Table) -> Curve:
    """Turn a curve at random and move one of its points into the image."""
    place = rng.uniform(0, 1, 2) * table.size[::-1]
    return _moved(flat, int(rng.integers(len(flat))), place, rng.uniform(0, 2 * np.pi))


def across(rng: np.random.Generator, flat: Curve, curves: Sequence[Curve], table: Table) -> Curve | None:
    """Lay a curve over one that is there, at a random angle and place."""
    under, edge = curves[int(rng.integers(len(curves)))], round(4 * table.width)
    if min(len(under), len(flat)) <= 2 * edge + 2:
        return None
    a, b = int(rng.integers(edge, len(flat) - edge)), int(rng.integers(edge, len(under) - edge))
    # Acute angles find less room; they are proposed more often.
    angle = table.smallest_angle + (np.pi / 2 - table.smallest_angle) * rng.random() ** 2
    angle = angle * rng.choice([-1, 1]) + np.pi * rng.integers(2)
    return _moved(flat, a, under[b], _heading(under, b) + angle)


def weaving(rng: np.random.Generator, flat: Curve, curves: Sequence[Curve], times: int, table: Table) -> Curve | None:
    """Lay a curve along one that is there, to and fro across it; its ends go their own way."""
    under, width = curves[int(rng.integers(len(curves)))], table.width
    half = rng.uniform(5.0, 12.0) * width + rng.uniform(0, 40)
    times = min(times, int((len(under) - 6 * width) / half))
    if times < 2:
        return None
    start = rng.uniform(2 * width, len(under) - half * times - 2 * width)
    at = np.arange(max(start - half / 2, 0), min(start + half * (times - 0.5), len(under) - 1))
    # Over wide waves it does not follow every bend.
    smooth = gaussian_filter1d(under, rng.uniform(0.1, 0.5) * half, axis=0, mode="nearest")
    base = np.stack([np.interp(at, np.arange(len(under)), smooth[:, d]) for d in range(2)], axis=1)
    along = np.gradient(base, axis=0)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    # The waves' slope where they cross, and room between them.
    size = max(np.tan(rng.uniform(table.smallest_angle, 1.1)) * half / np.pi, width + GAP)
    wave = size * np.sin(np.pi * (at - start) / half) * rng.choice([-1, 1])
    middle = resample(base + wave[:, None] * normal, 1.0)
    k = int(rng.integers(len(flat) // 4, 3 * len(flat) // 4))
    ends = np.sort(rng.uniform(60, 300, 2)).astype(int)
    before = _moved(flat[: min(k, ends[0])][::-1], 0, middle[0], _heading(middle, 0) + np.pi)
    after = _moved(flat[k : k + ends[1]], 0, middle[-1], _heading(middle, len(middle) - 1))
    whole = gaussian_filter1d(np.concatenate([before[:0:-1], middle, after[1:]]), width, axis=0, mode="nearest")
    return resample(whole, 1.0)


def leaning(
    rng: np.random.Generator, flat: Curve, curves: Sequence[Curve], table: Table
) -> tuple[Curve | None, Meeting | None]:
    """Lay a curve down that touches another one: for some widths side by side, or with its tip."""
    width, other, side = table.width, int(rng.integers(len(curves))), int(rng.choice([-1, 1]))
    under = curves[other]
    reach = round(rng.uniform(*_CONTACT) * width / 2)
    edge = reach + round(3 * width)
    if len(under) <= 2 * edge:
        return None, None
    b = int(rng.integers(edge, len(under) - edge))
    along = np.gradient(under, axis=0)
    normal = side * np.stack([-along[:, 1], along[:, 0]], axis=1)
    if rng.integers(2):
        away = _heading(under, b) + side * rng.uniform(np.pi / 6, 5 * np.pi / 6)
        curve = _moved(flat, 0, under[b] + rng.uniform(*_AGAINST) * width * normal[b], away)
        return curve, Meeting(len(curves), 0.0, other, float(b), under[b], 0.0, 4 * width)
    stretch = slice(b - reach, b + reach + 1)
    beside = resample(under[stretch] + rng.uniform(*_BESIDE) * width * normal[stretch], 1.0)
    step = np.diff(beside, axis=0)
    course = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    # Beyond both ends of the contact it bends away, and then goes its own way.
    step = np.diff(flat, axis=0)
    bends = np.gradient(np.unwrap(np.arctan2(step[:, 1], step[:, 0])))
    k, turns = int(rng.integers(len(bends) // 4, 3 * len(bends) // 4)), []
    for rest in (bends[:k], bends[k:]):
        radius = rng.uniform(4, 9) * width
        first = np.full(round(radius * rng.uniform(0.5, 1.2)), 1 / radius)
        turns.append(side * np.cumsum(np.concatenate([first, rest])))
    curve = from_heading(np.concatenate([course[0] - turns[0][::-1], course, course[-1] + turns[1]]))
    middle = len(turns[0]) + len(course) // 2
    curve = curve - curve[middle] + beside[len(course) // 2]
    return curve, Meeting(len(curves), float(middle), other, float(b), under[b], 0.0, reach + 5 * width)


def _heading(curve: Curve, k: int) -> float:
    step = curve[min(k + 1, len(curve) - 1)] - curve[max(k - 1, 0)]
    return float(np.arctan2(step[1], step[0]))


def _moved(curve: Curve, k: int, to: Curve, heading: float) -> Curve:
    """Move point k of a curve to a place, and turn its direction there to a heading."""
    return (curve - curve[k]) @ rotation(heading - _heading(curve, k)).T + to
