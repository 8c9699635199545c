"""Draw scenes of several ropes that cross each other and themselves: shaded cylinders on a table, and their mask."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import SIZE, resample
from shape_obs.geometry.polyline import arc_length
from tests.benchmarks.scenes.layouts import Meeting, Table, lay_ropes
from tests.benchmarks.scenes.ropes import Curve, normals

Array = npt.NDArray[np.float64]
Field = npt.NDArray[np.float32]
Image = npt.NDArray[np.uint8]
FINER: Final = 2  # supersampling in each direction
_WIDTHS: Final = 8  # tried thicknesses until the generator gives up
_STEP: Final = 0.33  # pixels between the drawn points of a rope's surface
_RAMP: Final = 5.0  # length over which a rope comes down from a crossing to the table, in widths
_AMBIENT, _DIFFUSE, _SHINE = 0.35, 0.65, 0.25
_NOISE: Final = 3.0  # gray levels


class Crossing(NamedTuple):
    """Two strands, of two ropes or of one, that lie over each other."""

    first: int  # index of a rope
    first_at: float  # arc position along it, in pixels
    second: int  # index of the other rope, or of the same
    second_at: float  # arc position along it, in pixels
    place: Curve  # (2,) pixels
    first_above: bool  # whether the first strand is on top
    angle: float  # the acute angle between the strands, in radians


@dataclass(frozen=True)
class RopeScene:
    """Drawn ropes with their truth, in no particular order."""

    # the axis of each rope from tip to tip, (P, 2) pixels, at steps of about a pixel. Where a rope leaves the image
    # the axis goes on for a few widths
    curves: tuple[Curve, ...]
    widths: tuple[float, ...]  # thickness of each rope in pixels
    mask: Image  # (H, W) uint8, 0 or 255
    rgb: Image  # (H, W, 3) uint8
    crossings: tuple[Crossing, ...]  # those inside the image
    # height of the visible surface over the table, (H, W) float32, in pixels like the widths; a rope that lies on the
    # table is as high as it is wide
    height: Field


def several_ropes(
    rng: np.random.Generator,
    count: int,
    crossings: int,
    size: tuple[int, int] = SIZE,
    width: float | None = None,
    *,
    leaving: float = 0.25,
    smallest_angle: float = np.pi / 12,
    soft: float | None = None,
    ragged: float | None = None,
    specks: int | None = None,
    holes: int | None = None,
) -> RopeScene:
    """Draw ``count`` ropes of one colour, 250 to 900 px, that cross each other and themselves ``crossings`` times.

    Crossings are at least two widths apart, and elsewhere strands and tips keep their distance. What is above is drawn
    for each crossing separately.

    Args:
        rng: Draws everything.
        count: Number of ropes.
        crossings: Number of crossings inside the image.
        size: ``(H, W)`` of the image.
        width: Thickness in pixels, with small variations; None for 4 to 14.
        leaving: Probability that a rope leaves the image at one end or both.
        smallest_angle: The smallest angle of crossings, in radians.
        soft: Blur of the mask before its threshold, in pixels; None for a mixture.
        ragged: Size of the irregularities of the mask's border, in pixels; None for a mixture.
        specks: Number of wrong pixels and blobs on the table; None for a mixture.
        holes: Number of small holes in the mask of the ropes; None for a mixture.
    """
    for _ in range(_WIDTHS):
        thick = float(rng.uniform(4, 14)) if width is None else width
        laid = lay_ropes(rng, count, crossings, Table(size, thick, leaving, smallest_angle))
        if laid is not None:
            break
    else:
        raise RuntimeError(f"no {count} ropes with {crossings} crossings found that fit {size[1]} x {size[0]} pixels.")
    curves, found = laid
    widths = tuple(thick * float(np.clip(rng.normal(1, 0.02), 0.95, 1.05)) for _ in curves)
    above = rng.integers(2, size=len(found)).astype(bool).tolist()
    light = unit(np.array([*rng.uniform(-0.6, 0.6, 2), 1.0]))
    surface = relief(curves, widths, lifts(curves, found, above, thick), size, light)
    colour, ground = _colours(rng)
    dirty = rng.random(4) < 0.6
    mask = _segmented(
        surface,
        rng,
        soft=soft if soft is not None else rng.uniform(0.4, 1.2) * dirty[0],
        ragged=ragged if ragged is not None else rng.uniform(0.15, 0.6) * dirty[1],
        specks=specks if specks is not None else int(rng.integers(1, 25) * dirty[2]),
        holes=holes if holes is not None else int(rng.integers(1, 8) * dirty[3]),
        width=thick,
    )
    rgb = picture(surface, colour, ground, light, thick, rng)
    arcs = [arc_length(np.ascontiguousarray(curve)) for curve in curves]
    listed = (
        Crossing(m.i, _at(arcs[m.i], m.a), m.j, _at(arcs[m.j], m.b), m.place, up, m.angle)
        for m, up in zip(found, above, strict=True)
    )
    height = cv2.resize(surface.height, size[::-1], interpolation=cv2.INTER_AREA)
    return RopeScene(tuple(curves), widths, mask, rgb, tuple(listed), np.asarray(height, np.float32))


def noisy_depth(scene: RopeScene, rng: np.random.Generator, distance: float = 0.6, focal: float = 386.0) -> Field:
    """Return the depth image of a scene seen from straight above with the noise of a D455, ``(H, W)`` metres.

    Stereo matching smooths depth over a window, so a rope's sides slope down to the table over some pixels.

    Args:
        scene: The scene.
        rng: Draws the noise.
        distance: From the camera to the table, in metres.
        focal: Focal length in pixels; a rope is ``width * distance / focal`` thick.
    """
    depth = distance - cv2.GaussianBlur(scene.height, (0, 0), 1.0).astype(np.float64) * distance / focal
    return with_stereo_noise(depth, focal, rng).astype(np.float32)


def with_stereo_noise(depth: Array, focal: float, rng: np.random.Generator) -> Array:
    """Return a depth image, ``(H, W)`` metres, with a D455's error of the disparity, which neighbours share."""
    noise = cv2.GaussianBlur(rng.normal(size=depth.shape), (0, 0), 1.0)
    return depth + depth**2 * 0.08 / (focal * 0.095) * noise / noise.std()  # 0.08 px; the cameras are 95 mm apart


@dataclass(frozen=True)
class Relief:
    """The upper surface of what lies on a table, on a raster that is twice as fine as the image."""

    height: Field  # height of the surface over the table, (2H, 2W) float32 pixels of the image; 0 on the table
    shade: Field  # brightness of the surface under the light, (2H, 2W) float32, about 0 to 1
    owner: npt.NDArray[np.int8]  # index of the object on top, (2H, 2W) int8; -1 on the table

    @classmethod
    def empty(cls, size: tuple[int, int]) -> Relief:
        """Return the table alone, for an image of ``size`` ``(H, W)``."""
        rows, columns = size[0] * FINER, size[1] * FINER
        height, shade = np.zeros((2, rows, columns), np.float32)
        return cls(height, shade, np.full((rows, columns), -1, np.int8))


def lifts(curves: Sequence[Curve], found: Sequence[Meeting], above: Sequence[bool], width: float) -> list[Array]:
    """Return the height of each rope's lower side over the table at every point of its axis, ``(P,)`` in widths."""
    strands = [(m.i, m.a, up) for m, up in zip(found, above, strict=True)]
    strands += [(m.j, m.b, not up) for m, up in zip(found, above, strict=True)]
    return [lift(len(c), [(a, up) for i, a, up in strands if i == k], width) for k, c in enumerate(curves)]


def lift(length: int, crossings: Sequence[tuple[float, bool]], width: float) -> Array:
    """Return the height of a rope's lower side over the table at every index, ``(length,)`` in widths, 0 to 1.

    It lies on the table at its lower crossings and away from crossings, and on the other rope at its upper ones.

    Args:
        length: Number of points.
        crossings: Where the rope crosses, as an index, and whether it is on top.
        width: Thickness in pixels.
    """
    if not crossings:
        return np.zeros(length)
    places, levels = np.array(sorted(crossings), dtype=np.float64).T
    places = np.concatenate([[places[0] - _RAMP * width], places, [places[-1] + _RAMP * width]])
    levels = np.concatenate([[0.0], levels, [0.0]])
    at = np.arange(length)
    # Between crossings that are far apart the rope comes down; it is flat next to every crossing.
    k = np.clip(np.searchsorted(places, at) - 1, 0, len(places) - 2)
    share = np.clip((at - places[k]) / (places[k + 1] - places[k]), 0, 1)
    smooth = levels[k] + (levels[k + 1] - levels[k]) * (1 - np.cos(np.pi * share)) / 2
    away = np.minimum(at - places[k], places[k + 1] - at) / width
    return smooth * (np.clip(_RAMP - away, 0, 1) if len(places) > 3 else 1.0)


def relief(
    curves: Sequence[Curve], widths: Sequence[float], lifted: Sequence[Array], size: tuple[int, int], light: Array
) -> Relief:
    """Draw ropes with round tips as cylinders on a table; where ropes overlap the higher surface is seen.

    Args:
        curves: Axis of each rope from tip to tip, ``(P, 2)`` pixels.
        widths: Thickness of each in pixels.
        lifted: Height of each rope's lower side at its points, ``(P,)`` in widths.
        size: ``(H, W)``.
        light: Unit vector towards the light, ``(3,)``: right, down, up.
    """
    pieces = []
    for index, (curve, width, raised) in enumerate(zip(curves, widths, lifted, strict=True)):
        fine = resample(np.column_stack([curve, raised * width]), _STEP)
        axis, low, normal, radius = fine[:, :2], fine[:, 2], normals(fine[:, :2]), width / 2
        arc = np.arange(len(axis)) * _STEP
        # Round tips: the radius of the section shrinks towards the end.
        inside = np.clip(radius - np.minimum(arc, arc[-1] - arc), 0, radius)
        reach = np.sqrt(np.maximum(radius**2 - inside**2, 1e-6))
        across = np.linspace(-1, 1, int(np.ceil(width / _STEP)) + 1)
        places = axis[:, None] + (reach[:, None] * across)[..., None] * normal[:, None]
        up = np.sqrt(np.maximum(1 - across**2, 0))
        high = low[:, None] + radius + reach[:, None] * up
        lit = np.maximum((normal @ light[:2])[:, None] * across + light[2] * up, 0)
        shade = _AMBIENT + _DIFFUSE * lit + _SHINE * lit**24
        pieces.append(np.column_stack([places.reshape(-1, 2), high.ravel(), shade.ravel(), np.full(high.size, index)]))
    surface, drawn = Relief.empty(size), np.concatenate(pieces)
    at = np.floor((drawn[:, :2] + 0.5) * FINER).astype(np.int64)
    kept = np.flatnonzero(((at >= 0) & (at < surface.owner.shape[::-1])).all(axis=1))
    # The last value that is written to a pixel stays: the highest.
    order = kept[np.argsort(drawn[kept, 2], kind="stable")]
    where = at[order, 1], at[order, 0]
    surface.height[where], surface.shade[where], surface.owner[where] = drawn[order, 2:].T
    return surface


def picture(
    surface: Relief, colours: Array, table: Array, light: Array, width: float, rng: np.random.Generator
) -> Image:
    """Photograph ropes on a table: shadows, uneven light, blur and noise; ``(H, W, 3)`` uint8.

    Args:
        surface: The ropes.
        colours: RGB of each rope, ``(R, 3)``, or of all ropes, ``(3,)``; 0 to 255.
        table: RGB of the table, ``(3,)``.
        light: Unit vector towards the light, ``(3,)``.
        width: A rope's thickness in pixels.
        rng: Draws the table's texture, the light's fall and the noise.
    """
    rows, columns = surface.height.shape
    scene = _texture(rng, (rows, columns)) * table.astype(np.float32)
    on = surface.owner >= 0
    each = np.broadcast_to(colours, (int(surface.owner.max()) + 1, 3)).astype(np.float32)
    scene[on] = each[surface.owner[on]] * surface.shade[on, None]
    # Contact shadow next to what is higher, and the shadow that it casts away from the light.
    nearby = cv2.GaussianBlur(surface.height, (0, 0), 0.35 * width * FINER)
    dark = np.clip((nearby - surface.height) / width, 0, 1) * 1.1
    cast = shifted(surface.height, light, 0.5 * width) - surface.height - 0.5 * width
    cast = cv2.GaussianBlur(np.clip(cast / width, 0, 0.6).astype(np.float32), (0, 0), 0.2 * width * FINER)
    scene *= (1 - np.clip(dark + 0.7 * cast, 0, 0.75)).astype(np.float32)[..., None]
    small = cv2.resize(scene, (columns // FINER, rows // FINER), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), rng.uniform(0.4, 0.8))
    slope = rng.uniform(-0.12, 0.12, 2)
    height, wide = small.shape[:2]
    fall = 1 + slope[0] * np.linspace(-1, 1, wide) + slope[1] * np.linspace(-1, 1, height)[:, None]
    return np.clip(np.round(small * fall[..., None] + rng.normal(0, _NOISE, small.shape)), 0, 255).astype(np.uint8)


def shifted(height: Field, light: Array, by: float) -> Field:
    """Return a relief's heights moved away from the light by the shadow of something ``by`` pixels high."""
    u, v = -light[:2] / light[2] * by * FINER
    return np.asarray(cv2.warpAffine(height, np.array([[1.0, 0, u], [0, 1, v]]), height.shape[::-1]), np.float32)


def unit(vector: Array) -> Array:
    """Return a vector of the same direction and of length 1."""
    return vector / np.linalg.norm(vector)


def _segmented(
    surface: Relief, rng: np.random.Generator, *, soft: float, ragged: float, specks: int, holes: int, width: float
) -> Image:
    """Return the mask that a segmentation makes of ropes, ``(H, W)`` uint8, 0 or 255; see ``several_ropes``."""
    on = (surface.owner >= 0).astype(np.uint8)
    height, wide = on.shape[0] // FINER, on.shape[1] // FINER
    share = cv2.resize(on.astype(np.float32), (wide, height), interpolation=cv2.INTER_AREA)
    if soft > 0:
        share = cv2.GaussianBlur(share, (0, 0), soft)
    if ragged > 0:
        # A border that is ``soft`` wide moves by a pixel for so much of a change of the threshold.
        if soft < 0.7:
            share = cv2.GaussianBlur(share, (0, 0), 0.7)
        noise = cv2.GaussianBlur(rng.normal(0, 1, share.shape).astype(np.float32), (0, 0), 1.4)
        share = share + 0.4 * ragged / np.hypot(max(soft, 0.7), 0.3) * noise / noise.std()
        # No irregularity reaches the axis, or leaves the border far behind.
        core, away = (cv2.distanceTransform(part, cv2.DIST_L2, 5)[::FINER, ::FINER] for part in (on, 1 - on))
        share = np.where(core > FINER * max(0.3 * width, 1.0), 1.0, np.where(away > FINER * 2.5, 0.0, share))
    mask = np.where(share > 0.5, np.uint8(255), np.uint8(0))
    inner = np.argwhere(mask > 0)
    for row, column in inner[rng.integers(0, len(inner), holes)] if len(inner) else ():
        cv2.circle(mask, (int(column), int(row)), int(rng.integers(0, max(int(0.22 * width), 1) + 1)), 0, -1)
    for row, column in rng.integers(0, (height, wide), (specks, 2)):
        cv2.circle(mask, (int(column), int(row)), int(rng.integers(0, 3)), 255, -1)
    return mask


def _texture(rng: np.random.Generator, size: tuple[int, int]) -> Field:
    """Return the brightness of a table about 1, ``(H, W, 1)``: blotches, sometimes grain in one direction."""
    coarse = rng.normal(0, 1, (size[0] // 64 + 2, size[1] // 64 + 2)).astype(np.float32)
    field = 0.03 * cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC)
    if rng.integers(2):
        grain = rng.normal(0, 1, (size[0] // 4, size[1] // 160 + 2)).astype(np.float32)
        field = field + 0.035 * cv2.resize(grain, size[::-1], interpolation=cv2.INTER_LINEAR)
    return 1 + field[..., None].astype(np.float32)


def _at(arc: Array, index: float) -> float:
    """Return the arc position of a fractional index in pixels."""
    return float(np.interp(index, np.arange(len(arc)), arc))


def _colours(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return RGB of the ropes and of the table, ``(3,)``; the ropes stand out."""
    while True:
        ropes, gray = rng.uniform(30, 240, 3), rng.uniform(40, 225)
        table = np.clip(gray + rng.normal(0, 14, 3), 20, 240)
        if np.abs(ropes - table).max() > 90 and ropes.max() > 100:
            return ropes, table
