"""Draw ropes that cross themselves, are cut by an occluder, or have strands side by side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import SIZE, draw_rope, resample
from tests.scenes.layouts import Table, is_tight, meetings, place_ropes
from tests.scenes.ropes import Curve, arcs, place

_TRIES: Final = 2000
_APART: Final = 4.0  # widths from one crossing to the next
# Cuts: the longest hidden stretch over the occluder's width; the shortest visible stretch, in widths and as a share of
# everything visible (``find_region`` drops less as noise); the distance from the occluder to a crossing, in widths.
_HIDDEN: Final = 1.5
_SEEN: Final = 3.0
_SEEN_SHARE: Final = 0.06
_CLEAR: Final = 2.0


@dataclass(frozen=True)
class Tangle:
    """A drawn rope whose mask is not a simple ribbon."""

    curve: Curve  # the centreline from tip to tip, (P, 2) pixels, at steps of about a pixel
    width: float  # thickness in pixels
    mask: npt.NDArray[np.uint8]  # the visible part, (H, W) uint8, 0 or 255
    crossings: Curve  # positions of the self-crossings, (C, 2) pixels
    hidden: npt.NDArray[np.bool_]  # the points of curve under an occluder, (P,) bool


def crossing_rope(rng: np.random.Generator, crossings: int) -> Tangle:
    """Draw a rope 8 to 16 px thick that crosses itself ``crossings`` times, at 25 degrees or more.

    Crossings are at least four widths apart; elsewhere strands do not touch.
    """
    for _ in range(_TRIES):
        width = float(rng.uniform(8, 16))
        table = Table(SIZE, width, smallest_angle=np.deg2rad(25), apart=_APART)
        placed = place_ropes(rng, 1, crossings, table)
        if placed is not None:
            return _drawn(rng, placed[0][0], width, np.array([each.place for each in placed[1]]).reshape(-1, 2))
    raise RuntimeError(f"no rope with {crossings} crossings found that fits the image.")


def touching_rope(rng: np.random.Generator) -> Tangle:
    """Draw a rope with two touching strands, 0.85 to 1.15 widths from centre to centre over 2 to 12 widths.

    The rope returns from a bend (a keyhole) or goes once around (a spiral), so that the strands run in opposite or in
    equal directions.
    """
    for _ in range(_TRIES):
        width = float(rng.uniform(8, 16))
        flat = (_keyhole if rng.integers(2) else _once_around)(rng) * width
        curve = place(resample(_bent(resample(flat, 1.0), rng), 1.0), rng, SIZE, width)
        if curve is not None and not is_tight(curve, width) and not meetings(curve, []):
            return _drawn(rng, curve, width, np.zeros((0, 2)))
    raise RuntimeError("no touching rope found that fits the image.")


def cut_rope(rng: np.random.Generator, crossings: int, band: float) -> Tangle:
    """Draw a rope under an occluder: a straight band, ``band`` pixels wide, as long as the image.

    Every stretch under the band passes from one side to the other, every visible stretch is long enough to be
    recognised as rope, and the band covers no crossing.
    """
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    for _ in range(_TRIES):
        whole = crossing_rope(rng, crossings)
        for _ in range(20):
            angle = rng.uniform(0, np.pi)
            normal = np.array([np.cos(angle), np.sin(angle)])
            middle = whole.curve[rng.integers(len(whole.curve))] @ normal
            across = whole.curve @ normal - middle
            hidden = np.abs(across) <= band / 2
            clear = np.abs(whole.crossings @ normal - middle) > band / 2 + _CLEAR * whole.width
            if clear.all() and _is_passed(across, hidden, whole.width, band):
                seen = np.abs(columns * normal[0] + rows * normal[1] - middle) > band / 2
                mask = np.where(seen, whole.mask, np.uint8(0))
                return Tangle(whole.curve, whole.width, mask, whole.crossings, hidden)
    raise RuntimeError(f"no cut of {band} pixels found that every strand passes.")


def _drawn(rng: np.random.Generator, curve: Curve, width: float, crossings: Curve) -> Tangle:
    rope = draw_rope(curve, width, flat_caps=bool(rng.integers(2)))
    return Tangle(rope.curve, width, rope.mask, crossings, np.zeros(len(rope.curve), bool))


def _keyhole(rng: np.random.Generator) -> Curve:
    """Return a curve in widths along a line, around a bulb, back next to the line, and to the side."""
    apart, stretch, out, tail = (rng.uniform(*limits) for limits in ((0.85, 1.15), (2, 12), (4, 10), (5, 12)))
    opening, radius, part = rng.uniform(0.8, 1.1), rng.uniform(2.5, 4), rng.uniform(0.5, 1.4)
    # The bulb for which the way back runs at this distance from the way out.
    bulb = (apart / 2 + radius * (1 - np.cos(opening))) / np.cos(opening)
    half = ((radius * opening, -opening), (bulb * (np.pi / 2 + opening), np.pi / 2 + opening))
    return _fine_arcs((out + stretch, 0.0), *half, *half[::-1], (stretch, 0.0), (radius * part, -part), (tail, 0.0))


def _once_around(rng: np.random.Generator) -> Curve:
    """Return a curve in widths along a line, once around, and along the outer side of the line again."""
    apart, stretch, inner, out = (rng.uniform(*limits) for limits in ((0.85, 1.15), (2, 12), (4.5, 8), (4, 8)))
    part, radius = rng.uniform(0.5, 1.0, size=2), rng.uniform(2.5, 4)
    return _fine_arcs(
        *((rng.uniform(3, 5), 0.0), (radius * part[0], part[0]), (stretch, 0.0), (np.pi * inner, np.pi)),
        *((stretch + out, 0.0), (np.pi * (inner + apart / 2), np.pi), (out + stretch, 0.0)),
        *((radius * part[1], -part[1]), (rng.uniform(5, 12), 0.0)),
    )


def _fine_arcs(*pieces: tuple[float, float]) -> Curve:
    return arcs(*((100 * length, turn) for length, turn in pieces)) / 100


def _bent(curve: Curve, rng: np.random.Generator) -> Curve:
    """Bend the plane about a far centre: lines become arcs, the distances across them stay."""
    radius = rng.uniform(400, 1500) * rng.choice([-1, 1])
    curve = curve - curve.mean(axis=0)
    angle, reach = curve[:, 0] / radius, radius - curve[:, 1]
    return np.stack([reach * np.sin(angle), radius - reach * np.cos(angle)], axis=1)


def _is_passed(across: npt.NDArray[np.float64], hidden: npt.NDArray[np.bool_], width: float, band: float) -> bool:
    """Return whether a band, at distances ``across`` from its middle line, cuts the rope cleanly between its tips."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], hidden, [False]]).astype(int)))
    if len(edges) == 0:
        return False
    starts, ends = edges[::2], edges[1::2]
    seen = np.append(starts, len(hidden)) - np.concatenate([[0], ends])
    if seen.min() < max(_SEEN * width, _SEEN_SHARE * seen.sum()):
        return False
    passed = across[starts - 1] * across[np.minimum(ends, len(hidden) - 1)] < 0
    return bool(np.all(passed) and np.all(ends - starts <= _HIDDEN * band + width))
