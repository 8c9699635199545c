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

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]
CAMERA: Final = Intrinsics(640, 480, 386.0, 386.0, 321.3, 244.6)
LAYOUT: Final = MarkerLayout.rectangle(marker=0.06, width=0.6, height=0.42)
DISTANCE: Final = (0.65, 0.9)  # metres from the camera to the middle of the rectangle
TILT: Final = 35.0  # degrees, at most
_RASTER: Final = 2000  # pixels per metre of the drawn table
_MARGIN: Final = 0.35  # metres of table around the markers
_FINER: Final = 4  # supersampling in each direction
_BLUR: Final = 0.6  # blur of the lens in pixels
_NOISE: Final = 3.0  # gray levels
TABLE: Final = (200, 195, 185)
TOP: Final = (30, 60, 200)
FOOT: Final = (90, 90, 90)
_THICK, _INSET = 0.001, 0.01  # metres


@dataclass(frozen=True, eq=False)
class MarkerScene:
    """A table with markers in front of a camera.

    Args:
        rgb: (480, 640, 3) uint8.
        transform: ``(4, 4)``, metres: p_camera = T p_table.
        intrinsics: Intrinsics of the camera.
        layout: Positions of the markers on the table.
    """

    rgb: Image
    transform: Array
    intrinsics: Intrinsics
    layout: MarkerLayout

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
        sigma = depth**2 * 0.08 / (self.intrinsics.fx * 0.095)  # disparity error 0.08 px, baseline 95 mm
        noise = cv2.GaussianBlur(rng.normal(size=depth.shape), (0, 0), 1.0)  # stereo matching correlates neighbours
        return depth + sigma * noise / noise.std()


def marker_scene(seed: int, layout: MarkerLayout = LAYOUT, intrinsics: Intrinsics = CAMERA) -> MarkerScene:
    """Draw a scene whose distance, tilt, turn, light and noise depend on the seed."""
    rng = np.random.default_rng(seed)
    transform = random_pose(rng, np.mean(layout.box, axis=0), DISTANCE, TILT)
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
    to_metres = np.array(
        [[1 / raster, 0, origin[0] + 0.5 / raster], [0, 1 / raster, origin[1] + 0.5 / raster], [0, 0, 1]]
    )
    finer = np.array([[_FINER, 0, 0.5 * (_FINER - 1)], [0, _FINER, 0.5 * (_FINER - 1)], [0, 0, 1]])
    warp = finer @ intrinsics.matrix @ transform[:3, (0, 1, 3)] @ to_metres
    large = (intrinsics.width * _FINER, intrinsics.height * _FINER)
    seen = cv2.warpPerspective(table, warp, large, flags=cv2.INTER_AREA, borderValue=150)
    gray = cv2.resize(seen, (intrinsics.width, intrinsics.height), interpolation=cv2.INTER_AREA).astype(np.float64)
    gray = cv2.GaussianBlur(gray, (0, 0), _BLUR)
    slope = rng.uniform(-0.15, 0.15, 2)
    x, y = np.linspace(-1, 1, intrinsics.width), np.linspace(-1, 1, intrinsics.height)[:, None]
    light = rng.uniform(0.7, 1.0) * (1 + slope[0] * x + slope[1] * y)
    rgb = (gray * light)[..., None] * (1.0, 0.98, 0.94) + rng.normal(0, _NOISE, (*gray.shape, 3))
    return np.clip(np.round(rgb), 0, 255).astype(np.uint8)


def _table(layout: MarkerLayout, rng: np.random.Generator) -> tuple[Image, Array]:
    """Draw a speckled table with the markers on white paper; return it and its upper left corner in metres."""
    low, high = np.array(layout.box[0]) - _MARGIN, np.array(layout.box[1]) + _MARGIN
    width, height = np.ceil((high - low) * _RASTER).astype(int)
    coarse = rng.normal(165, 12, (height // 40, width // 40))
    table = np.clip(cv2.resize(coarse, (int(width), int(height)), interpolation=cv2.INTER_CUBIC), 0, 255).astype(
        np.uint8
    )
    for each, corners in zip(layout.ids, layout.array, strict=True):
        places = (corners - low) * _RASTER - 0.5
        side = 600
        marker = cv2.aruco.generateImageMarker(dictionary_named(layout.dictionary), each, side)
        sheet = np.pad(marker, side // 5, constant_values=235)
        sheet[sheet < 50] = 25
        sheet[sheet > 235] = 235
        edge = side // 5 - 0.5
        square = np.array([[edge, edge], [edge + side, edge], [edge + side, edge + side], [edge, edge + side]])
        lay = cv2.getPerspectiveTransform(square.astype(np.float32), places.astype(np.float32))
        cover = cv2.warpPerspective(np.full_like(sheet, 255), lay, (int(width), int(height)))
        drawn = cv2.warpPerspective(sheet, lay, (int(width), int(height)), flags=cv2.INTER_AREA)
        table = np.where(cover > 127, drawn, table)
    return table, low


@dataclass(frozen=True)
class Block:
    """A thin lid on a foot that is smaller on all sides, on the table at z = 0.

    From above, the upper half of its height shows only the lid, so that each edge of the lid is a jump in depth at the
    same position for every camera.

    Args:
        centre: (x, y) of its footprint in metres, base frame.
        size: The lid's edges along its x and y, and its height, in metres.
        yaw: Rotation about the vertical in radians.
    """

    centre: tuple[float, float]
    size: tuple[float, float, float]
    yaw: float = 0.0

    @property
    def top_centre(self) -> Array:
        """The middle of the lid, ``(3,)`` metres, base frame."""
        return np.array([*self.centre, self.size[2]])

    def top_outline(self, n: int = 20) -> Array:
        """Return n points on each edge of the lid, (4 n, 3) metres, base frame; lenses bend edges."""
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2 * self.size[:2] @ self.rotation.T + self.centre
        share = np.arange(n)[:, None] / n
        edges = [a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
        return np.column_stack([np.concatenate(edges), np.full(4 * n, self.size[2])])

    @property
    def rotation(self) -> Array:
        """Rotation from block to base, ``(2, 2)``."""
        return rotation(self.yaw)


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
    intrinsics = camera.intrinsics
    height, width = intrinsics.size
    rays = intrinsics.rays(np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1))
    eye = camera.to_base(np.zeros(3))
    along = camera.to_base(rays) - eye  # rays have z = 1, so that their parameter is the depth
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
    """Return the rows and columns in which a block may be visible."""
    lid = block.top_outline()
    pixels = camera.project_from_base(np.concatenate([lid, lid * (1, 1, 0)]))
    (left, top), (right, bottom) = np.floor(pixels.min(axis=0)) - 1, np.ceil(pixels.max(axis=0)) + 2
    return slice(max(int(top), 0), max(int(bottom), 0)), slice(max(int(left), 0), max(int(right), 0))


def _hit(block: Block, size: tuple[float, float, float], base: float, eye: Array, along: Array) -> Array:
    """Return where rays enter a box at the block's position, ``(...,)`` in ray lengths; inf where they miss."""
    half = np.array(size) / 2
    start, step = eye.copy(), along.copy()
    start[:2] = (eye[:2] - block.centre) @ block.rotation
    start[2] -= base + half[2]
    step[..., :2] = along[..., :2] @ block.rotation
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (-half - start) / step, (half - start) / step
    enter, leave = np.minimum(one, other).max(axis=-1), np.maximum(one, other).min(axis=-1)
    return np.where((enter < leave) & (enter > 0), enter, np.inf)
