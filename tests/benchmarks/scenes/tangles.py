"""Draw ropes that cross themselves, are cut by an occluder, or have strands side by side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import minimum_filter1d
from scipy.spatial import KDTree

from tests.benchmarks.scenes.ropes import SIZE, Curve, arcs, draw_rope, from_heading, place, resample

_TRIES: Final = 20000
_GAP: Final = 3  # pixels between strands that do not touch, as in ``ropes``
# In widths: the smallest distance between crossings, and the shortest piece of rope beyond the last one.
_APART: Final = 4.0
_TAIL: Final = 4.0
_CENTRES_APART: Final = (0.85, 1.15)  # distance of the centres of touching strands, in widths
_CONTACT: Final = (2.0, 12.0)  # length over which they touch, in widths
_TIGHTEST: Final = 1.5  # the smallest bend radius, in widths
_MIN_ANGLE: Final = np.deg2rad(25)
# Cuts: the longest hidden stretch over the occluder's width; the shortest visible stretch, in widths and as a share of
# everything visible (``find_region`` drops less as noise); the distance from the occluder to a crossing, in widths.
_HIDDEN: Final = 1.5
_SEEN: Final = 3.0
_SEEN_SHARE: Final = 0.06
_CLEAR: Final = 2.0
# ``is_traversed``, in widths: the largest distance of a right curve from its strand, the same where it is hidden, and
# the length by which it may miss a tip.
_OFF: Final = 0.5
_OFF_HIDDEN: Final = 2.0
_MISSED_TIP: Final = 2.0
_TIP: Final = 1.0  # ignored length of the found curve at its tips, which ``scores`` measures
# Steps along the truth over steps along the found curve.
_PACE: Final = (0.1, 3.0)


@dataclass(frozen=True)
class Tangle:
    """A drawn rope whose mask is not a simple ribbon.

    Args:
        curve: The centreline from tip to tip, ``(P, 2)`` pixels, at steps of about a pixel.
        width: Thickness in pixels.
        mask: The visible part, ``(H, W)`` uint8, 0 or 255.
        crossings: Positions of the self-crossings, ``(C, 2)`` pixels.
        hidden: The points of ``curve`` under an occluder, ``(P,)`` bool.
    """

    curve: Curve
    width: float
    mask: npt.NDArray[np.uint8]
    crossings: Curve
    hidden: npt.NDArray[np.bool_]


class Meeting(NamedTuple):
    """A self-crossing: arc indices of both strands, the position and the acute angle."""

    first: int
    second: int
    place: Curve
    angle: float


def crossing_rope(rng: np.random.Generator, crossings: int) -> Tangle:
    """Draw a rope 8 to 16 px thick that crosses itself ``crossings`` times, at 25 degrees or more.

    Crossings are at least four widths apart, and from the tips along the rope; elsewhere strands do not touch.
    """
    for _ in range(_TRIES):
        width = float(rng.uniform(8, 16))
        tangle = _crossed(_curly(rng, width, crossings), rng, width, crossings, _TIGHTEST)
        if tangle is not None:
            return tangle
    raise RuntimeError(f"no rope with {crossings} crossings found that fits the image.")


def looped_rope(rng: np.random.Generator, radius: float, width: float) -> Tangle:
    """Draw a rope ``width`` px thick with one to three loops, ``radius`` widths, where it crosses itself once each."""
    loops = int(rng.integers(1, 4))
    for _ in range(_TRIES):
        turn, ends = rng.uniform(7, 9.5) * np.pi / 6, rng.uniform(8, 14, 2) * width
        pieces = [(turn * radius * width, turn), (rng.uniform(7, 12) * width, 0.0)] * loops
        flat = _bent(arcs((ends[0], 0.0), *pieces[:-1], (ends[1], 0.0)), rng)
        tangle = _crossed(flat, rng, width, loops)
        if tangle is not None:
            return tangle
    raise RuntimeError(f"no rope with {loops} loops of radius {radius} widths found that fits the image.")


def _crossed(
    flat: Curve, rng: np.random.Generator, width: float, crossings: int, tightest: float = 0.0
) -> Tangle | None:
    """Place and draw a curve if it fits the image, crosses itself so often and touches itself nowhere else.

    Args:
        flat: ``(P, 2)`` pixels.
        rng: Draws the place and the form of the tips.
        width: Of the rope, pixels.
        crossings: How many.
        tightest: The smallest bend radius, widths.
    """
    curve = _placed(flat, rng, width)
    if curve is None:
        return None
    found = meetings(curve)
    if len(found) != crossings or not _is_clear(curve, width, found) or not _turns_gently(curve, width, tightest):
        return None
    rope = draw_rope(curve, width, flat_caps=bool(rng.integers(2)))
    places = np.array([meeting.place for meeting in found]).reshape(-1, 2)
    return Tangle(rope.curve, width, rope.mask, places, np.zeros(len(rope.curve), bool))


def cut_rope(rng: np.random.Generator, crossings: int, band: float) -> Tangle:
    """Draw a rope under an occluder: a straight band, ``band`` pixels wide, as long as the image.

    Every stretch under the band passes from one side to the other, every visible stretch is long enough to be
    recognised as rope, and the band covers no crossing.
    """
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
                rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
                seen = np.abs(columns * normal[0] + rows * normal[1] - middle) > band / 2
                mask = np.where(seen, whole.mask, np.uint8(0))
                return Tangle(whole.curve, whole.width, mask, whole.crossings, hidden)
    raise RuntimeError(f"no cut of {band} pixels found that every strand passes.")


def touching_rope(rng: np.random.Generator) -> Tangle:
    """Draw a rope with two touching strands, 0.85 to 1.15 widths from centre to centre over 2 to 12 widths.

    The rope returns from a bend (a keyhole) or goes once around (a spiral), so that the strands run in opposite or in
    equal directions.
    """
    for _ in range(_TRIES):
        width = float(rng.uniform(8, 16))
        flat = (_keyhole if rng.integers(2) else _once_around)(rng, width)
        curve = _placed(_bent(flat, rng), rng, width)
        if curve is not None and len(meetings(curve)) == 0 and _turns_gently(curve, width):
            rope = draw_rope(curve, width, flat_caps=bool(rng.integers(2)))
            return Tangle(rope.curve, width, rope.mask, np.zeros((0, 2)), np.zeros(len(rope.curve), bool))
    raise RuntimeError("no touching rope found that fits the image.")


def is_traversed(found: npt.ArrayLike, tangle: Tangle) -> bool:
    """Return whether a found curve follows the rope from tip to tip, in either direction.

    The discrete Frechet distance (Eiter and Mannila, 1994), with a bound on the pace, must not exceed half a width, or
    two widths where the rope is hidden. A loop in the wrong direction, a missing strand or swapped strands exceed it.

    Args:
        found: ``(N, 2)`` pixels, evenly spaced.
        tangle: The truth.
    """
    points = np.asarray(found, dtype=np.float64)
    if not np.all(np.isfinite(points)):
        return False
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    points = points[(arc >= _TIP * tangle.width) & (arc <= arc[-1] - _TIP * tangle.width)]
    return bool(min(_leash(points, tangle), _leash(points[::-1], tangle)) <= _OFF * tangle.width)


def meetings(curve: Curve) -> list[Meeting]:
    """Return where a curve with steps of about a pixel crosses itself."""
    stride = 4
    at = np.arange(0, len(curve), stride)
    start, end = curve[at[:-1]], curve[at[1:]]
    step = end - start
    offset = start[None, :, :] - start[:, None, :]
    area = step[:, None, 0] * step[None, :, 1] - step[:, None, 1] * step[None, :, 0]
    area = np.where(np.abs(area) < 1e-12, np.inf, area)
    along = (offset[..., 0] * step[None, :, 1] - offset[..., 1] * step[None, :, 0]) / area
    along_other = (offset[..., 0] * step[:, None, 1] - offset[..., 1] * step[:, None, 0]) / area
    hit = (along >= 0) & (along < 1) & (along_other >= 0) & (along_other < 1)
    first, second = np.nonzero(np.triu(hit, 2))
    result = []
    for i, j in zip(first, second, strict=True):
        cosine = abs(step[i] @ step[j]) / (np.linalg.norm(step[i]) * np.linalg.norm(step[j]))
        place = start[i] + along[i, j] * step[i]
        result.append(Meeting(int(at[i]), int(at[j]), place, float(np.arccos(np.clip(cosine, 0, 1)))))
    return result


def _leash(points: Curve, tangle: Tangle) -> float:
    """Return the Frechet distance from the truth; distances count a quarter where the rope is hidden."""
    step = float(np.linalg.norm(np.diff(tangle.curve, axis=0), axis=1).mean())
    distance = np.linalg.norm(points[:, None] - tangle.curve[None], axis=2)
    distance[:, tangle.hidden] *= _OFF / _OFF_HIDDEN
    pace = len(tangle.curve) / max(len(points) - 1, 1)
    slow, fast = max(int(_PACE[0] * pace), 1), max(int(np.ceil(_PACE[1] * pace)), 3)
    # A gap is added for curves of few points.
    free = int((_MISSED_TIP + _TIP) * tangle.width / step + pace)
    leash = np.full(len(tangle.curve), np.inf)
    leash[:free] = distance[0, :free]
    window = fast - slow + 1
    for row in distance[1:]:
        # The smallest value ``slow`` to ``fast`` steps behind.
        padded = np.concatenate([np.full(fast, np.inf), leash])
        behind = minimum_filter1d(padded, window, mode="constant", cval=np.inf, origin=(window - 1) // 2 - window + 1)
        leash = np.maximum(behind[: len(leash)], row)
    return float(leash[-free:].min())


def _curly(rng: np.random.Generator, width: float, crossings: int) -> Curve:
    """Return a curve whose heading has slow waves and a steady turn, stronger for more crossings."""
    length = rng.uniform(300, 600) + 150 * crossings
    t = np.linspace(0, 1, int(length))
    waves = sum(rng.normal(0, 2.2 / k**0.7) * np.sin(np.pi * k * t + rng.uniform(0, 2 * np.pi)) for k in range(1, 6))
    heading = np.asarray(waves) + rng.uniform(-1.5, 1.5) * np.pi * crossings * t
    return from_heading(heading)


def _keyhole(rng: np.random.Generator, width: float) -> Curve:
    """Return a curve along a line, around a bulb, back next to the line, and to the side."""
    apart, stretch = rng.uniform(*_CENTRES_APART) * width, rng.uniform(*_CONTACT) * width
    out, tail = rng.uniform(4, 10) * width, rng.uniform(5, 12) * width
    opening, radius, part = rng.uniform(0.8, 1.1), rng.uniform(2.5, 4) * width, rng.uniform(0.5, 1.4)
    # The bulb for which the way back runs at this distance from the way out.
    bulb = (apart / 2 + radius * (1 - np.cos(opening))) / np.cos(opening)
    half = ((radius * opening, -opening), (bulb * (np.pi / 2 + opening), np.pi / 2 + opening))
    return arcs((out + stretch, 0.0), *half, *half[::-1], (stretch, 0.0), (radius * part, -part), (tail, 0.0))


def _once_around(rng: np.random.Generator, width: float) -> Curve:
    """Return a curve along a line, once around, and along the outer side of the line again."""
    apart, stretch = rng.uniform(*_CENTRES_APART) * width, rng.uniform(*_CONTACT) * width
    inner, out = rng.uniform(4.5, 8) * width, rng.uniform(4, 8) * width
    part, radius = rng.uniform(0.5, 1.0, size=2), rng.uniform(2.5, 4) * width
    tail = rng.uniform(3, 5) * width, rng.uniform(5, 12) * width
    return arcs(
        *((tail[0], 0.0), (radius * part[0], part[0]), (stretch, 0.0), (np.pi * inner, np.pi)),
        *((stretch + out, 0.0), (np.pi * (inner + apart / 2), np.pi), (out + stretch, 0.0)),
        *((radius * part[1], -part[1]), (tail[1], 0.0)),
    )


def _bent(curve: Curve, rng: np.random.Generator) -> Curve:
    """Bend the plane about a far centre: lines become arcs, the distances across them stay."""
    radius = rng.uniform(400, 1500) * rng.choice([-1, 1])
    curve = curve - curve.mean(axis=0)
    angle, reach = curve[:, 0] / radius, radius - curve[:, 1]
    return np.stack([reach * np.sin(angle), radius - reach * np.cos(angle)], axis=1)


def _is_clear(curve: Curve, width: float, found: list[Meeting]) -> bool:
    """Return whether crossings keep their distances, and strands meet nowhere else."""
    if any(meeting.angle < _MIN_ANGLE for meeting in found):
        return False
    at = np.sort([index for meeting in found for index in (meeting.first, meeting.second)])
    if len(at) and min(at[0], len(curve) - 1 - at[-1]) < _TAIL * width:
        return False
    places = [meeting.place for meeting in found]
    if any(np.linalg.norm(p - q) < _APART * width for i, p in enumerate(places) for q in places[:i]):
        return False
    near = KDTree(curve).query_pairs(width + _GAP, output_type="ndarray")
    near = near[np.abs(near[:, 1] - near[:, 0]) > np.pi / 2 * (width + _GAP) + 2]
    explained = np.zeros(len(near), bool)
    for meeting in found:
        # Straight strands at this angle are ``width + gap`` apart at this distance from their crossing.
        reach = 1.3 * (width + _GAP) / (2 * np.sin(meeting.angle / 2)) + width / 2
        explained |= (np.abs(near - (meeting.first, meeting.second)) < reach).all(axis=1)
    return bool(explained.all())


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


def _turns_gently(curve: Curve, width: float, tightest: float = _TIGHTEST) -> bool:
    step = np.diff(curve, axis=0)
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    reach = round(width)
    return bool(np.abs(heading[reach:] - heading[:-reach]).max(initial=0.0) * tightest <= 1.0)


def _placed(curve: Curve, rng: np.random.Generator, width: float) -> Curve | None:
    return place(resample(curve, 1.0), rng, SIZE, width)
