"""Blocks on a table, seen by any camera: an analytic scene in which the place of every edge is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel

Array = npt.NDArray[np.float64]
TABLE: Final = (200, 195, 185)
TOP: Final = (30, 60, 200)
FOOT: Final = (90, 90, 90)
_THICK, _INSET = 0.001, 0.01  # metres


@dataclass(frozen=True)
class Block:
    """A thin lid on a foot that is smaller all around, on the table, z = 0.

    From above the upper half of its height shows nothing but the lid, so that each edge of the lid is a jump in depth
    and its place is the same for every camera.

    Args:
        centre: (x, y) of its footprint [m], base frame.
        size: The lid's edges along its own x and y, and its height [m].
        yaw: Turn about the vertical [rad].
    """

    centre: tuple[float, float]
    size: tuple[float, float, float]
    yaw: float = 0.0

    @property
    def top_centre(self) -> Array:
        """(3,) the middle of the lid [m], base frame."""
        return np.array([*self.centre, self.size[2]])

    def top_outline(self, n: int = 20) -> Array:
        """(4 n, 3) points along the edges of the lid [m], base frame: n a side, since lenses bend edges."""
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2 * self.size[:2] @ self.rotation.T + self.centre
        share = np.arange(n)[:, None] / n
        edges = [a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
        return np.column_stack([np.concatenate(edges), np.full(4 * n, self.size[2])])

    @property
    def rotation(self) -> Array:
        """(2,2) block -> base."""
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([[cos, -sin], [sin, cos]])


def rows_of_blocks(rng: np.random.Generator, height: float = 0.03) -> list[Block]:
    """Twelve blocks of 45 mm to 60 mm, turned any way, in three rows that fill a D455's picture at 0.62 m."""
    return [
        Block((x, y), (rng.uniform(0.045, 0.06), rng.uniform(0.045, 0.06), height), rng.uniform(0, np.pi))
        for y in (-0.22, 0.0, 0.22)
        for x in (-0.33, -0.11, 0.11, 0.33)
    ]


def see(blocks: list[Block], camera: CameraModel) -> tuple[npt.NDArray[np.uint8], Array]:
    """What a camera sees, ray by ray through the middle of every raw pixel, lens distortion and all.

    Returns:
        RGB (H,W,3) uint8, and depth along the optical axis (H,W) [m].
    """
    intrinsics = camera.intrinsics
    height, width = intrinsics.size
    rays = intrinsics.rays(np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1))
    eye = camera.to_base(np.zeros(3))
    along = camera.to_base(rays) - eye  # a ray's parameter is depth, since rays have z = 1
    with np.errstate(divide="ignore"):
        depth = np.where(along[..., 2] < 0, -eye[2] / along[..., 2], np.nan)
    rgb = np.empty((height, width, 3), np.uint8)
    rgb[:] = TABLE
    for block in blocks:
        width, length, top = block.size
        foot = width - 2 * _INSET, length - 2 * _INSET, top - _THICK
        part = _window(block, camera)
        for size, base, colour in (((width, length, _THICK), foot[2], TOP), (foot, 0.0, FOOT)):
            enter = _hit(block, size, base, eye, along[part])
            nearer = enter < depth[part]
            depth[part][nearer] = enter[nearer]
            rgb[part][nearer] = colour
    return rgb, depth


def _window(block: Block, camera: CameraModel) -> tuple[slice, slice]:
    """Rows and columns in which a block may be seen."""
    lid = block.top_outline()
    pixels = camera.project_from_base(np.concatenate([lid, lid * (1, 1, 0)]))
    (left, top), (right, bottom) = np.floor(pixels.min(axis=0)) - 1, np.ceil(pixels.max(axis=0)) + 2
    return slice(max(int(top), 0), max(int(bottom), 0)), slice(max(int(left), 0), max(int(right), 0))


def _hit(block: Block, size: tuple[float, float, float], base: float, eye: Array, along: Array) -> Array:
    """Where rays enter a box of this size over the block's place, inf where they miss: (...,) in lengths of the ray."""
    half = np.array(size) / 2
    start, step = eye.copy(), along.copy()
    start[:2] = (eye[:2] - block.centre) @ block.rotation
    start[2] -= base + half[2]
    step[..., :2] = along[..., :2] @ block.rotation
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (-half - start) / step, (half - start) / step
    enter, leave = np.minimum(one, other).max(axis=-1), np.maximum(one, other).min(axis=-1)
    return np.where((enter < leave) & (enter > 0), enter, np.inf)
