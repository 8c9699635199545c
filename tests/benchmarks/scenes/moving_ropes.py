"""Draw several ropes that move: over each other, into contact, under a hand, and out of the image."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from tests.benchmarks.scenes.rope_motions import Motion, Script, script_of
from tests.benchmarks.scenes.rope_pictures import picture, relief
from tests.benchmarks.scenes.ropes import SIZE, Array, Curve, blank, covered, subpixel

_FINE: Final = 600  # steps of a script in which its speed is measured
_STRETCH: Final = 12  # points of a rope that are drawn as one polygon
_RAMP: Final = 8  # frames in which a movement starts and ends
_MOVE: Final = (20, 50)  # frames of a movement
_REVERSED: Final = 0.15  # probability that a movement goes back where the last ones came from
_CALM: Final = 4.0  # fastest point under a hand, in pixels a frame
_HAND: Final[dict[Motion, tuple[float, float]]] = {"slow hand": (4.0, 8.0), "fast hand": (25.0, 45.0)}
_LIGHT: Final = np.array([-0.35, -0.3, 0.89])


@dataclass(frozen=True)
class Moment:
    """One frame of moving ropes.

    Args:
        curves: The axis of each rope, ``(P, 2)`` pixels at steps of a pixel; point i of a rope is the same material
            point in every frame.
        widths: Thickness of each rope in pixels.
        visible: For each rope, which points lie inside the image and not under the hand, ``(P,)`` bool.
        mask: The visible ropes, ``(H, W)`` uint8, 0 or 255.
        hand: What the hand covers, ``(H, W)`` bool.
        rgb: ``(H, W, 3)`` uint8, or None if pictures are not drawn.
    """

    curves: tuple[Curve, ...]
    widths: tuple[float, ...]
    visible: tuple[npt.NDArray[np.bool_], ...]
    mask: npt.NDArray[np.uint8]
    hand: npt.NDArray[np.bool_]
    rgb: npt.NDArray[np.uint8] | None


def moving_ropes(
    rng: np.random.Generator,
    count: int = 3,
    frames: int = 180,
    size: tuple[int, int] = SIZE,
    fastest: float = 15.0,
    kind: Motion = "crossing",
    *,
    width: float | None = None,
    pictures: bool = False,
) -> Iterator[Moment]:
    """Draw ropes of one thickness, frame by frame; they bend while they move, rest, start slowly, and turn back.

    Args:
        rng: Draws everything.
        count: Number of ropes; 2 or more.
        frames: Number of frames.
        size: ``(H, W)`` of the image.
        fastest: The largest speed of a point, in pixels a frame; 4 at most under a hand.
        kind: ``"crossing"``: ropes are moved across each other and part again, some change places. ``"touching"``: two
            ropes come side by side in contact, and part. ``"slow hand"``, ``"fast hand"``: a hand hides parts of
            ropes that may cross, or a whole one. ``"leaving"``: one rope leaves the image and comes back, another one
            enters, once or more.
        width: Thickness in pixels; None for 6 to 12.
        pictures: Whether to draw RGB as well.
    """
    thick = float(rng.uniform(6, 12)) if width is None else width
    hands = kind in _HAND
    script = script_of(kind, rng, count, size, thick)
    cover = _hand(rng, script(0.0), frames, size, _HAND[kind]) if hands else None
    colours = np.broadcast_to(rng.uniform(60, 230, 3), (count, 3))
    order, seed = rng.permutation(count), int(rng.integers(2**31))
    for index, time in enumerate(_times(rng, script, frames, min(fastest, _CALM) if hands else fastest, kind)):
        curves = script(time)
        mask = _drawn(curves, thick, size)
        hand = np.zeros(size, bool) if cover is None else cover(index)
        rgb = None
        if pictures:
            lifts = [np.full(len(curve), float(order[k])) for k, curve in enumerate(curves)]
            top = relief(curves, [thick] * count, lifts, size, _LIGHT)
            rgb = picture(top, colours, np.array([170.0, 165, 150]), _LIGHT, thick, np.random.default_rng(seed))
            rgb[hand] = (205, 160, 135)
        visible = tuple(_is_seen(curve, hand) for curve in curves)
        yield Moment(curves, (thick,) * count, visible, np.where(hand, np.uint8(0), mask), hand, rgb)


def _drawn(curves: tuple[Curve, ...], width: float, size: tuple[int, int]) -> npt.NDArray[np.uint8]:
    """Return the mask of ropes with flat tips."""
    canvas = blank(size)
    for curve in curves:
        along = np.gradient(curve, axis=0)
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1) * width / 2
        left, right = subpixel(curve + normal), subpixel(curve - normal)
        for start in range(0, len(curve) - 1, _STRETCH):
            part = slice(start, start + _STRETCH + 1)
            cv2.fillPoly(canvas, [np.concatenate([left[part], right[part][::-1]])], 255, shift=8)
    return covered(canvas)


def _is_seen(curve: Curve, hand: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    at = np.round(curve).astype(int)
    inside = np.all((at >= 0) & (at < hand.shape[::-1]), axis=1)
    at = np.where(inside[:, None], at, 0)
    return inside & np.logical_not(hand[at[:, 1], at[:, 0]])


def _times(rng: np.random.Generator, script: Script, frames: int, fastest: float, kind: Motion) -> Array:
    """Return the time of a script, 0 to 1, in each frame, so that no point moves faster than ``fastest``."""
    grid = np.linspace(0, 1, _FINE + 1)
    last, way = script(0.0), [0.0]
    for time in grid[1:]:
        curves = script(float(time))
        moved = max(np.linalg.norm(a[::8] - b[::8], axis=1).max() for a, b in zip(curves, last, strict=True))
        way.append(way[-1] + 1.02 * float(moved))
        last = curves
    speeds: list[float] = []
    while len(speeds) < frames:
        length = int(rng.integers(*_MOVE))
        edge = np.minimum(np.arange(length) + 1, length - np.arange(length)) / _RAMP
        back = -1 if kind != "leaving" and len(speeds) > frames / 3 and rng.random() < _REVERSED else 1
        speeds += [*(back * rng.uniform(0.6, 1.0) * fastest * np.clip(edge, 0, 1)), *[0.0] * int(rng.integers(6))]
    at = np.cumsum(np.concatenate([[0.0], speeds[: frames - 1]]))
    # A shorter script is played more slowly, up to its end.
    at = np.abs(at) * min(1.0, way[-1] / max(np.abs(at).max(), 1e-9))
    return np.interp(at, way, grid)


def _hand(
    rng: np.random.Generator, curves: tuple[Curve, ...], frames: int, size: tuple[int, int], speeds: tuple[float, float]
) -> Callable[[int], npt.NDArray[np.bool_]]:
    """Return what a hand covers in each frame: it comes from the border, visits ropes one by one, and goes."""
    angle = rng.uniform(0, 2 * np.pi)
    outside = np.array(size[::-1]) / 2 + 0.7 * np.hypot(*size) * np.array([np.cos(angle), np.sin(angle)])
    smallest = int(np.argmin([np.ptp(curve, axis=0).max() for curve in curves]))
    path = [np.array([*outside, 60.0, 60.0])] * 12
    while len(path) < frames:
        stops: list[tuple[Array, Array]] = []
        # The first visit hides the smallest rope, if that is possible, and half of the others hide theirs.
        others = rng.permutation([k for k in range(len(curves)) if k != smallest])
        for k in (smallest, *others.tolist()):
            low, high = curves[k].min(axis=0), curves[k].max(axis=0)
            if k == smallest or rng.random() < 0.5:
                stops.append(((low + high) / 2, np.clip((high - low) * 0.7 + 10, 45, 220)))
            else:
                stops.append((curves[k][int(rng.integers(len(curves[k])))], rng.uniform(40, 90, 2)))
        for stop in [*stops, (outside, stops[-1][1])]:
            start, end = path[-1], np.concatenate(stop)
            steps = max(int(np.linalg.norm(end[:2] - start[:2]) / rng.uniform(*speeds)), 1)
            path += [*(start + np.arange(1, steps + 1)[:, None] / steps * (end - start))]
            path += [end] * int(rng.integers(3, 15))

    def cover(frame: int) -> npt.NDArray[np.bool_]:
        canvas = np.zeros(size, np.uint8)
        u, v, *axes = (round(float(x)) for x in path[frame])
        cv2.ellipse(canvas, (u, v), axes, 0, 0, 360, 1, -1)
        cv2.line(canvas, (u, v), [round(float(x)) for x in outside], 1, min(axes))
        return canvas > 0

    return cover
