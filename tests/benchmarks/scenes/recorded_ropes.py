"""Record a moving rope under hands, or out of sight, with a depth camera: the frames and the truth of every node.

A hand, with or without its arm, moves along the rope from one end to the other; or hands come over its ends and stay
for some seconds; or the whole rope is out of sight for some seconds, behind a board or beyond the image's border.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Final, Literal, NamedTuple, get_args

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.photos import photographed
from shape_obs.camera import Intrinsics
from tests.benchmarks.scenes.rope_motion import MOTIONS, NODES, PIECES, Motion, MovingRope, moving_rope
from tests.scenes.hidden_ropes import Depth, Mask, Seen, camera_of, d455, see

Array = npt.NDArray[np.float64]
Hider = Literal["hand", "arm", "both ends", "first end", "last end", "board", "border", "at once"]
Covers = Callable[[float, Array], Mask | None]  # takes seconds and the axis in pixels, (P, 2)
HIDERS: Final[tuple[Hider, ...]] = get_args(Hider)
SIZE: Final = (480, 640)  # rows and columns
PER_NODE: Final = PIECES // (NODES - 1)
_BEFORE: Final = 0.8  # seconds in which all of the rope is in sight
_COMES: Final = 0.5  # seconds in which a hand comes, or goes
_HAND: Final = (0.06, 0.1)  # metres, the breadth of a hand
_NEARER: Final = (0.03, 0.1)  # metres from a hand to the nearest point of the rope
_FAR: Final = 1200.0  # pixels from a hand that is away, and from its palm to the end of its arm
_PALM: Final = 0.4  # breadths of a hand by which it is longer than broad
_FINGERS: Final = (-0.45, -0.15, 0.15, 0.45)  # radians
_FINGER: Final = 0.2  # breadths of a hand: the breadth of a finger
_REACH: Final = 1.1  # breadths of a hand from the middle of its palm to the tips of the fingers
_OVER: Final = 0.25  # breadths of a hand by which it is over an end
_BOARD: Final = 0.2  # seconds in which a board comes over the image
_CARRIED: Final = (0.5, 0.7)  # m/s at least, and share of the speed, with which a rope is carried out of the image
_WALL: Final = (0.02, 0.4)  # metres behind the rope's farthest point
_NO_WALL: Final = 0.3  # probability that what is behind the rope returns no depth
_TURNS: Final = 0.3  # radians to and fro of a hand that moves along the rope
_SKIN: Final = (205, 150, 125)
_BEYOND: Final = 12.0  # pixels
_COARSE: Final = 6 * (NODES - 1)  # pieces of a rope that is carried, while its way is searched


class Setting(NamedTuple):
    """What is recorded.

    Args:
        motion: What moves, see ``moving_rope``.
        hider: What hides the rope.
        hidden: Seconds for which the ends, or all of the rope, are hidden; 0 for a hand that moves along it.
        hertz: Frames per second.
        speed: Of the fastest node, metres per second.
        seconds: Of the recording.
        seed: Of everything that is drawn at random.
    """

    motion: Motion
    hider: Hider
    hidden: float
    hertz: int
    speed: float
    seconds: float
    seed: int


class Frame(NamedTuple):
    """A frame of a recording."""

    stamp: float  # seconds
    mask: Mask  # (H, W) uint8, 0 or 255: the rope where it is in sight
    hand: Mask  # (H, W) uint8: what hides it
    depth: Depth  # (H, W) float32 metres, exact to a millimetre, 0 where nothing returns
    nodes: Array  # (NODES, 3) metres, camera frame, on the surface that faces the camera, on the axis's viewing rays
    visible: npt.NDArray[np.bool_]  # (NODES,)


class Recording(NamedTuple):
    """A recording."""

    camera: Intrinsics
    radius: float  # of the rope, metres
    peak: float  # speed of the fastest node, metres per second
    frames: Iterator[Frame]


def record(setting: Setting) -> Recording:
    """Record a rope; its frames are drawn one by one."""
    kinds = MOTIONS.index(setting.motion), HIDERS.index(setting.hider)
    rng = np.random.default_rng([setting.seed, *kinds, round(1e3 * setting.speed)])
    camera, seconds = camera_of(SIZE), setting.seconds
    rope = moving_rope(rng, setting.motion, setting.speed, seconds, camera)
    if setting.hider == "border":
        rope, more = _carried(rng, rope, setting, camera)
        seconds += more
    times = np.arange(0, seconds - 1e-9, 1 / setting.hertz)
    every = rope.axis(times)
    wall = 0.0 if rng.random() < _NO_WALL else float(every[..., 2].max() + rope.radius + rng.uniform(*_WALL))
    frames = _frames(rng, rope, setting, times, every, camera, wall)
    return Recording(camera, rope.radius, rope.peak_speed(seconds), frames)


def _frames(
    rng: np.random.Generator,
    rope: MovingRope,
    setting: Setting,
    times: Array,
    every: Array,
    camera: Intrinsics,
    wall: float,
) -> Iterator[Frame]:
    covers = _COVERS[setting.hider](rng, rope, setting, camera)
    nearer, nothing = float(rng.uniform(*_NEARER)), np.zeros(SIZE, np.uint8)
    for stamp, axis in zip(times.tolist(), every, strict=True):
        hand = covers(stamp, camera.project(axis))
        seen: Seen = see(axis, rope.radius, camera, wall, hand, nearer)
        depth = np.round(seen.depth, 3).astype(np.float32)
        nodes, visible = seen.metres[::PER_NODE], seen.shown[::PER_NODE]
        yield Frame(stamp, seen.mask, nothing if hand is None else hand, depth, nodes, visible)


def noise_of(setting: Setting) -> Callable[[Depth], Depth]:
    """Return the noise of a D455 for a recording: metres -> metres."""
    return d455(SIZE, np.random.default_rng([setting.seed, 455]))


def picture(rng: np.random.Generator, frame: Frame, light: float) -> npt.NDArray[np.uint8]:
    """Return the colour image of a frame, ``(H, W, 3)`` uint8: a blue rope under hands of the colour of skin.

    Args:
        rng: Draws the noise.
        frame: The frame.
        light: Direction in which it becomes brighter, radians.
    """
    rgb = photographed(rng, frame.mask, contrast=1.5, noise=2.0, light=light)
    hand = frame.hand > 0
    rgb[hand] = np.rint(np.clip(_SKIN + rng.normal(0, 2.0, (np.count_nonzero(hand), 3)), 0, 255))
    return rgb


def _drawn_hand(tip: Array, heading: float, breadth: float, *, fingers: bool, arm: bool = True) -> Mask:
    """Draw a hand that points in a direction, a round fist or with fingers, with its arm or without."""
    canvas = np.zeros(SIZE, np.uint8)
    ahead = np.array([np.cos(heading), np.sin(heading)])
    palm = tip - (0.5 * breadth * ahead if fingers else 0.0)
    _draw_line(canvas, palm - (_FAR if arm else _PALM * breadth) * ahead, palm, breadth)
    for angle in _FINGERS if fingers else ():
        out = np.array([np.cos(heading + angle), np.sin(heading + angle)])
        _draw_line(canvas, palm, palm + _REACH * breadth * out, _FINGER * breadth)
    return canvas


def _draw_line(canvas: Mask, first: Array, last: Array, thick: float) -> None:
    ends = [(round(float(u)), round(float(v))) for u, v in (first, last)]
    cv2.line(canvas, ends[0], ends[1], (255,), max(round(thick), 1))


def _hand_along(rng: np.random.Generator, rope: MovingRope, setting: Setting, camera: Intrinsics) -> Covers:
    """Return a hand that comes over one end, moves along the rope to the other one, and goes."""
    heading, turning = rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi)
    backwards, fingers = rng.random() < 0.5, bool(rng.random() < 0.5)
    breadth = rng.uniform(*_HAND) * camera.fx / rope.place[2]
    leaves = setting.seconds - _COMES - 0.2

    def covers(time: float, pixels: Array) -> Mask | None:
        away = max(_BEFORE - time, time - leaves, 0.0) / _COMES
        if time < _BEFORE - _COMES or away > 1:
            return None
        share = np.clip((time - _BEFORE) / (leaves - _BEFORE), 0, 1)
        over = pixels[round((1 - share if backwards else share) * PIECES)]
        points = heading + _TURNS * np.sin(turning + 2 * time)
        tip = over - _FAR * away * np.array([np.cos(points), np.sin(points)])
        return _drawn_hand(tip, points, breadth, fingers=fingers, arm=setting.hider == "arm")

    return covers


def _hands_on_ends(rng: np.random.Generator, rope: MovingRope, setting: Setting, camera: Intrinsics) -> Covers:
    """Return hands that come over one end or both, from ahead of them, stay there for some seconds, and go."""
    ends = {"first end": (0,), "last end": (PIECES,)}.get(setting.hider, (0, PIECES))
    aside, fingers = rng.uniform(-0.9, 0.9, len(ends)), rng.random(len(ends)) < 0.5
    breadth = rng.uniform(*_HAND) * camera.fx / rope.place[2]
    begin = camera.project(rope.axis([_BEFORE])[0])
    inwards = [begin[abs(end - 2 * PER_NODE)] - begin[end] for end in ends]
    headings = [float(np.arctan2(way[1], way[0]) + off) for way, off in zip(inwards, aside, strict=True)]

    def covers(time: float, pixels: Array) -> Mask | None:
        away = max(_BEFORE - time, time - _BEFORE - setting.hidden, 0.0) / _COMES
        if time < _BEFORE - _COMES or away > 1:
            return None
        hands = [
            _drawn_hand(
                pixels[end] + (_OVER * breadth - _FAR * away) * np.array([np.cos(heading), np.sin(heading)]),
                heading, breadth, fingers=bool(spread),
            )
            for end, heading, spread in zip(ends, headings, fingers, strict=True)
        ]  # fmt: skip
        return np.maximum.reduce(hands)

    return covers


def _board(rng: np.random.Generator, rope: MovingRope, setting: Setting, camera: Intrinsics) -> Covers:
    """Return a board that covers the image for some seconds: it comes from a side, or within a frame."""
    angle = rng.uniform(0, 2 * np.pi)
    places = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
    along = places @ np.array([np.cos(angle), np.sin(angle)])
    low, span, comes = float(along.min()), float(np.ptp(along)) + 1, 0.0 if setting.hider == "at once" else _BOARD

    def covers(time: float, pixels: Array) -> Mask | None:
        since, after = time - _BEFORE, time - _BEFORE - comes - setting.hidden
        if since < 0 or after >= comes:
            return None
        if since < comes:
            return np.where(along < low + span * since / comes, np.uint8(255), np.uint8(0))
        if after <= 0:
            return np.full(SIZE, 255, np.uint8)
        return np.where(along >= low + span * after / comes, np.uint8(255), np.uint8(0))

    return covers


def _carried(
    rng: np.random.Generator, rope: MovingRope, setting: Setting, camera: Intrinsics
) -> tuple[MovingRope, float]:
    """Return a rope that is carried over a border and back while it moves, and the seconds that this takes besides."""
    least, share = _CARRIED
    rope = replace(rope, rate=(1 - share) * rope.rate)
    side, sign = int(rng.integers(2)), int(rng.choice([-1, 1]))
    axis = rope.axis(np.arange(0, 2 * setting.seconds, 0.05), _COARSE)
    rays = ((camera.cx, camera.cy)[side] + _BEYOND) / camera.fx * axis[..., 2]  # to the border
    farthest = float((rays - sign * axis[..., side]).max()) + 2 * rope.radius
    speed = max(share * setting.speed, least)

    def carried(way: float, stays: float) -> tuple[MovingRope, float]:
        takes = np.pi / 2 * way / speed

        def moved(time: Array) -> Array:
            went, came = ((time - begin) / takes for begin in (_BEFORE, _BEFORE + takes + stays))
            share, places = np.clip(went, 0, 1) - np.clip(came, 0, 1), np.zeros((len(time), 3))
            places[:, side] = sign * way * (1 - np.cos(np.pi * share)) / 2
            return places

        return replace(rope, carried=moved), 2 * takes + stays - setting.hidden

    def out_of_sight(found: tuple[MovingRope, float]) -> float:
        """Return for how many seconds no point of the rope is in the image."""
        pixels = camera.project(found[0].axis(np.arange(0, setting.seconds + found[1], 0.02), _COARSE))
        outside = np.any((pixels < 0) | (pixels > (camera.width - 1, camera.height - 1)), axis=2)
        return 0.02 * float(np.count_nonzero(np.all(outside, axis=1)))

    low, high = 0.0, farthest
    if (least := out_of_sight(carried(farthest, 0.0))) < setting.hidden:
        return carried(farthest, setting.hidden - least)
    for _ in range(12):
        middle = (low + high) / 2
        low, high = (middle, high) if out_of_sight(carried(middle, 0.0)) < setting.hidden else (low, middle)
    return carried(high, 0.0)


def _nothing(rng: np.random.Generator, rope: MovingRope, setting: Setting, camera: Intrinsics) -> Covers:
    return lambda time, pixels: None


_COVERS: Final[dict[Hider, Callable[[np.random.Generator, MovingRope, Setting, Intrinsics], Covers]]] = {
    "hand": _hand_along,
    "arm": _hand_along,
    "both ends": _hands_on_ends,
    "first end": _hands_on_ends,
    "last end": _hands_on_ends,
    "board": _board,
    "border": _nothing,
    "at once": _board,
}
