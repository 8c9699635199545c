"""Draw ropes, in a plane or in space, while hands, shadows, bars and the image's border hide a part of them.

What hides a rope grows from nothing, at any speed. A rope with depth is a tube in front of a wall, or of nothing that
returns depth, made of balls; its mask and its depth are drawn together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import repeat
from typing import Final, Literal, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import Rope, moving_curve, moving_rope, resample, rotation
from shape_obs.camera import Intrinsics
from shape_obs.compiled import compiled

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]
Depth = npt.NDArray[np.float32]
Cover = Literal["hand", "shadow", "bar", "border"]
Where = Literal["start", "end", "middle"]
_FINER: Final = 4  # supersampling in each direction
_NEARER: Final = 0.08  # metres from a hand or a bar to the rope
_HAND: Final = (40.0, 80.0)  # radius in pixels
_AWAY: Final = 25  # frames before something comes, and after it has gone
_STAYS: Final = 40
DISTANCE: Final = 0.7  # metres to a rope that moves in a plane
_TABLE: Final = 0.01  # metres from there to the table
_PIECE: Final = 0.2  # radii from one drawn ball to the next
_LONGEST: Final = 4.0  # radii from the axis to the surface, on a ray along the rope
_CLEAR: Final = 14.0  # pixels from the rope's tip at which something is away
_WIDE: Final = 640


class Hidden(NamedTuple):
    """One frame of a rope under a hand."""

    rope: Rope  # the rope with its whole mask
    mask: Mask  # the visible part of the mask, (H, W) uint8
    share: float  # covered share of the rope's length


def hidden_rope(
    rng: np.random.Generator, speed: float, share: float, where: Where, *, creep: int = 0, frames: int = 180
) -> Iterator[Hidden]:
    """Draw a moving rope with a hand, 34 px wide, over a part of it during the middle three fifths of the frames.

    Args:
        rng: Draws the motion.
        speed: Speed of the fastest point in pixels per frame.
        share: Share of the length that the hand covers.
        where: The covered part.
        creep: Frames over which the hand comes and goes; 0 at once.
        frames: Number of frames.
    """
    for index, rope in enumerate(moving_rope(rng, speed, frames)):
        inside = min(index - 0.2 * frames, 0.8 * frames - index)
        under = share * float(np.clip((inside + 1) / (creep + 1), 0, 1))
        mask, count = rope.mask.copy(), round(under * len(rope.curve))
        if count >= 2:
            first = {"start": 0, "end": len(rope.curve) - count, "middle": (len(rope.curve) - count) // 2}[where]
            cv2.polylines(mask, [np.rint(rope.curve[first : first + count]).astype(np.int32)], False, (0,), 34)
        yield Hidden(rope, mask, under)


class Seen(NamedTuple):
    """One frame of a rope with depth."""

    pixels: Array  # (P, 2) its axis from tip to tip at equal steps of material
    metres: Array  # (P, 3) the same on the visible surface, on the viewing rays of the axis, camera frame
    # (P,) bool: in sight, neither hidden, by something or the rope itself, nor outside the image
    shown: npt.NDArray[np.bool_]
    mask: Mask  # (H, W) uint8, 0 or 255
    depth: Depth  # (H, W) float32 metres, 0 where nothing is measured
    camera: Intrinsics  # the projection


def camera_of(size: tuple[int, int]) -> Intrinsics:
    """Return a camera with a horizontal field of view of 56 degrees for images of ``size`` ``(H, W)``."""
    height, width = size
    focal = width * 600 / 640
    return Intrinsics(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def hidden_ropes(
    rng: np.random.Generator,
    cover: Cover,
    approach: float,
    speed: float,
    *,
    share: float = 0.3,
    size: tuple[int, int] = (480, 640),
    table: bool = True,
    away: float = DISTANCE,
) -> Iterator[Seen]:
    """Draw a rope that wanders and bends in a plane while something comes over it, stays, and goes.

    Args:
        rng: Draws the motions.
        cover: What hides the rope: a round hand over an end, a shadow, a bar that crosses the image, or the image's
            border, over which the rope slides.
        approach: Pixels per frame of an image 640 wide, at which it comes and goes.
        speed: Of the rope's fastest point, pixels per frame; 0 for a rope at rest.
        share: Of the length that a hand hides or that slides out.
        size: Of the image, ``(H, W)``.
        table: Whether what lies behind the rope returns depth.
        away: Metres from the camera; the rope looks the same, and is thicker the farther away it is.
    """
    camera, scale, width = camera_of(size), size[1] / _WIDE, float(rng.uniform(7, 13))
    motion = moving_curve(rng, speed, 100_000, width=width)
    curve = next(motion)
    hide = {"hand": _hand, "shadow": _hand, "bar": _bar, "border": _border}[cover](rng, curve)
    state, radius, behind = _Hiding(), width / 2 * scale / camera.fx * away, away + _TABLE if table else 0.0
    places = np.stack(np.meshgrid(np.arange(size[1]), np.arange(size[0])), axis=-1) / scale

    def distances() -> Iterator[float]:
        """Yield how far something has come in each frame: it is away, comes, stays, goes, and is gone."""
        yield from repeat(0.0, _AWAY)
        distance = 0.0
        while state.hidden < share and not state.past:
            distance += approach
            yield distance
        if not state.past:
            yield from repeat(distance, _STAYS)
            while distance > 0:
                distance -= approach
                yield max(distance, 0.0)
        yield from repeat(distance, _AWAY)

    for distance in distances():
        state = hide(curve, distance)
        moved = resample(curve + (state.slid, 0.0), 1.0) * scale
        over = None if state.covers is None else state.covers(places).astype(np.uint8) * 255
        yield see(camera.rays(moved) * away, radius, camera, behind, over, 0.0 if cover == "shadow" else _NEARER)
        curve = next(motion)


class _Hiding(NamedTuple):
    """What hides a rope in a frame."""

    hidden: float = 0.0  # share of the rope that a hand or the border hides
    past: bool = False  # whether it has passed the rope
    # whether it covers points: (..., 2) pixels of an image 640 wide -> (...) bool; None for nothing
    covers: Callable[[Array], npt.NDArray[np.bool_]] | None = None
    slid: float = 0.0  # how far the rope has slid to the right in pixels


_Hider = Callable[[Array, float], _Hiding]  # takes the rope's axis and how far something has come, in pixels


def _hand(rng: np.random.Generator, curve: Array) -> _Hider:
    """Return a disc that comes over an end from ahead, at an angle."""
    end, radius, turn = int(rng.integers(2)), float(rng.uniform(*_HAND)), rotation(rng.uniform(-0.7, 0.7))

    def hide(curve: Array, distance: float) -> _Hiding:
        tip, before = (curve[-1], curve[-21]) if end else (curve[0], curve[20])
        out = turn @ (tip - before) / np.linalg.norm(tip - before)
        middle = tip + out * (radius + _CLEAR - distance)

        def covers(points: Array) -> npt.NDArray[np.bool_]:
            return np.linalg.norm(points - middle, axis=-1) < radius

        return _Hiding(float(np.mean(covers(curve))), distance > 2 * radius + 400, covers if distance else None)

    return hide


def _bar(rng: np.random.Generator, curve: Array) -> _Hider:
    """Return a band that crosses the image at an angle."""
    breadth, angle = float(rng.uniform(40, 200)), float(rng.uniform(0, 2 * np.pi))
    way = np.array([np.cos(angle), np.sin(angle)])
    start = float((curve @ way).min()) - breadth / 2 - _CLEAR

    def hide(curve: Array, distance: float) -> _Hiding:
        at = start + distance
        past = at > float((curve @ way).max()) + breadth / 2 + _CLEAR
        return _Hiding(0.0, past, lambda points: np.abs(points @ way - at) < breadth / 2)

    return hide


def _border(rng: np.random.Generator, curve: Array) -> _Hider:
    """Return the left or right border of the image, over which the rope slides."""
    right = int(rng.integers(2))
    room = float(_WIDE - 1 - curve[:, 0].max() if right else curve[:, 0].min())

    def hide(curve: Array, distance: float) -> _Hiding:
        slid = (room - 2 * _CLEAR + distance) * (1 if right else -1)
        column = curve[:, 0] + slid
        return _Hiding(float(np.mean((column < 0) | (column > _WIDE - 1))), slid=slid)

    return hide


def d455(size: tuple[int, int], rng: np.random.Generator) -> Callable[[Depth], Depth]:
    """Return what a D455 measures: ``(H, W)`` metres -> metres with its noise; needs the environments' package."""
    from shape_obs_envs.d455 import D455Model
    from shape_obs_envs.d455.noise import D455Camera

    camera, gray = D455Camera(D455Model(), size, fast=True), np.full((*size, 3), 150, np.uint8)
    return lambda depth: np.round(np.nan_to_num(camera.measure(depth, gray, rng).metres), 3).astype(np.float32)


def see(
    axis: Array,
    radius: float | Array,
    camera: Intrinsics,
    behind: float,
    cover: Mask | None = None,
    nearer: float = _NEARER,
) -> Seen:
    """Draw a rope.

    Args:
        axis: ``(P, 3)`` metres, camera frame, from tip to tip, at equal steps.
        radius: In metres; ``(P,)`` for a body that tapers. The tips are round.
        camera: The projection.
        behind: Depth of the wall in metres; 0 for no return.
        cover: ``(H, W)`` uint8, what hides the rope; None for nothing.
        nearer: Metres from what hides the rope to it; 0 for a shadow, which has no depth of its own.
    """
    height, width = camera.height, camera.width
    pixels = camera.project(axis)
    radii = np.broadcast_to(radius, len(axis)).astype(np.float64)
    first, last = (round(float(radii[tip]) / float(np.linalg.norm(axis[1] - axis[0]))) for tip in (0, -1))
    drawn = np.column_stack([axis, radii])[first : len(axis) - last]
    balls = resample(drawn, _PIECE * float(radii.min()))
    reach = float(radii.max()) * camera.fx / float(balls[:, 2].min()) + 2
    left, top = np.clip(np.floor(pixels.min(axis=0) - reach), 0, (width, height)).astype(int)
    right, bottom = np.clip(np.ceil(pixels.max(axis=0) + reach), 0, (width, height)).astype(int)
    mask, depth = np.zeros((height, width), np.uint8), np.full((height, width), behind, np.float32)
    nearer_than_axis, over = _over_axis(axis, radius), np.zeros(len(axis), bool)
    if right > left and bottom > top:
        canvas = np.full(((bottom - top) * _FINER, (right - left) * _FINER), np.inf, np.float32)
        fine = (camera.project(balls[:, :3]) - (left, top) + 0.5) * _FINER - 0.5
        draw_balls(canvas, fine, balls[:, 2].copy(), balls[:, 3].copy(), camera.fx * _FINER)
        size = right - left, bottom - top
        share = cv2.resize(np.isfinite(canvas).view(np.uint8) * 255, size, interpolation=cv2.INTER_AREA)
        blocks = canvas.reshape(bottom - top, _FINER, right - left, _FINER)
        middle, nearest = blocks[:, _FINER // 2, :, _FINER // 2], blocks.min(axis=(1, 3))
        on = share > 127
        mask[top:bottom, left:right][on] = 255
        depth[top:bottom, left:right][on] = np.where(np.isfinite(middle), middle, nearest)[on]
        u, v = np.rint((pixels - (left, top) + 0.5) * _FINER - 0.5).astype(int).T
        inside = (u >= 0) & (v >= 0) & (u < canvas.shape[1]) & (v < canvas.shape[0])
        seen = np.where(inside, canvas[v * inside, u * inside], np.inf)
        over = seen < axis[:, 2] - nearer_than_axis - radius
        own = np.isfinite(seen) & ~over
        nearer_than_axis[own] = axis[own, 2] - seen[own]
    surface = axis * (1 - nearer_than_axis / axis[:, 2])[:, None]
    column, row = np.rint(pixels).astype(int).T
    shown = (column >= 0) & (row >= 0) & (column < width) & (row < height) & ~over
    if cover is not None:
        mask[cover > 0] = 0
        if nearer:
            depth[cover > 0] = float(axis[:, 2].min()) - nearer
        shown[shown] &= cover[row[shown], column[shown]] == 0
    return Seen(pixels, surface, shown, mask, depth, camera)


def _over_axis(axis: Array, radius: float | Array) -> Array:
    """Return ``(P,)`` how much nearer than its axis a tube's surface lies on each viewing ray, metres."""
    along = np.gradient(axis, axis=0)
    cosine = np.sum(along * axis, axis=1) / (np.linalg.norm(along, axis=1) * np.linalg.norm(axis, axis=1))
    return np.minimum(radius / np.sqrt(np.maximum(1 - cosine**2, 1e-9)), _LONGEST * radius)


@compiled("(f4[:,::1], f8[:,::1], f8[::1], f8[::1], f8)")
def draw_balls(canvas: Depth, places: Array, z: Array, radius: Array, focal: float) -> None:
    """Draw balls into an image of depth, in place; the nearest counts.

    Args:
        canvas: ``(H, W)`` metres.
        places: ``(B, 2)`` their centres, pixels.
        z: ``(B,)`` their depth, metres.
        radius: ``(B,)`` metres.
        focal: Focal length, pixels.
    """
    height, width = canvas.shape
    for b in range(len(places)):
        x, y, reach = places[b, 0], places[b, 1], radius[b] * focal / z[b]
        for v in range(max(math.ceil(y - reach), 0), min(math.floor(y + reach), height - 1) + 1):
            for u in range(max(math.ceil(x - reach), 0), min(math.floor(x + reach), width - 1) + 1):
                square = 1 - ((u - x) ** 2 + (v - y) ** 2) / reach**2
                if square >= 0:
                    canvas[v, u] = min(canvas[v, u], z[b] - radius[b] * math.sqrt(square))
