"""Draw ropes that lie over each other as shaded cylinders on a table, and their mask as a segmentation finds it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from tests.benchmarks.scenes.ropes import Curve, resample

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]
_FINER: Final = 2  # supersampling in each direction
_STEP: Final = 0.33  # pixels between the drawn points of a rope's surface
_RAMP: Final = 5.0  # length over which a rope comes down from a crossing to the table, in widths
_AMBIENT: Final = 0.35
_DIFFUSE: Final = 0.65
_SHINE: Final = 0.25
_NOISE: Final = 3.0  # gray levels


@dataclass(frozen=True)
class Relief:
    """The upper surface of ropes on a table, on a raster that is twice as fine as the image.

    Args:
        height: Height of the surface over the table, ``(2H, 2W)`` float32 pixels of the image; 0 on the table.
        shade: Brightness of the surface under the light, ``(2H, 2W)`` float32, about 0 to 1.
        owner: Index of the rope on top, ``(2H, 2W)`` int8; -1 on the table.
    """

    height: npt.NDArray[np.float32]
    shade: npt.NDArray[np.float32]
    owner: npt.NDArray[np.int8]


def lift(length: int, at: Sequence[float], above: Sequence[bool], width: float) -> Array:
    """Return the height of a rope's lower side over the table at every index, ``(length,)`` in widths, 0 to 1.

    It lies on the table at its lower crossings and away from crossings, and on the other rope at its upper ones.
    """
    order = np.argsort(at)
    places, levels = np.asarray(at, dtype=np.float64)[order], np.asarray(above, dtype=np.float64)[order]
    if len(places) == 0:
        return np.zeros(length)
    places = np.concatenate([[places[0] - _RAMP * width], places, [places[-1] + _RAMP * width]])
    levels = np.concatenate([[0.0], levels, [0.0]])
    at_index = np.arange(length)
    # Between crossings that are far apart the rope comes down; flat next to every crossing.
    k = np.clip(np.searchsorted(places, at_index) - 1, 0, len(places) - 2)
    share = np.clip((at_index - places[k]) / (places[k + 1] - places[k]), 0, 1)
    smooth = levels[k] + (levels[k + 1] - levels[k]) * (1 - np.cos(np.pi * share)) / 2
    away = np.minimum(at_index - places[k], places[k + 1] - at_index) / width
    return smooth * (np.clip(_RAMP - away, 0, 1) if len(places) > 3 else 1.0)


def relief(
    curves: Sequence[Curve], widths: Sequence[float], lifts: Sequence[Array], size: tuple[int, int], light: Array
) -> Relief:
    """Draw ropes with round tips as cylinders on a table; where ropes overlap the higher surface is seen.

    Args:
        curves: Axis of each rope from tip to tip, ``(P, 2)`` pixels.
        widths: Thickness of each in pixels.
        lifts: Height of each rope's lower side at its points, ``(P,)`` in widths.
        size: ``(H, W)``.
        light: Unit vector towards the light, ``(3,)``: right, down, up.
    """
    places, heights, shades, owners = [], [], [], []
    for index, (curve, width, raised) in enumerate(zip(curves, widths, lifts, strict=True)):
        fine = resample(np.column_stack([curve, raised * width]), _STEP)
        axis, low = fine[:, :2], fine[:, 2]
        along = np.gradient(axis, axis=0)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
        radius = width / 2
        arc = np.arange(len(axis)) * _STEP
        # Round tips: the radius of the section shrinks towards the end.
        inside = np.clip(radius - np.minimum(arc, arc[-1] - arc), 0, radius)
        reach = np.sqrt(np.maximum(radius**2 - inside**2, 1e-6))
        across = np.linspace(-1, 1, int(np.ceil(width / _STEP)) + 1)
        offset = reach[:, None] * across
        places.append((axis[:, None] + offset[..., None] * normal[:, None]).reshape(-1, 2))
        up = np.sqrt(np.maximum(1 - across**2, 0))
        heights.append((low[:, None] + radius + reach[:, None] * up).ravel())
        slope = normal @ light[:2]
        lit = np.maximum(slope[:, None] * across + light[2] * up, 0)
        shades.append((_AMBIENT + _DIFFUSE * lit + _SHINE * lit**24).ravel())
        owners.append(np.full(heights[-1].shape, index, np.int8))
    height, width = size[0] * _FINER, size[1] * _FINER
    at = np.floor((np.concatenate(places) + 0.5) * _FINER).astype(np.int64)
    inside = np.flatnonzero(((at >= 0) & (at < (width, height))).all(axis=1))
    high = np.concatenate(heights)[inside]
    order = inside[np.argsort(high, kind="stable")]
    where = at[order, 1], at[order, 0]
    surface = Relief(
        np.zeros((height, width), np.float32),
        np.zeros((height, width), np.float32),
        np.full((height, width), -1, np.int8),
    )
    # The last value that is written to a pixel stays: the highest.
    surface.height[where] = np.concatenate(heights)[order]
    surface.shade[where] = np.concatenate(shades)[order]
    surface.owner[where] = np.concatenate(owners)[order]
    return surface


def picture(
    surface: Relief, colours: Array, table: Array, light: Array, width: float, rng: np.random.Generator
) -> Image:
    """Photograph ropes on a table: shadows, uneven light, blur and noise; ``(H, W, 3)`` uint8.

    Args:
        surface: The ropes.
        colours: RGB of each rope, ``(R, 3)``, 0 to 255.
        table: RGB of the table, ``(3,)``.
        light: Unit vector towards the light, ``(3,)``.
        width: A rope's thickness in pixels.
        rng: Draws the table's texture, the light's fall and the noise.
    """
    rows, columns = surface.height.shape
    scene = _texture(rng, (rows, columns)) * table.astype(np.float32)
    on = surface.owner >= 0
    scene[on] = colours.astype(np.float32)[surface.owner[on]] * surface.shade[on, None]
    # Contact shadow next to what is higher, and the shadow that it casts away from the light.
    nearby = cv2.GaussianBlur(surface.height, (0, 0), 0.35 * width * _FINER)
    dark = np.clip((nearby - surface.height) / width, 0, 1) * 1.1
    shift = -light[:2] / light[2] * width * 0.5 * _FINER
    matrix = np.array([[1, 0, shift[0]], [0, 1, shift[1]]], dtype=np.float64)
    cast = cv2.warpAffine(surface.height, matrix, (columns, rows)) - surface.height - 0.5 * width
    cast = cv2.GaussianBlur(np.clip(cast / width, 0, 0.6).astype(np.float32), (0, 0), 0.2 * width * _FINER)
    scene *= (1 - np.clip(dark + 0.7 * cast, 0, 0.75)).astype(np.float32)[..., None]
    small = cv2.resize(scene, (columns // _FINER, rows // _FINER), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), rng.uniform(0.4, 0.8))
    slope = rng.uniform(-0.12, 0.12, 2)
    height, wide = small.shape[:2]
    fall = 1 + slope[0] * np.linspace(-1, 1, wide) + slope[1] * np.linspace(-1, 1, height)[:, None]
    noise = rng.normal(0, _NOISE, small.shape)
    return np.clip(np.round(small * fall[..., None] + noise), 0, 255).astype(np.uint8)


def segmented(
    surface: Relief, rng: np.random.Generator, *, soft: float, ragged: float, specks: int, holes: int, width: float
) -> Image:
    """Return the mask that a segmentation makes of ropes, ``(H, W)`` uint8, 0 or 255.

    Args:
        surface: The ropes.
        rng: Draws the faults.
        soft: Blur before the threshold in pixels, which rounds tips and fills narrow wedges.
        ragged: Size of the irregularities of the border in pixels.
        specks: Number of wrong pixels and small blobs on the table.
        holes: Number of small holes in the ropes.
        width: A rope's thickness in pixels.
    """
    rows, columns = surface.owner.shape
    height, wide = rows // _FINER, columns // _FINER
    share = cv2.resize((surface.owner >= 0).astype(np.float32), (wide, height), interpolation=cv2.INTER_AREA)
    if soft > 0:
        share = cv2.GaussianBlur(share, (0, 0), soft)
    if ragged > 0:
        # A border that is ``soft`` wide moves by a pixel for so much of a change of the threshold.
        if soft < 0.7:
            share = cv2.GaussianBlur(share, (0, 0), 0.7)
        noise = cv2.GaussianBlur(rng.normal(0, 1, share.shape).astype(np.float32), (0, 0), 1.4)
        share = share + 0.4 * ragged / np.hypot(max(soft, 0.7), 0.3) * noise / noise.std()
        # No irregularity reaches the axis, or leaves the border far behind.
        core = cv2.distanceTransform((surface.owner >= 0).astype(np.uint8), cv2.DIST_L2, 5)[::_FINER, ::_FINER]
        away = cv2.distanceTransform((surface.owner < 0).astype(np.uint8), cv2.DIST_L2, 5)[::_FINER, ::_FINER]
        share = np.where(core > _FINER * max(0.3 * width, 1.0), 1.0, np.where(away > _FINER * 2.5, 0.0, share))
    mask = np.where(share > 0.5, np.uint8(255), np.uint8(0))
    inner = np.argwhere(mask > 0)
    for row, column in inner[rng.integers(0, len(inner), holes)] if len(inner) else ():
        cv2.circle(mask, (int(column), int(row)), int(rng.integers(0, max(int(0.22 * width), 1) + 1)), 0, -1)
    for row, column in rng.integers(0, (height, wide), (specks, 2)):
        cv2.circle(mask, (int(column), int(row)), int(rng.integers(0, 3)), 255, -1)
    return mask


def _texture(rng: np.random.Generator, size: tuple[int, int]) -> npt.NDArray[np.float32]:
    """Return the brightness of a table about 1, ``(H, W, 1)``: blotches, sometimes grain in one direction."""
    coarse = rng.normal(0, 1, (size[0] // 64 + 2, size[1] // 64 + 2)).astype(np.float32)
    field = 0.03 * cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC)
    if rng.integers(2):
        grain = rng.normal(0, 1, (size[0] // 4, size[1] // 160 + 2)).astype(np.float32)
        field = field + 0.035 * cv2.resize(grain, size[::-1], interpolation=cv2.INTER_LINEAR)
    return 1 + field[..., None].astype(np.float32)
