"""Draw a table with four markers, with known pose, blur, noise and uneven light; and a table with blocks.

The blocks are an analytic scene for any camera, in which the position of every edge is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import rotation
from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.markers import MarkerLayout
from shape_obs.markers.finder import dictionary_named
from tests.benchmarks.scenes.several_ropes import with_stereo_noise

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]
CAMERA: Final = Intrinsics(640, 480, 386.0, 386.0, 321.3, 244.6)
LAYOUT: Final = MarkerLayout.rectangle(marker=0.06, width=0.6, height=0.42)
_RASTER: Final = 2000  # pixels per metre of the drawn table
_MARGIN: Final = 0.35  # metres of table around the markers
_FINER: Final = 4  # supersampling in each direction
_BLUR: Final = 0.6  # blur of the lens in pixels
_NOISE: Final = 3.0  # gray levels
TABLE: Final = (200, 195, 185)
TOP: Final = (30, 60, 200)


@dataclass(frozen=True, eq=False)
class MarkerScene:
    """A table with markers in front of a camera."""

    rgb: Image  # (480, 640, 3) uint8
    transform: Array  # (4, 4), metres: p_camera = T p_table
    intrinsics: Intrinsics  # intrinsics of the camera
    layout: MarkerLayout  # positions of the markers on the table

    def to_camera(self, points: Array) -> Array:
        """Convert ``(..., 2)`` metres on the table to ``(..., 3)`` metres, camera frame."""
        return points @ self.transform[:3, :2].T + self.transform[:3, 3]

    def to_pixels(self, points: Array) -> Array:
        """Convert ``(..., 2)`` metres on the table to ``(..., 2)`` pixels."""
        return self.intrinsics.project(self.to_camera(points))

    def grid(self, steps: int = 12) -> Array:
        """Return positions all over the rectangle, (steps*steps, 2) metres."""
        low, high = self.layout.box
        axes = [np.linspace(a, b, steps) for a, b in zip(low, high, strict=True)]
        return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)

    def depth(self, rng: np.random.Generator) -> Array:
        """Return a depth image with the noise of a D455, (480, 640) metres."""
        rows, columns = np.mgrid[: self.intrinsics.height, : self.intrinsics.width]
        rays = self.intrinsics.rays(np.stack([columns, rows], axis=-1))
        normal = self.transform[:3, 2]
        depth = (normal @ self.transform[:3, 3]) / (rays @ normal)
        return with_stereo_noise(depth, self.intrinsics.fx, rng)


def marker_scene(seed: int, layout: MarkerLayout = LAYOUT, intrinsics: Intrinsics = CAMERA) -> MarkerScene:
    """Draw a scene whose distance, tilt, turn, light and noise depend on the seed."""
    rng = np.random.default_rng(seed)
    transform = random_pose(rng, np.mean(layout.box, axis=0), (0.65, 0.9), 35.0)
    table, origin = _table(layout, rng)
    return MarkerScene(photograph(table, origin, _RASTER, transform, intrinsics, rng), transform, intrinsics, layout)


def random_pose(
    rng: np.random.Generator, middle: Array, distance: tuple[float, float], tilt: float, aside: float = 0.03
) -> Array:
    """Draw a pose p_camera = T p_table, (4, 4), of a table by the distance of its ``middle`` and the largest tilt."""
    lean, towards, turn = np.radians(rng.uniform(0, tilt)), rng.uniform(0, 2 * np.pi), rng.uniform(-0.4, 0.4)
    axis = lean * np.array([np.cos(towards), np.sin(towards), 0])
    rotation = cv2.Rodrigues(axis)[0] @ cv2.Rodrigues(np.array([0, 0, turn]))[0]
    transform = np.eye(4)
    transform[:3, :3] = rotation
    away = np.array([*rng.uniform(-aside, aside, 2), rng.uniform(*distance)])
    transform[:3, 3] = away - rotation[:, :2] @ middle
    return transform


def photograph(
    table: Image, origin: Array, raster: float, transform: Array, intrinsics: Intrinsics, rng: np.random.Generator
) -> Image:
    """Return the camera's image, ``(H, W, 3)``, of a drawn (h, w) table whose upper left corner is at ``origin``."""
    to_metres = np.diag([1 / raster, 1 / raster, 1.0])
    to_metres[:2, 2] = origin + 0.5 / raster
    finer = np.diag([_FINER, _FINER, 1.0])
    finer[:2, 2] = 0.5 * (_FINER - 1)
    size = intrinsics.width, intrinsics.height
    warp = finer @ intrinsics.matrix @ transform[:3, (0, 1, 3)] @ to_metres
    seen = cv2.warpPerspective(
        table, warp, (size[0] * _FINER, size[1] * _FINER), flags=cv2.INTER_AREA, borderValue=(150.0,)
    )
    gray = cv2.GaussianBlur(cv2.resize(seen, size, interpolation=cv2.INTER_AREA).astype(np.float64), (0, 0), _BLUR)
    slope = rng.uniform(-0.15, 0.15, 2)
    x, y = np.linspace(-1, 1, size[0]), np.linspace(-1, 1, size[1])[:, None]
    light = rng.uniform(0.7, 1.0) * (1 + slope[0] * x + slope[1] * y)
    rgb = (gray * light)[..., None] * (1.0, 0.98, 0.94) + rng.normal(0, _NOISE, (*gray.shape, 3))
    return np.clip(np.round(rgb), 0, 255).astype(np.uint8)


def _table(layout: MarkerLayout, rng: np.random.Generator) -> tuple[Image, Array]:
    """Draw a speckled table with the markers on white paper; return it and its upper left corner in metres."""
    low, high = np.array(layout.box[0]) - _MARGIN, np.array(layout.box[1]) + _MARGIN
    size = np.ceil((high - low) * _RASTER).astype(int).tolist()
    coarse = rng.normal(165, 12, (size[1] // 40, size[0] // 40))
    table = np.clip(cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC), 0, 255).astype(np.uint8)
    side, paper = 600, 120
    square = np.array([[0, 0], [side, 0], [side, side], [0, side]]) + paper - 0.5
    for each, corners in zip(layout.ids, layout.array, strict=True):
        marker = cv2.aruco.generateImageMarker(dictionary_named(layout.dictionary), each, side)
        sheet = np.pad(marker, paper, constant_values=235).clip(25, 235)
        places = ((corners - low) * _RASTER - 0.5).astype(np.float32)
        onto = cv2.getPerspectiveTransform(square.astype(np.float32), places)
        cover = cv2.warpPerspective(np.full_like(sheet, 255), onto, size)
        table = np.where(cover > 127, cv2.warpPerspective(sheet, onto, size, flags=cv2.INTER_AREA), table)
    return table, low


@dataclass(frozen=True)
class Block:
    """A thin lid above the table at z = 0: each edge is a jump in depth at the same position for every camera."""

    centre: tuple[float, float]  # (x, y) in metres, base frame
    size: tuple[float, float, float]  # its edges along its x and y, and its height above the table, in metres
    yaw: float = 0.0  # rotation about the vertical in radians

    @property
    def top_centre(self) -> Array:
        """The middle of the lid, ``(3,)`` metres, base frame."""
        return np.array([*self.centre, self.size[2]])

    def top_outline(self, n: int = 20) -> Array:
        """Return n points on each edge of the lid, (4 n, 3) metres, base frame; lenses bend edges."""
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2 * self.size[:2] @ rotation(self.yaw).T
        share, following = np.arange(n)[:, None] / n, np.roll(corners, -1, axis=0)
        edges = corners[:, None] + share * (following - corners)[:, None] + self.centre
        return np.column_stack([edges.reshape(-1, 2), np.full(4 * n, self.size[2])])


def rows_of_blocks(rng: np.random.Generator) -> list[Block]:
    """Draw twelve blocks of 45 to 60 mm at any angle, in three rows that fill the image of a D455 at 0.62 m."""
    return [
        Block((x, y), (rng.uniform(0.045, 0.06), rng.uniform(0.045, 0.06), 0.03), rng.uniform(0, np.pi))
        for y in (-0.22, 0.0, 0.22)
        for x in (-0.33, -0.11, 0.11, 0.33)
    ]


def see(blocks: list[Block], camera: CameraModel) -> tuple[npt.NDArray[np.uint8], Array]:
    """Render blocks by a ray through the middle of every raw pixel, including lens distortion.

    Returns:
        RGB, ``(H, W, 3)`` uint8, and depth along the optical axis, ``(H, W)`` metres.
    """
    height, width = camera.intrinsics.size
    eye = camera.to_base(np.zeros(3))
    rays = camera.intrinsics.rays(np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1))
    along = camera.to_base(rays) - eye  # rays have z = 1, so that their parameter is the depth
    down = np.where(along[..., 2] < 0, along[..., 2], np.nan)
    rgb, depth = np.full((height, width, 3), TABLE, np.uint8), -eye[2] / down
    for block in blocks:
        enter = (block.size[2] - eye[2]) / down
        at = (eye[:2] + enter[..., None] * along[..., :2] - block.centre) @ rotation(block.yaw)
        lid = (np.abs(at) <= np.array(block.size[:2]) / 2).all(axis=-1) & (enter < depth)
        rgb[lid], depth[lid] = TOP, enter[lid]
    return rgb, depth
