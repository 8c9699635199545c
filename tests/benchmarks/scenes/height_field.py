"""Draw what lies on a table as a height field, and photograph it: shade, shadows, falling light, blur and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import resample
from tests.scenes.hidden_ropes import draw_balls
from tests.scenes.ropes import Curve

Array = npt.NDArray[np.float64]
Field = npt.NDArray[np.float32]
Image = npt.NDArray[np.uint8]
Size = tuple[int, int]
FINER: Final = 2  # supersampling in each direction
SQUARE: Final = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
_FAR: Final = 1e4  # pixels from the camera to the table, so that nothing grows with its height
_PIECE: Final = 0.1  # widths from one ball of a rope to the next
_AMBIENT, _DIFFUSE, _SHINE = 0.35, 0.65, 0.25
_GAMMA: Final = 2.2


@dataclass(frozen=True)
class HeightField:
    """The upper surface of what lies on a table, on a raster that is twice as fine as the image."""

    height: Field  # height of the surface over the table, (2H, 2W) float32 pixels of the image; 0 on the table
    shade: Field  # brightness of the surface under the light, (2H, 2W) float32, about 0 to 1
    owner: npt.NDArray[np.int8]  # index of the object on top, (2H, 2W) int8; -1 on the table

    @classmethod
    def empty(cls, size: Size) -> HeightField:
        """Return the table alone, for an image of ``size`` ``(H, W)``."""
        rows, columns = size[0] * FINER, size[1] * FINER
        height, shade = np.zeros((2, rows, columns), np.float32)
        return cls(height, shade, np.full((rows, columns), -1, np.int8))

    @classmethod
    def of_ropes(
        cls, curves: Sequence[Curve], widths: Sequence[float], lifted: Sequence[Array], size: Size, light: Array
    ) -> HeightField:
        """Draw ropes with round tips as cylinders on a table; where ropes overlap the higher surface is seen.

        Args:
            curves: Axis of each rope from tip to tip, ``(P, 2)`` pixels at steps of a pixel.
            widths: Thickness of each in pixels.
            lifted: Height of each rope's lower side at its points, ``(P,)`` in widths.
            size: ``(H, W)``.
            light: Unit vector towards the light, ``(3,)``: right, down, up.
        """
        surface = cls.empty(size)
        for index, (curve, width, raised) in enumerate(zip(curves, widths, lifted, strict=True)):
            inset, axis = round(width / 2), np.column_stack([curve, (raised + 0.5) * width])
            balls = resample(axis[inset : len(axis) - inset], _PIECE * width)
            canvas = np.full(surface.height.shape, np.inf, np.float32)
            places = np.ascontiguousarray((balls[:, :2] + 0.5) * FINER - 0.5)
            draw_balls(canvas, places, _FAR - FINER * balls[:, 2], np.full(len(balls), FINER * width / 2), _FAR)
            top = (_FAR - canvas) / FINER
            on = top > surface.height
            surface.height[on], surface.owner[on] = top[on], index
        down, right = np.gradient(surface.height * FINER)
        lit = np.maximum((light[2] - light[0] * right - light[1] * down) / np.sqrt(1 + right**2 + down**2), 0)
        np.multiply(
            _AMBIENT + _DIFFUSE * lit + _SHINE * lit**24, surface.owner >= 0, out=surface.shade, casting="unsafe"
        )
        return surface


def unit(vector: Array) -> Array:
    """Return a vector of the same direction and of length 1."""
    return vector / np.linalg.norm(vector)


def axes(angle: float) -> Array:
    """Return the unit vectors along an angle and across it, ``(2, 2)``."""
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def photographed(
    rng: np.random.Generator, surface: HeightField, scene: Array | Field, light: Array, *, rough: bool
) -> Image:
    """Return the picture of a scene, ``(H, W, 3)`` uint8.

    Args:
        rng: Draws the light's fall, blur and noise.
        surface: What lies on the table.
        scene: The colours without light, ``(2H, 2W, 3)``, 0 to 255.
        light: Unit vector towards the light, ``(3,)``.
        rough: Whether to draw the faults of a hand-held camera: shine, a tint, much noise, and a JPEG file.
    """
    (rows, columns), on, gamma = surface.owner.shape, surface.owner >= 0, _GAMMA if rough else 1.0
    linear = (np.clip(scene, 0, 255) / 255) ** gamma * np.where(on, surface.shade, np.float32(1))[..., None]
    if rough and rng.random() < 0.6:  # something shiny: the light itself is seen in it
        linear += rng.uniform(0.1, 0.6) * (np.clip((surface.shade - 0.9) / 0.3, 0, 1) ** 2 * on)[..., None]
    linear *= (1 - _shadows(rng, surface, light, rough))[..., None]
    away, fall = rng.uniform(-0.2, 1.2, 2), rng.uniform(0, 1.5 if rough else 0.4)
    u, v = np.meshgrid(np.linspace(0, 1, columns) - away[0], np.linspace(0, 1, rows) - away[1])
    linear *= (1 / (1 + fall * (u**2 + v**2)))[..., None] * (1 + rng.normal(0, 0.06 * rough, 3))
    small = cv2.resize(linear, (columns // FINER, rows // FINER), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), rng.uniform(0.4, 1.0 if rough else 0.8))
    picture = 255 * np.clip(small * (rng.uniform(0.75, 1.2) if rough else 1), 0, 1) ** (1 / gamma)
    picture += rng.normal(0, rng.uniform(1, 5) if rough else 3.0, picture.shape)
    rgb = np.clip(np.round(picture), 0, 255).astype(np.uint8)
    if not rough:
        return rgb
    packed = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(60, 97))])[1]
    return np.ascontiguousarray(np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR), np.uint8)[..., ::-1])


def _shadows(rng: np.random.Generator, surface: HeightField, light: Array, rough: bool) -> Field:
    """Return how much of the light is missing at each place, 0 to 1.

    There is less next to objects, in their shadows, and in the shadow of something outside the picture.
    """
    rows, columns = surface.owner.shape
    top = max(float(np.quantile(surface.height[surface.owner >= 0], 0.95)), 1.0)
    nearby = cv2.GaussianBlur(surface.height, (0, 0), 0.5 * top)
    dark = 0.8 * np.clip((nearby - surface.height) / top, 0, 1)
    moved = np.array([[1.0, 0, -light[0] / light[2] * top * FINER], [0, 1, -light[1] / light[2] * top * FINER]])
    cast = np.clip((cv2.warpAffine(surface.height, moved, (columns, rows)) - surface.height) / top, 0, 1)
    dark = np.maximum(dark, rng.uniform(0.2, 0.7) * cv2.GaussianBlur(cast, (0, 0), 0.2 * top + 0.5))
    if rough and rng.random() < 0.4:
        angle, through = rng.uniform(0, 2 * np.pi), rng.uniform((0.2, 0.2), (0.8, 0.8)) * (columns, rows)
        u, v = np.meshgrid(np.arange(columns) - through[0], np.arange(rows) - through[1])
        side = (u * np.cos(angle) + v * np.sin(angle)) / rng.uniform(4, 80)
        dark = 1 - (1 - dark) * (1 - rng.uniform(0.3, 0.65) / (1 + np.exp(-np.clip(side, -30, 30))))
    return np.asarray(np.clip(dark, 0, 0.9), np.float32)


def grain(rng: np.random.Generator, size: Size, pixels: tuple[int, int]) -> Field:
    """Return smooth noise of unit deviation, ``(H, W, 1)``, with grains of (width, height) pixels."""
    coarse = rng.normal(0, 1, (size[0] // pixels[1] + 3, size[1] // pixels[0] + 3)).astype(np.float32)
    field = cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(field / max(float(field.std()), 1e-6), np.float32)[..., None]
