"""Draw scenes of several ropes that cross each other and themselves: shaded cylinders on a table, and their mask."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import cv2
import numpy as np

from shape_obs.bench.scenes import SIZE
from tests.benchmarks.scenes.height_field import FINER, Array, Field, HeightField, Image, grain, photographed, unit
from tests.scenes.layouts import Meeting, Table, place_ropes
from tests.scenes.ropes import Curve

_WIDTHS: Final = 8  # tried thicknesses until the generator gives up
_RAMP: Final = 5.0  # length over which a rope comes down from a crossing to the table, in widths


class Crossing(NamedTuple):
    """Two strands, of two ropes or of one, that lie over each other."""

    first: int  # index of a rope
    first_at: float  # arc position along it, in pixels
    second: int  # index of the other rope, or of the same
    second_at: float  # arc position along it, in pixels
    place: Curve  # (2,) pixels
    angle: float  # the acute angle between the strands, in radians
    first_above: bool  # whether the first strand is on top


@dataclass(frozen=True)
class RopeScene:
    """Drawn ropes with their truth, in no particular order."""

    # the axis of each rope from tip to tip, (P, 2) pixels, at steps of a pixel. Where a rope leaves the image the axis
    # goes on for a few widths
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
        leaving: Probability that an end of a rope leaves the image.
        soft: Blur of the mask before its threshold, in pixels; None for a mixture.
        ragged: Size of the irregularities of the mask's border, in pixels; None for a mixture.
        specks: Number of wrong pixels and blobs on the table; None for a mixture.
        holes: Number of small holes in the mask of the ropes; None for a mixture.
    """
    for _ in range(_WIDTHS):
        thick = float(rng.uniform(4, 14)) if width is None else width
        placed = place_ropes(rng, count, crossings, Table(size, thick, leaving))
        if placed is not None:
            break
    else:
        raise RuntimeError(f"no {count} ropes with {crossings} crossings found that fit {size[1]} x {size[0]} pixels.")
    curves, found = placed
    widths = tuple(thick * float(np.clip(rng.normal(1, 0.02), 0.95, 1.05)) for _ in curves)
    above = rng.integers(2, size=len(found)).astype(bool).tolist()
    light = unit(np.array([*rng.uniform(-0.6, 0.6, 2), 1.0]))
    surface = HeightField.of_ropes(curves, widths, lifts(curves, found, above, thick), size, light)
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
    listed = tuple(Crossing(*meeting, up) for meeting, up in zip(found, above, strict=True))
    colour = rng.uniform(30, 240, 3)
    rgb = on_a_table(rng, surface, light, colour * max(1.0, 120 / colour.max()))
    height = cv2.resize(surface.height, size[::-1], interpolation=cv2.INTER_AREA)
    return RopeScene(tuple(curves), widths, mask, rgb, listed, np.asarray(height, np.float32))


def on_a_table(rng: np.random.Generator, surface: HeightField, light: Array, colour: Array) -> Image:
    """Photograph ropes of one colour, which stands out from that of a blotchy table, ``(H, W, 3)`` uint8."""
    table = colour
    while np.abs(colour - table).max() < 90:
        table = np.clip(rng.uniform(40, 225) + rng.normal(0, 14, 3), 20, 240)
    scene = table * (1 + 0.03 * grain(rng, surface.owner.shape, (64, 64)))
    scene[surface.owner >= 0] = colour
    return photographed(rng, surface, scene, light, rough=False)


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


def lifts(curves: Sequence[Curve], found: Sequence[Meeting], above: Sequence[bool], width: float) -> list[Array]:
    """Return the height of each rope's lower side over the table at every point of its axis, ``(P,)`` in widths."""
    strands = [(m.i, m.a, up) for m, up in zip(found, above, strict=True)]
    strands += [(m.j, m.b, not up) for m, up in zip(found, above, strict=True)]
    return [_lift(len(c), [(a, up) for i, a, up in strands if i == k], width) for k, c in enumerate(curves)]


def _lift(length: int, crossings: Sequence[tuple[float, bool]], width: float) -> Array:
    """Return the height of a rope's lower side over the table at every index, ``(length,)`` in widths, 0 to 1.

    It lies on the table at its lower crossings and away from crossings, and on the other rope at its upper ones.
    ``crossings`` are where the rope crosses, as an index, and whether it is on top.
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


def _segmented(
    surface: HeightField, rng: np.random.Generator, *, soft: float, ragged: float, specks: int, holes: int, width: float
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
