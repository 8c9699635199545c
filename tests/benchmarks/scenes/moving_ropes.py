"""Draw several ropes that move: over each other, into contact, under a hand, and out of the image."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal, get_args

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import SIZE, draw_rope, from_heading, resample, rotation
from tests.benchmarks.scenes.height_field import HeightField, unit
from tests.benchmarks.scenes.several_ropes import on_a_table
from tests.scenes.layouts import Table, place_ropes
from tests.scenes.ropes import Curve, headings, normals

Array = npt.NDArray[np.float64]
Motion = Literal["crossing", "touching", "slow hand", "fast hand", "leaving"]
Script = Callable[[float], tuple[Curve, ...]]  # where each point of each rope is at a time from 0 to 1
MOTIONS: Final[tuple[Motion, ...]] = get_args(Motion)
_MODES: Final = np.arange(1, 4)  # of bending
_VISITS: Final = 5
_EXCHANGED: Final = 0.4  # probability that two ropes change places
_FINE: Final = 600  # steps of a script in which its speed is measured
_RAMP: Final = 8  # frames in which a movement starts and ends
_MOVE: Final = (20, 50)  # frames of a movement
_REVERSED: Final = 0.15  # probability that a movement goes back where the last ones came from
_CALM: Final = 4.0  # fastest point under a hand, in pixels a frame
_HAND: Final[dict[Motion, tuple[float, float]]] = {"slow hand": (4.0, 8.0), "fast hand": (25.0, 45.0)}
_LIGHT: Final = unit(np.array([-0.35, -0.3, 0.89]))


@dataclass(frozen=True)
class Moment:
    """One frame of moving ropes."""

    # the axis of each rope, (P, 2) pixels at steps of a pixel; point i of a rope is the same material point in every
    # frame
    curves: tuple[Curve, ...]
    widths: tuple[float, ...]  # thickness of each rope in pixels
    # for each rope, which points lie inside the image and not under the hand, (P,) bool
    visible: tuple[npt.NDArray[np.bool_], ...]
    mask: npt.NDArray[np.uint8]  # the visible ropes, (H, W) uint8, 0 or 255
    hand: npt.NDArray[np.bool_]  # what the hand covers, (H, W) bool
    rgb: npt.NDArray[np.uint8] | None  # (H, W, 3) uint8, or None if pictures are not drawn


def moving_ropes(
    rng: np.random.Generator,
    count: int = 3,
    frames: int = 180,
    size: tuple[int, int] = SIZE,
    fastest: float = 15.0,
    kind: Motion = "crossing",
    *,
    pictures: bool = False,
) -> Iterator[Moment]:
    """Draw ropes 6 to 12 px thick, frame by frame; they bend while they move, rest, start slowly, and turn back.

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
        pictures: Whether to draw RGB as well.
    """
    thick, hands = float(rng.uniform(6, 12)), kind in _HAND
    script = _script(kind, rng, count, size, thick)
    cover = _hand(rng, script(0.0), frames, size, _HAND[kind]) if hands else lambda _: np.zeros(size, bool)
    colour, order, seed = rng.uniform(60, 230, 3), rng.permutation(count), int(rng.integers(2**31))
    for index, time in enumerate(_times(rng, script, frames, min(fastest, _CALM) if hands else fastest, kind)):
        curves, hand, rgb = script(time), cover(index), None
        mask = np.maximum.reduce([draw_rope(curve, thick, size=size).mask for curve in curves])
        if pictures:
            lifted = [np.full(len(curve), float(order[k])) for k, curve in enumerate(curves)]
            top = HeightField.of_ropes(curves, [thick] * count, lifted, size, _LIGHT)
            rgb = on_a_table(np.random.default_rng(seed), top, _LIGHT, colour)
            rgb[hand] = (205, 160, 135)
        visible = tuple(_is_seen(curve, hand) for curve in curves)
        yield Moment(curves, (thick,) * count, visible, np.where(hand, np.uint8(0), mask), hand, rgb)


def _is_seen(curve: Curve, hand: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    at = np.round(curve).astype(int)
    inside = np.all((at >= 0) & (at < hand.shape[::-1]), axis=1)
    at = np.where(inside[:, None], at, 0)
    return inside & np.logical_not(hand[at[:, 1], at[:, 0]])


def _times(rng: np.random.Generator, script: Script, frames: int, fastest: float, kind: Motion) -> Array:
    """Return the time of a script, 0 to 1, in each frame, so that no point moves faster than ``fastest``."""
    grid = np.linspace(0, 1, _FINE + 1)
    drawn = [np.concatenate([curve[::8] for curve in script(float(time))]) for time in grid]
    moved = [np.linalg.norm(a - b, axis=1).max() for a, b in zip(drawn[1:], drawn[:-1], strict=True)]
    way = np.concatenate([[0.0], 1.02 * np.cumsum(moved)])
    speeds: list[float] = []
    while len(speeds) < frames:
        length = int(rng.integers(*_MOVE))
        edge = np.minimum(np.arange(length) + 1, length - np.arange(length)) / _RAMP
        back = -1 if kind != "leaving" and len(speeds) > frames / 3 and rng.random() < _REVERSED else 1
        speeds += [*(back * rng.uniform(0.6, 1.0) * fastest * np.clip(edge, 0, 1)), *[0.0] * int(rng.integers(6))]
    at = np.cumsum(np.concatenate([[0.0], speeds[: frames - 1]]))
    # A shorter script is played more slowly, up to its end.
    return np.interp(np.abs(at) * min(1.0, way[-1] / max(np.abs(at).max(), 1e-9)), way, grid)


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


def _script(kind: Motion, rng: np.random.Generator, count: int, size: tuple[int, int], width: float) -> Script:
    """Return a script of ropes in any order, any way round, maybe mirrored."""
    kinds = {"crossing": _crossing, "touching": _touching, "leaving": _leaving}
    script = kinds.get(kind, _calm)(rng, count, size, width)
    order, ways = rng.permutation(count).tolist(), rng.choice([-1, 1], count)
    sides, mirrored = np.array(size[::-1]) - 1.0, rng.integers(2, size=2).astype(bool)

    def arranged(time: float) -> tuple[Curve, ...]:
        curves = script(time)
        seen = [np.where(mirrored, sides - curves[k], curves[k]) for k in order]
        return tuple(np.ascontiguousarray(curve[::way]) for curve, way in zip(seen, ways, strict=True))

    return arranged


def _crossing(rng: np.random.Generator, count: int, size: tuple[int, int], width: float) -> Script:
    """Let ropes visit each other, one at a time, at angles of 45 degrees and more."""
    lengths = rng.uniform(0.5, 0.65, count) * size[0]
    rest = _homes(rng, count, size)
    keys = [rest]
    for _ in range(_VISITS):
        guest, host = (int(k) for k in rng.choice(count, 2, replace=False))
        turn = rest[host, 2] + rng.uniform(np.pi / 4, np.pi / 2) * rng.choice([-1, 1])
        reach = lengths[guest] / 2 * np.abs([np.cos(turn), np.sin(turn)]) + 2 * width
        place = rest[host, :2] + (0, rng.uniform(-0.25, 0.25) * lengths[host])
        visit = rest.copy()
        visit[guest] = *np.clip(place, reach, np.array(size[::-1]) - reach), turn
        keys.append(visit)
        if rng.random() < _EXCHANGED:
            # They change places: the host goes first.
            rest = rest.copy()
            rest[[guest, host], :2] = rest[[host, guest], :2]
            keys.append(np.where(np.arange(count)[:, None] == host, rest, visit))
        keys.append(rest)
    return _moved(lengths, [_swings(rng, 0.4, 2.5) for _ in range(count)], np.stack(keys, axis=1))


def _touching(rng: np.random.Generator, count: int, size: tuple[int, int], width: float) -> Script:
    """Let the second rope come to the side of the first one, three times; the others stay away."""
    lengths = np.round(rng.uniform(0.5, 0.65, count) * size[0]).astype(int)
    homes = _homes(rng, count, size)
    swings = [_swings(rng, 0.35, 3.0) for _ in range(count)]
    beside, far = width * rng.uniform(0.95, 1.05), size[1] / count * 0.8
    lean, own, shift = rng.uniform(-0.25, 0.25), _swings(rng, 0.3, 3.0), int(rng.uniform(-0.2, 0.2) * lengths[1])

    def script(time: float) -> tuple[Curve, ...]:
        curves = [_rope(np.zeros(n), s(time), p) for n, s, p in zip(lengths, swings, homes, strict=True)]
        # 0 in contact, 1 when it is farthest away; it leaves the contact again for the rest of the script.
        apart = float(np.clip(1.25 * np.cos(3 * np.pi * time) ** 2 - 0.25, 0, 1)) if 0 < time < 1 else 1.0
        offset = resample(curves[0] - beside * normals(curves[0]), 1.0)
        heading = headings(offset)
        at = np.arange(lengths[1]) - lengths[1] / 2 + len(heading) / 2 + shift
        middle = offset[min(max(round(len(offset) / 2 + shift), 0), len(offset) - 1)]
        bent = _rope(np.interp(at, np.arange(len(heading)), heading), apart * own(time), np.zeros(3))
        curve = bent - bent[len(at) // 2]
        curves[1] = curve @ rotation(apart * lean).T + middle + (apart * far, 0)
        return tuple(curves)

    return script


def _calm(rng: np.random.Generator, count: int, size: tuple[int, int], width: float) -> Script:
    """Let ropes that may cross sway about their places."""
    placed = None
    while placed is None:
        placed = place_ropes(rng, count, int(rng.integers(3)), Table(size, width, 0.0, np.deg2rad(40)))
    middles = [np.array([*curve.mean(axis=0), 0.0]) for curve in placed[0]]
    swings = [_swings(rng, 0.06, 4.0) for _ in range(count)]
    rates, phases = rng.uniform(2, 5, (count, 3)) * 2 * np.pi, rng.uniform(0, 2 * np.pi, (count, 3))

    def script(time: float) -> tuple[Curve, ...]:
        poses = middles + np.sin(rates * time + phases) * (6.0, 6.0, 0.03)
        return tuple(_rope(headings(c), s(time), p) for c, s, p in zip(placed[0], swings, poses, strict=True))

    return script


def _leaving(rng: np.random.Generator, count: int, size: tuple[int, int], width: float) -> Script:
    """Let the first rope leave the image and come back, and the second one enter meanwhile; the others stay."""
    lengths = rng.uniform(0.45, 0.6, count) * size[0]
    homes = _homes(rng, count, size)
    up = rng.choice([-1, 1])
    # Past the upper or the lower border, since its neighbours stand left and right.
    gone = homes.copy()
    for k, side in ((0, up), (1, -up)):
        gone[k, 1] = size[0] / 2 + side * (size[0] + lengths[k]) * 0.53
    keys = [np.stack([home, home]) for home in homes]
    keys[0] = np.stack([homes[0], gone[0], gone[0], homes[0]])
    once = [gone[1], gone[1], homes[1], homes[1]]
    keys[1] = np.stack(once if rng.integers(2) else [gone[1], homes[1], homes[1], gone[1], homes[1]])
    return _moved(lengths, [_swings(rng, 0.4, 3.0) for _ in range(count)], keys)


def _homes(rng: np.random.Generator, count: int, size: tuple[int, int]) -> Array:
    """Return places next to each other for upright ropes: u, v and the direction in radians, ``(count, 3)``."""
    across, tilt = size[1] * (np.arange(count) + 0.5) / count, rng.uniform(-0.15, 0.15, count) + np.pi / 2
    return np.stack([across, size[0] * rng.uniform(0.47, 0.53, count), tilt], axis=1)


def _swings(rng: np.random.Generator, much: float, times: float) -> Callable[[float], Array]:
    """Return the amplitudes of the bending modes over the time of a script, in radians."""
    rates = rng.uniform(0.6, 1.4, len(_MODES)) * times * 2 * np.pi
    phases = rng.uniform(0, 2 * np.pi, len(_MODES))
    return lambda time: much / _MODES * np.sin(rates * time + phases)


def _rope(base: Array, swing: Array, pose: Array) -> Curve:
    """Return a curve with a heading, bent further by modes, with its middle at a pose (u, v, turn)."""
    bend = swing @ np.cos(np.pi * np.outer(_MODES, np.linspace(0, 1, len(base))))
    curve = from_heading(base + bend + pose[2])
    return curve - curve.mean(axis=0) + pose[:2]


def _moved(lengths: Array, swings: Sequence[Callable[[float], Array]], keys: Sequence[Array] | Array) -> Script:
    """Move straight, swinging ropes through ``(K, 3)`` poses each, at rest at equal times."""

    def pose(path: Array, time: float) -> Array:
        at = min(max(time, 0.0), 1.0) * (len(path) - 1)
        k = min(int(at), len(path) - 2)
        share = at - k
        return path[k] + share * share * (3 - 2 * share) * (path[k + 1] - path[k])

    ropes = list(zip(lengths, swings, keys, strict=True))
    return lambda time: tuple(_rope(np.zeros(round(n)), swing(time), pose(path, time)) for n, swing, path in ropes)
