"""Draw ropes with depth, in a plane or in space, while hands, shadows, bars and the image's border hide a part of them.

What hides a rope grows from nothing, at any speed. The rope is a tube in front of a wall, or of nothing that returns
depth, made of balls; its mask and its depth are drawn together.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any, Final, Literal, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs.compiled import compiled
from tests.benchmarks.scenes.ropes import moving_curve, resample, rotation

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]
Depth = npt.NDArray[np.float32]
Cover = Literal["hand", "shadow", "bar", "border"]

_FINER: Final = 4  # supersampling in each direction
_NEARER: Final = 0.08  # metres from a hand or a bar to the rope
_HAND: Final = (40.0, 80.0)  # radius in pixels
_AWAY: Final = 25  # frames before something comes, and after it has gone
_STAYS: Final = 40
_PLANE: Final = 0.7  # metres to a rope that moves in a plane
_TABLE: Final = 0.01  # metres from there to the table
_PIECE: Final = 0.2  # radii from one drawn ball to the next
_LONGEST: Final = 4.0  # radii from the axis to the surface, on a ray along the rope
_CLEAR: Final = 14.0  # pixels from the rope's tip at which something is away
_WIDE: Final = 640
_BEHIND: Final = 0.3  # metres from the farthest point of a rope in space to the wall


class Seen(NamedTuple):
    """One frame of a rope.

    Args:
        pixels: ``(P, 2)`` its axis from tip to tip at equal steps of material.
        metres: ``(P, 3)`` the same on the visible surface, on the viewing rays of the axis, camera frame.
        shown: ``(P,)`` bool: in sight, neither hidden, by something or the rope itself, nor outside the image.
        mask: ``(H, W)`` uint8, 0 or 255.
        depth: ``(H, W)`` float32 metres, 0 where nothing is measured.
        camera: The projection.
    """

    pixels: Array
    metres: Array
    shown: npt.NDArray[np.bool_]
    mask: Mask
    depth: Depth
    camera: Intrinsics


def camera_of(size: tuple[int, int]) -> Intrinsics:
    """Return a camera with a horizontal field of view of 56 degrees for images of ``size`` ``(H, W)``."""
    height, width = size
    focal = width * 600 / 640
    return Intrinsics(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def see(
    axis: Array, radius: float, camera: Intrinsics, behind: float, cover: Mask | None = None, nearer: float = _NEARER
) -> Seen:
    """Draw a rope.

    Args:
        axis: ``(P, 3)`` metres, camera frame, from tip to tip, at equal steps.
        radius: In metres; the tips are round.
        camera: The projection.
        behind: Depth of the wall in metres; 0 for no return.
        cover: ``(H, W)`` uint8, what hides the rope; None for nothing.
        nearer: Metres from what hides the rope to it; 0 for a shadow, which has no depth of its own.
    """
    height, width = camera.height, camera.width
    pixels = camera.project(axis)
    step = float(np.linalg.norm(axis[1] - axis[0]))
    inset = round(radius / step)
    balls = resample(axis[inset : len(axis) - inset], _PIECE * radius)
    thick = 2 * radius * camera.fx / balls[:, 2]
    reach = float(thick.max()) / 2 + 2
    left, top = np.clip(np.floor(pixels.min(axis=0) - reach), 0, (width, height)).astype(int)
    right, bottom = np.clip(np.ceil(pixels.max(axis=0) + reach), 0, (width, height)).astype(int)
    mask, depth = np.zeros((height, width), np.uint8), np.full((height, width), behind, np.float32)
    nearer_than_axis, over = _over_axis(axis, radius), np.zeros(len(axis), bool)
    if right > left and bottom > top:
        canvas = np.full(((bottom - top) * _FINER, (right - left) * _FINER), np.inf, np.float32)
        fine = (camera.project(balls) - (left, top) + 0.5) * _FINER - 0.5
        draw_balls(canvas, np.ascontiguousarray(fine), np.ascontiguousarray(balls[:, 2]), radius, camera.fx * _FINER)
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


def _over_axis(axis: Array, radius: float) -> Array:
    """Return ``(P,)`` how much nearer than its axis a tube's surface lies on each viewing ray, metres."""
    along = np.gradient(axis, axis=0)
    cosine = np.sum(along * axis, axis=1) / (np.linalg.norm(along, axis=1) * np.linalg.norm(axis, axis=1))
    return np.minimum(radius / np.sqrt(np.maximum(1 - cosine**2, 1e-9)), _LONGEST * radius)


@compiled("(f4[:,::1], f8[:,::1], f8[::1], f8, f8)")
def draw_balls(canvas: Depth, places: Array, z: Array, radius: float, focal: float) -> None:
    """Draw balls into an image of depth, in place; the nearest counts.

    Args:
        canvas: ``(H, W)`` metres.
        places: ``(B, 2)`` their centres, pixels.
        z: ``(B,)`` their depth, metres.
        radius: In metres.
        focal: Focal length, pixels.
    """
    height, width = canvas.shape
    for b in range(len(places)):
        x, y, reach = places[b, 0], places[b, 1], radius * focal / z[b]
        for v in range(max(math.ceil(y - reach), 0), min(math.floor(y + reach), height - 1) + 1):
            for u in range(max(math.ceil(x - reach), 0), min(math.floor(x + reach), width - 1) + 1):
                square = 1 - ((u - x) ** 2 + (v - y) ** 2) / reach**2
                if square >= 0:
                    canvas[v, u] = min(canvas[v, u], z[b] - radius * math.sqrt(square))


def hidden_ropes(
    rng: np.random.Generator,
    cover: Cover,
    approach: float,
    speed: float,
    *,
    share: float = 0.3,
    size: tuple[int, int] = (480, 640),
    table: bool = True,
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
    """
    camera, scale = camera_of(size), size[1] / 640
    width = float(rng.uniform(7, 13))
    motion = moving_curve(rng, speed, 100_000, width=width)
    curve = next(motion)
    hider = _HIDERS[cover](rng, curve)
    radius, behind = width / 2 * scale / camera.fx * _PLANE, _PLANE + _TABLE if table else 0.0
    for distance in _schedule(hider, approach, share):
        hider.move(curve, distance)
        moved = resample(curve + hider.offset, 1.0) * scale
        drawn = hider.mask(size, scale)
        yield see(camera.rays(moved) * _PLANE, radius, camera, behind, drawn, 0.0 if cover == "shadow" else _NEARER)
        curve = next(motion)


def _schedule(hider: _Hider, approach: float, share: float) -> Iterator[float]:
    """Yield how far something has come in each frame: it is away, comes, stays, goes, and is gone."""
    yield from (0.0 for _ in range(_AWAY))
    distance = 0.0
    while hider.hidden < share and not hider.past:
        distance += approach
        yield distance
    if not hider.past:
        yield from (distance for _ in range(_STAYS))
        while distance > 0:
            distance -= approach
            yield max(distance, 0.0)
    yield from (distance for _ in range(_AWAY))


class _Hider:
    """What hides a rope: its place, the share of the rope that it hides, and whether it has passed."""

    offset: Array = np.zeros(2)
    hidden, past = 0.0, False

    def move(self, curve: Array, distance: float) -> None:
        """Move to where it is in this frame, ``distance`` pixels from where it was away."""
        raise NotImplementedError

    def mask(self, size: tuple[int, int], scale: float) -> Mask | None:
        """Return the pixels that it covers in an image of ``size``, ``scale`` times as large as 640 x 480."""
        return None


class _Hand(_Hider):
    """A disc that comes over an end from ahead, at an angle."""

    def __init__(self, rng: np.random.Generator, curve: Array) -> None:
        self._end, self._radius, aside = int(rng.integers(2)), float(rng.uniform(*_HAND)), rng.uniform(-0.7, 0.7)
        self._turn, self._middle, self._distance = rotation(aside), np.zeros(2), 0.0

    def move(self, curve: Array, distance: float) -> None:
        tip, before = (curve[-1], curve[-21]) if self._end else (curve[0], curve[20])
        out = self._turn @ (tip - before) / np.linalg.norm(tip - before)
        self._middle, self._distance = tip + out * (self._radius + _CLEAR - distance), distance
        self.hidden = float(np.mean(np.linalg.norm(curve - self._middle, axis=1) < self._radius))
        self.past = distance > 2 * self._radius + 400

    def mask(self, size: tuple[int, int], scale: float) -> Mask | None:
        if not self._distance:
            return None
        out = np.zeros(size, np.uint8)
        place = np.rint(self._middle * scale * 16).astype(int).tolist()
        cv2.circle(out, place, round(self._radius * scale * 16), (255.0,), -1, shift=4)
        return out


class _Bar(_Hider):
    """A band that crosses the image at an angle."""

    def __init__(self, rng: np.random.Generator, curve: Array) -> None:
        self._breadth, angle = float(rng.uniform(40, 200)), float(rng.uniform(0, 2 * np.pi))
        self._way = np.array([np.cos(angle), np.sin(angle)])
        self._start = float((curve @ self._way).min()) - self._breadth / 2 - _CLEAR
        self._at = self._start

    def move(self, curve: Array, distance: float) -> None:
        self._at = self._start + distance
        self.past = self._at > float((curve @ self._way).max()) + self._breadth / 2 + _CLEAR

    def mask(self, size: tuple[int, int], scale: float) -> Mask | None:
        v, u = np.mgrid[: size[0], : size[1]]
        across = (u * self._way[0] + v * self._way[1]) / scale - self._at
        return (np.abs(across) < self._breadth / 2).astype(np.uint8) * 255


class _Border(_Hider):
    """The left or right border of the image, over which the rope slides."""

    def __init__(self, rng: np.random.Generator, curve: Array) -> None:
        self._right = int(rng.integers(2))
        room = _WIDE - 1 - curve[:, 0].max() if self._right else curve[:, 0].min()
        self._begin = float(room) - 2 * _CLEAR

    def move(self, curve: Array, distance: float) -> None:
        slid = self._begin + distance
        self.offset = np.array([slid if self._right else -slid, 0.0])
        column = curve[:, 0] + self.offset[0]
        self.hidden = float(np.mean((column < 0) | (column > _WIDE - 1)))


_HIDERS: Final = {"hand": _Hand, "shadow": _Hand, "bar": _Bar, "border": _Border}


def swinging_ropes(curves: Iterable[Array], radius: float, camera: Intrinsics, wall: bool) -> Iterator[Seen]:
    """Draw the frames of a rope in space, ``(P, 3)`` metres each, in front of a wall or of nothing."""
    for curve in curves:
        yield see(curve, radius, camera, float(curve[:, 2].max()) + _BEHIND if wall else 0.0)


def with_noise(seen: Seen, measure: Any, rng: np.random.Generator) -> Seen:
    """Return a frame with the depth that a noisy camera measures: ``measure(metres, rgb, rng)``."""
    rgb = np.full((*seen.mask.shape, 3), 150, np.uint8)
    metres, _ = measure(seen.depth, rgb, rng)
    return seen._replace(depth=np.round(np.nan_to_num(metres), 3).astype(np.float32))
