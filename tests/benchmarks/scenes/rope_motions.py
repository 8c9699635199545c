"""Choreographies of several ropes: where each point of each rope is at every time of a script."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Literal, NamedTuple, get_args

import numpy as np

from tests.benchmarks.scenes.rope_layouts import lay_ropes
from tests.benchmarks.scenes.rope_proposals import Table
from tests.benchmarks.scenes.ropes import Array, Curve, from_heading, resample, rotation

Motion = Literal["crossing", "touching", "slow hand", "fast hand", "leaving"]
MOTIONS: Final[tuple[Motion, ...]] = get_args(Motion)
Script = Callable[[float], tuple[Curve, ...]]
_MODES: Final = 3
_VISITS: Final = 5
_EXCHANGED: Final = 0.4  # probability that two ropes change places


def script_of(kind: Motion, rng: np.random.Generator, count: int, size: tuple[int, int], width: float) -> Script:
    """Return where ropes are as a function of the time, 0 to 1; ropes in any order, any way round, maybe mirrored.

    Args:
        kind: What happens, see ``moving_ropes``.
        rng: Draws the script.
        count: Number of ropes.
        size: ``(H, W)`` of the image.
        width: Thickness in pixels.
    """
    script = _SCRIPTS[kind](rng, count, size, width)
    order, ways = rng.permutation(count).tolist(), rng.choice([-1, 1], count)
    sides = np.array(size[::-1]) - 1.0
    mirrored = rng.integers(2, size=2).astype(bool)

    def arranged(time: float) -> tuple[Curve, ...]:
        curves = script(time)
        seen = [np.where(mirrored, sides - curves[k], curves[k]) for k in order]
        return tuple(np.ascontiguousarray(curve[::way]) for curve, way in zip(seen, ways, strict=True))

    return arranged


class _Pose(NamedTuple):
    """The middle of a rope in pixels and its direction in radians."""

    u: float
    v: float
    turn: float


def _rope(base: Array, swing: Array, pose: _Pose) -> Curve:
    """Return a curve with a heading, bent further by modes, with its middle at a pose."""
    along = np.linspace(0, 1, len(base))
    heading = base + sum(a * np.cos(np.pi * (k + 1) * along) for k, a in enumerate(swing)) + pose.turn
    curve = from_heading(heading)
    return curve - curve.mean(axis=0) + (pose.u, pose.v)


def _swings(rng: np.random.Generator, much: float, times: float) -> Callable[[float], Array]:
    """Return the amplitudes of the bending modes over the time of a script, in radians."""
    rates, phases = rng.uniform(0.6, 1.4, _MODES) * times * 2 * np.pi, rng.uniform(0, 2 * np.pi, _MODES)
    sizes = much / np.arange(1, _MODES + 1)
    return lambda time: sizes * np.sin(rates * time + phases)


def _between(keys: list[_Pose], time: float) -> _Pose:
    """Return the pose between successive ones that are reached at equal times, at rest."""
    at = min(max(time, 0.0), 1.0) * (len(keys) - 1)
    k = min(int(at), len(keys) - 2)
    share = at - k
    smooth = share * share * (3 - 2 * share)
    return _Pose(*(a + smooth * (b - a) for a, b in zip(keys[k], keys[k + 1], strict=True)))


def _homes(rng: np.random.Generator, count: int, size: tuple[int, int]) -> list[_Pose]:
    """Return places next to each other for upright ropes."""
    tilt = rng.uniform(-0.15, 0.15, count) + np.pi / 2
    places = [(size[1] * (k + 0.5) / count, size[0] * rng.uniform(0.47, 0.53)) for k in range(count)]
    return [_Pose(u, v, float(turn)) for (u, v), turn in zip(places, tilt, strict=True)]


def _crossing(rng: np.random.Generator, count: int, size: tuple[int, int], width: float) -> Script:
    """Let ropes visit each other, one at a time, at angles of 45 degrees and more."""
    lengths = rng.uniform(0.5, 0.65, count) * size[0]
    poses = _homes(rng, count, size)
    keys = [[pose] for pose in poses]
    for _ in range(_VISITS):
        guest, host = (int(k) for k in rng.choice(count, 2, replace=False))
        turn = poses[host].turn + rng.uniform(np.pi / 4, np.pi / 2) * rng.choice([-1, 1])
        reach = lengths[guest] / 2 * np.abs([np.cos(turn), np.sin(turn)]) + 2 * width
        place = np.array(poses[host][:2]) + (0, rng.uniform(-0.25, 0.25) * lengths[host])
        place = np.clip(place, reach, np.array(size[::-1]) - reach)
        visit = _Pose(float(place[0]), float(place[1]), turn)
        moves = [{guest: visit}, {guest: poses[guest]}]
        if rng.random() < _EXCHANGED:
            # They change places: the host goes first.
            there = poses[guest][:2]
            poses[guest] = _Pose(*poses[host][:2], poses[guest].turn)
            poses[host] = _Pose(*there, poses[host].turn)
            moves[1:] = [{host: poses[host]}, {guest: poses[guest]}]
        for move in moves:
            for k in range(count):
                keys[k].append(move.get(k, keys[k][-1]))
    swings = [_swings(rng, 0.4, 2.5) for _ in range(count)]
    flat = [np.zeros(round(length)) for length in lengths]
    return lambda time: tuple(_rope(b, s(time), _between(k, time)) for b, s, k in zip(flat, swings, keys, strict=True))


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
        along = np.gradient(curves[0], axis=0)
        offset = resample(curves[0] - beside * np.stack([-along[:, 1], along[:, 0]], axis=1), 1.0)
        step = np.diff(offset, axis=0)
        heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
        at = np.arange(lengths[1]) - lengths[1] / 2 + len(heading) / 2 + shift
        heading = np.interp(at, np.arange(len(heading)), heading)
        middle = min(max(round(len(offset) / 2 + shift), 0), len(offset) - 1)
        bent = from_heading(
            heading + apart * own(time) @ np.cos(np.pi * np.outer([1, 2, 3], np.linspace(0, 1, len(at))))
        )
        curve = bent - bent[len(at) // 2] + offset[middle]
        curves[1] = (curve - offset[middle]) @ rotation(apart * lean).T + offset[middle] + (apart * far, 0)
        return tuple(curves)

    return script


def _calm(rng: np.random.Generator, count: int, size: tuple[int, int], width: float) -> Script:
    """Let ropes that may cross sway about their places."""
    laid = None
    while laid is None:
        laid = lay_ropes(rng, count, int(rng.integers(3)), Table(size, width, 0.0, False, np.deg2rad(40), 3.0))
    bases, middles = [], []
    for curve in laid[0]:
        step = np.diff(curve, axis=0)
        bases.append(np.unwrap(np.arctan2(step[:, 1], step[:, 0])))
        middles.append(curve.mean(axis=0))
    swings = [_swings(rng, 0.06, 4.0) for _ in range(count)]
    rates, phases = rng.uniform(2, 5, (count, 3)) * 2 * np.pi, rng.uniform(0, 2 * np.pi, (count, 3))

    def script(time: float) -> tuple[Curve, ...]:
        sway = np.sin(rates * time + phases) * (6.0, 6.0, 0.03)
        poses = [_Pose(m[0] + s[0], m[1] + s[1], s[2]) for m, s in zip(middles, sway, strict=True)]
        return tuple(_rope(b, s(time), p) for b, s, p in zip(bases, swings, poses, strict=True))

    return script


def _leaving(rng: np.random.Generator, count: int, size: tuple[int, int], width: float) -> Script:
    """Let the first rope leave the image and come back, and the second one enter meanwhile; the others stay."""
    lengths = rng.uniform(0.45, 0.6, count) * size[0]
    homes = _homes(rng, count, size)
    keys = [[pose, pose, pose, pose, pose] for pose in homes]
    up = rng.choice([-1, 1])
    # Past the upper or the lower border, since its neighbours stand left and right.
    out = [size[0] / 2 + side * (size[0] + lengths[k]) * 0.53 for k, side in ((0, up), (1, -up))]
    keys[0] = [homes[0], _Pose(homes[0].u, out[0], homes[0].turn), _Pose(homes[0].u, out[0], homes[0].turn), homes[0]]
    gone = _Pose(homes[1].u, out[1], homes[1].turn)
    keys[1] = [gone, gone, homes[1], homes[1]] if rng.integers(2) else [gone, homes[1], homes[1], gone, homes[1]]
    swings = [_swings(rng, 0.4, 3.0) for _ in range(count)]
    flat = [np.zeros(round(length)) for length in lengths]
    return lambda time: tuple(_rope(b, s(time), _between(k, time)) for b, s, k in zip(flat, swings, keys, strict=True))


_SCRIPTS: Final[dict[Motion, Callable[[np.random.Generator, int, tuple[int, int], float], Script]]] = {
    "crossing": _crossing,
    "touching": _touching,
    "slow hand": _calm,
    "fast hand": _calm,
    "leaving": _leaving,
}
