"""Draw cloths and rings in space with depth, under a hand, lifted, tilted and folded; every material point is known.

A flat object is a grid of material points that bends about cylinders alone, so that distances along it stay. A triangle
mesh is rasterised with a depth buffer, which also tells which material points a fold or a hand hides.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Final, Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from shape_obs.bench.scenes import rotation
from shape_obs.camera import Intrinsics
from shape_obs.compiled import compiled
from tests.scenes.hidden_ropes import d455

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Motion = Literal["tilted", "corner up", "folded"]
Hand = Literal["corner", "side"]

_CLOTH: Final = (65, 65)  # rows and columns of the mesh
_BAND: Final = (4, 128)  # from the inner to the outer border, and around
_AREA: Final = 0.075  # square metres of a cloth
_RADIUS: Final = 0.13  # metres, of a ring or a plain blob
_HOLE: Final = 0.62  # of the radius
_DISTANCE: Final = 0.62  # metres from the camera
_HAND_ABOVE: Final = 0.06  # metres
_WALL: Final = 0.95  # metres
_HIDES: Final = 0.004  # metres: what is nearer by more lies over a point


@dataclass(frozen=True)
class FlatScene:
    """One frame."""

    space: Array  # (R, C, 3) metres, the material grid, camera frame
    points: Array  # (R, C, 2) its pixels
    hidden: Bools  # (R, C) bool: something lies over the point, its back is turned to the camera, or it is out of sight
    mask: npt.NDArray[np.uint8]  # (H, W) uint8, 0 or 255
    depth: npt.NDArray[np.float32]  # (H, W) float32 metres, 0 where nothing returns any
    shown: float  # the share of the object that is seen


@dataclass(frozen=True)
class View:
    """How the object is seen."""

    height: int = 480  # rows of the image, in the aspect of 640 x 480
    wall: bool = True  # whether a wall behind the object returns depth
    focal: float = 386.0  # pixels of 640 x 480; a D455's by default

    @property
    def intrinsics(self) -> Intrinsics:
        """The projection at this size."""
        scale = self.height / 480
        return Intrinsics(
            4 * self.height // 3, self.height, self.focal * scale, self.focal * scale, 320 * scale, 240 * scale
        )


def cloth(aspect: float) -> Array:
    """Return the material grid of a cloth of an aspect (width over height), (65, 65, 2) metres about its middle."""
    down, across = (np.linspace(-0.5, 0.5, count) for count in _CLOTH)
    width = (_AREA * aspect) ** 0.5
    return np.stack(np.meshgrid(across * width, down * width / aspect), axis=-1)


def ring(rng: np.random.Generator, hollow: bool) -> Array:
    """Return a closed band, or a plain blob, (4, 128, 2) metres: from inside to outside, clockwise around."""
    around = 2 * np.pi * np.arange(_BAND[1]) / _BAND[1]
    waves = [rng.uniform(0.05, 0.12) / k * np.cos((k + 1) * around + rng.uniform(0, 6)) for k in (1, 2, 3)]
    radius = _RADIUS * (1 + np.sum(waves, axis=0))
    border = radius[:, None] * np.stack([np.cos(around), np.sin(around)], axis=1)
    return np.linspace(_HOLE if hollow else 0.02, 1, _BAND[0])[:, None, None] * border


def under_hand(
    rng: np.random.Generator,
    flat: Array,
    view: View,
    place: Hand,
    speed: float,
    moving: float = 0.0,
    *,
    level: bool = False,
) -> Iterator[FlatScene]:
    """Draw a flat object over which a hand comes from outside, stays and goes.

    Args:
        rng: Draws the scene.
        flat: ``(R, C, 2)`` the material grid.
        view: How it is seen.
        place: What the hand covers.
        speed: Pixels of a 640 x 480 image per frame, of the hand.
        moving: The same of the object.
        level: Whether the object lies flat on a table under the camera: without depth, tilt looks like hiding.
    """
    scale, closed, camera = view.height / 480, len(flat) == _BAND[0], view.intrinsics
    pose = _Pose(rng, flat, 0.0 if level else np.radians(15), 0.0 if level else 0.03, "flat" if level else "waving")
    border = flat[-1] if closed else flat[[0, 0, -1, -1], [0, -1, -1, 0]]
    at = int(rng.integers(len(border)))
    target = border[at] if place == "corner" or closed else (border[at] + border[(at + 1) % 4]) / 2
    way, width, deep = target / np.linalg.norm(target), rng.uniform(30, 60) * scale, rng.uniform(70, 120) * scale
    way = rotation(rng.uniform(-0.5, 0.5)) @ way
    steps = int(np.ceil(deep / (speed * scale)))
    comes, goes = np.linspace(0, 1, steps), np.linspace(1, 0, steps)
    inwards = np.concatenate([[-3, -2, -1], comes, np.ones(15), goes, [-1, -2, -3], -np.ones(12)])
    for share, time in zip(inwards, islice(pose.times(view, moving, len(inwards) + 1), 1, None), strict=True):
        spot, beyond = camera.project(pose.at(np.stack([target, target + 0.1 * way])[None], time)[0])
        ahead = (beyond - spot) / np.linalg.norm(beyond - spot)
        tip = spot + ahead * (width - deep * share if share >= 0 else 2 * width)
        yield seen(pose.at(flat, time), closed, view, (tip, ahead, width))


def in_space(
    rng: np.random.Generator, flat: Array, view: View, motion: Motion, speed: float, frames: int = 120
) -> Iterator[FlatScene]:
    """Draw a flat object that is swung through the air; its fastest point moves ``speed`` pixels a frame at most.

    Args:
        rng: Draws the motion.
        flat: ``(R, C, 2)`` the material grid.
        view: How it is seen.
        motion: It tilts to 60 degrees, a corner (or side) bends towards the camera, or it is folded over a line.
        speed: Pixels of a 640 x 480 image per frame.
        frames: How many.
    """
    pose = _Pose(rng, flat, np.radians(60 if motion == "tilted" else 25), 0.12, motion)
    for time in pose.times(view, speed, frames):
        yield seen(pose.at(flat, time), len(flat) == _BAND[0], view, None)


def noisy_depth(scenes: Iterator[FlatScene], view: View, seed: int) -> Iterator[FlatScene]:
    """Put a D455's noise on the depth of scenes; needs the environments' package."""
    measure = d455((view.height, 4 * view.height // 3), np.random.default_rng(seed))
    return (replace(scene, depth=measure(scene.depth)) for scene in scenes)


class _Pose:
    """A smooth motion: material points -> camera frame."""

    def __init__(
        self, rng: np.random.Generator, flat: Array, tilt: float, lift: float, bend: Motion | Literal["flat", "waving"]
    ) -> None:
        self.flat, self.tilt, self.lift, self.bend = flat, tilt, lift, bend
        self.phase, self.pace = rng.uniform(0, 2 * np.pi, 8), rng.uniform(0.5, 1.0, 8)
        self.spin, self.start = rng.uniform(0.1, 0.3) * rng.choice([-1, 1]), rng.uniform(-np.pi, np.pi)
        self.towards = rng.uniform(0, 2 * np.pi)
        self.corner = np.array([rng.choice([-1, 1]), rng.choice([-1, 1])])

    def at(self, points: Array, time: float) -> Array:
        """Return where material points are, (R, C, 2) -> (R, C, 3) metres."""
        wave, sway = np.sin(self.pace * time + self.phase), (1 - np.cos(self.pace[0] * time)) / 2
        heading = self.towards + 0.5 * time
        lean = self.tilt * (sway if self.bend == "tilted" else wave[0])
        turn = Rotation.from_rotvec([lean * np.cos(heading), lean * np.sin(heading), 0.0])
        turn = (turn * Rotation.from_rotvec([0.0, 0.0, self.start + self.spin * time])).as_matrix()
        away = np.array([0.05 * wave[1], 0.035 * wave[2], _DISTANCE - self.lift * (0.5 + 0.5 * wave[3])])
        return self._bent(points, time) @ turn.T + away

    def times(self, view: View, speed: float, frames: int) -> Iterator[float]:
        """Yield the times of frames between which the border moves ``speed`` pixels of a 640 x 480 image at most."""
        some, camera, time = self.flat[[0, -1]][:, :: max(self.flat.shape[1] // 16, 1)], view.intrinsics, 0.0
        for _ in range(frames):
            yield time
            low, high, before = 0.0, 0.5 if speed else 0.0, camera.project(self.at(some, time))
            for _ in range(12):
                step = (low + high) / 2
                far = np.linalg.norm(camera.project(self.at(some, time + step)) - before, axis=-1).max()
                low, high = (low, step) if far > speed * view.height / 480 else (step, high)
            time += low

    def _bent(self, points: Array, time: float) -> Array:
        if self.bend == "flat":
            return np.concatenate([points, np.zeros((*points.shape[:2], 1))], axis=-1)
        if self.bend not in ("corner up", "folded"):
            way, bend = np.array([np.cos(self.towards), np.sin(self.towards)]), 1.5 * np.sin(self.pace[4] * time)
            halves = [rolled(points, side * way, 0.0, 1 / max(abs(bend), 1e-3), np.pi) for side in (1, -1)]
            return np.where((points @ way > 0)[..., None], *halves) * (1, 1, np.sign(bend))
        corner = self.corner * np.abs(self.flat[-1, -1]) if len(self.flat) != _BAND[0] else self.flat[-1, 20]
        way = corner / np.linalg.norm(corner)
        reach = float((self.flat @ way).max())
        most, radius, share = (np.radians(75), 0.05, 0.45) if self.bend == "corner up" else (np.pi, 0.008, 0.6)
        return rolled(points, way, share * reach, radius, most * (1 - np.cos(0.9 * self.pace[5] * time)) / 2)


def rolled(flat: Array, way: Array, begin: float, radius: float, most: float) -> Array:
    """Roll a plane about a cylinder, towards the camera, where it goes beyond ``begin`` along ``way``; (..., 3)."""
    along = flat @ way
    over = np.maximum(along - begin, 0.0)
    angle = np.minimum(over / radius, most)
    rest = over - angle * radius
    forward = radius * np.sin(angle) + rest * np.cos(angle)
    up = radius * (1 - np.cos(angle)) + rest * np.sin(angle)
    moved = flat + (np.minimum(along, begin) + forward - along)[..., None] * way
    return np.concatenate([moved, -up[..., None]], axis=-1)


def seen(space: Array, closed: bool, view: View, hand: tuple[Array, Array, float] | None) -> FlatScene:
    """Draw a frame of a grid, whose last column joins the first if it is closed; a hand is its tip, way and width."""
    camera, shape = view.intrinsics, space.shape[:2]
    flat = np.ascontiguousarray(space.reshape(-1, 3))
    row, col = np.meshgrid(np.arange(shape[0] - 1), np.arange(shape[1] - (not closed)), indexing="ij")
    a, b = row * shape[1] + col, row * shape[1] + (col + 1) % shape[1]
    halves = np.stack([a, b, a + shape[1]], -1), np.stack([b, b + shape[1], a + shape[1]], -1)
    pixels = camera.project(flat)
    buffer = _rasterised(pixels, 1 / flat[:, 2], np.concatenate(halves).reshape(-1, 3), camera.height, camera.width)
    drawn = buffer > 0
    depth = np.where(drawn, 1 / np.maximum(buffer, 1e-9), _WALL if view.wall else 0.0)
    over = np.zeros_like(drawn)
    if hand is not None:
        tip, ahead, width = hand
        v, u = np.mgrid[: camera.height, : camera.width]
        along = np.maximum((u - tip[0]) * ahead[0] + (v - tip[1]) * ahead[1], 0)
        over = np.hypot(u - tip[0] - along * ahead[0], v - tip[1] - along * ahead[1]) <= width
        depth[over] = float(flat[:, 2].min()) - _HAND_ABOVE
    column, row = np.rint(np.nan_to_num(pixels, nan=-1)).astype(int).T
    inside = (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
    column, row = column.clip(0, camera.width - 1), row.clip(0, camera.height - 1)
    hidden = ~inside | over[row, column] | (drawn[row, column] & (depth[row, column] < flat[:, 2] - _HIDES))
    mask = np.where(drawn & ~over, np.uint8(255), np.uint8(0))
    shown = np.count_nonzero(mask) / max(np.count_nonzero(drawn), 1) * float(np.mean(inside))
    down, right = np.asarray(np.gradient(pixels.reshape(*shape, 2), axis=(0, 1)))
    turned = (right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0]).ravel() < 0
    hidden |= turned != (np.mean(turned) > 0.5)  # its back is seen, as that of a folded corner
    return FlatScene(space, pixels.reshape(*shape, 2), hidden.reshape(shape), mask, depth.astype(np.float32), shown)


@compiled("(f8[:,::1], f8[::1], i8[:,::1], i8, i8)")
def _rasterised(pixels: Array, inverse: Array, triangles: npt.NDArray[np.int64], height: int, width: int) -> Array:
    """Return the largest inverse depth of the triangles over each pixel's centre, ``(H, W)``, 0 for none."""
    out = np.zeros((height, width))
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        au, av, bu, bv, cu, cv = pixels[a, 0], pixels[a, 1], pixels[b, 0], pixels[b, 1], pixels[c, 0], pixels[c, 1]
        area = (bu - au) * (cv - av) - (bv - av) * (cu - au)
        if abs(area) < 1e-12:
            continue
        for v in range(max(int(np.ceil(min(av, bv, cv))), 0), min(int(np.floor(max(av, bv, cv))), height - 1) + 1):
            for u in range(max(int(np.ceil(min(au, bu, cu))), 0), min(int(np.floor(max(au, bu, cu))), width - 1) + 1):
                p = ((bu - u) * (cv - v) - (bv - v) * (cu - u)) / area
                q = ((cu - u) * (av - v) - (cv - v) * (au - u)) / area
                if p >= 0 and q >= 0 and p + q <= 1:
                    out[v, u] = max(out[v, u], p * inverse[a] + q * inverse[b] + (1 - p - q) * inverse[c])
    return out
