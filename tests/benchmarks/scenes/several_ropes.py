"""Draw scenes of several ropes of one colour that cross each other and themselves, touch, and leave the image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from tests.benchmarks.scenes.rope_layouts import Table, lay_ropes
from tests.benchmarks.scenes.rope_pictures import lift, picture, relief, segmented
from tests.benchmarks.scenes.ropes import SIZE, Curve

_WIDTHS: Final = 8  # tried thicknesses until the generator gives up
# Of a D455: error of the disparity and blur of the matching window in pixels, distance of its cameras in metres.
_DISPARITY: Final = 0.08
_WINDOW: Final = 1.0
_BASELINE: Final = 0.095


class Crossing(NamedTuple):
    """Two strands, of two ropes or of one, that lie over each other.

    Args:
        first: Index of a rope.
        first_at: Arc position along it, in pixels.
        second: Index of the other rope, or of the same.
        second_at: Arc position along it, in pixels.
        place: ``(2,)`` pixels.
        first_above: Whether the first strand is on top.
        angle: The acute angle between the strands, in radians.
    """

    first: int
    first_at: float
    second: int
    second_at: float
    place: Curve
    first_above: bool
    angle: float


@dataclass(frozen=True)
class RopeScene:
    """Drawn ropes with their truth, in no particular order.

    Args:
        curves: The axis of each rope from tip to tip, ``(P, 2)`` pixels, at steps of about a pixel. Where a rope leaves
            the image the axis goes on for a few widths.
        widths: Thickness of each rope in pixels.
        mask: ``(H, W)`` uint8, 0 or 255.
        rgb: ``(H, W, 3)`` uint8.
        crossings: Those inside the image.
        height: Height of the visible surface over the table, ``(H, W)`` float32, in pixels like the widths; a rope that
            lies on the table is as high as it is wide.
    """

    curves: tuple[Curve, ...]
    widths: tuple[float, ...]
    mask: npt.NDArray[np.uint8]
    rgb: npt.NDArray[np.uint8]
    crossings: tuple[Crossing, ...]
    height: npt.NDArray[np.float32]


def several_ropes(
    rng: np.random.Generator,
    count: int,
    crossings: int,
    size: tuple[int, int] = SIZE,
    width: float | None = None,
    *,
    leaving: float = 0.25,
    touching: bool = False,
    smallest_angle: float = np.deg2rad(15),
    narrowest: float = 2.0,
    soft: float | None = None,
    ragged: float | None = None,
    specks: int | None = None,
    holes: int | None = None,
    same_colour: bool = True,
) -> RopeScene:
    """Draw ``count`` ropes of 250 to 900 px that cross each other and themselves ``crossings`` times in all.

    Crossings are at least two widths apart, and elsewhere strands and tips keep their distance. What is above is drawn
    for each crossing separately.

    Args:
        rng: Draws everything.
        count: Number of ropes.
        crossings: Number of crossings inside the image.
        size: ``(H, W)`` of the image.
        width: Thickness in pixels, with small variations; None for 4 to 14.
        leaving: Probability that a rope leaves the image at one end or both.
        touching: Whether one rope runs next to another in contact with it, or one tip lies against another rope.
        smallest_angle: The smallest angle of crossings, in radians.
        narrowest: The smallest inner radius of loops in widths.
        soft: Blur of the mask before its threshold, in pixels; None for a mixture.
        ragged: Size of the irregularities of the mask's border, in pixels; None for a mixture.
        specks: Number of wrong pixels and blobs on the table; None for a mixture.
        holes: Number of small holes in the mask of the ropes; None for a mixture.
        same_colour: Whether all ropes have one colour.
    """
    for _ in range(_WIDTHS):
        thick = float(rng.uniform(4, 14)) if width is None else width
        laid = lay_ropes(rng, count, crossings, Table(size, thick, leaving, touching, smallest_angle, narrowest))
        if laid is not None:
            break
    else:
        raise RuntimeError(f"no {count} ropes with {crossings} crossings found that fit {size[1]} x {size[0]} pixels.")
    curves, found, touch = laid
    widths = tuple(thick * float(np.clip(rng.normal(1, 0.02), 0.95, 1.05)) for _ in curves)
    above = rng.integers(2, size=len(found)).astype(bool).tolist()
    lifts = []
    for index, curve in enumerate(curves):
        at = [(m.a, up) for m, up in zip(found, above, strict=True) if m.i == index]
        at += [(m.b, not up) for m, up in zip(found, above, strict=True) if m.j == index]
        if touch is not None and touch.i == index:
            at.append((touch.a, False))
        lifts.append(lift(len(curve), [a for a, _ in at], [up for _, up in at], thick))
    light = np.array([*rng.uniform(-0.6, 0.6, 2), 1.0])
    light /= np.linalg.norm(light)
    surface = relief(curves, widths, lifts, size, light)
    colours, ground = _colours(rng, count, same=same_colour)
    dirty = rng.random(4) < 0.6
    return RopeScene(
        tuple(curves),
        widths,
        segmented(
            surface,
            rng,
            soft=soft if soft is not None else rng.uniform(0.4, 1.2) * dirty[0],
            ragged=ragged if ragged is not None else rng.uniform(0.15, 0.6) * dirty[1],
            specks=specks if specks is not None else int(rng.integers(1, 25) * dirty[2]),
            holes=holes if holes is not None else int(rng.integers(1, 8) * dirty[3]),
            width=thick,
        ),
        picture(surface, colours, ground, light, thick, rng),
        tuple(
            Crossing(m.i, _arc(curves[m.i], m.a), m.j, _arc(curves[m.j], m.b), m.place, up, m.angle)
            for m, up in zip(found, above, strict=True)
        ),
        np.asarray(cv2.resize(surface.height, size[::-1], interpolation=cv2.INTER_AREA), np.float32),
    )


def noisy_depth(
    scene: RopeScene, rng: np.random.Generator, distance: float = 0.6, focal: float = 386.0
) -> npt.NDArray[np.float32]:
    """Return the depth image of a scene seen from straight above with the noise of a D455, ``(H, W)`` metres.

    The noise is an error of the disparity that neighbouring pixels share. Stereo matching smooths depth over a window,
    so a rope's sides slope down to the table over some pixels.

    Args:
        scene: The scene.
        rng: Draws the noise.
        distance: From the camera to the table, in metres.
        focal: Focal length in pixels; a rope is ``width * distance / focal`` thick.
    """
    depth = distance - cv2.GaussianBlur(scene.height, (0, 0), _WINDOW).astype(np.float64) * distance / focal
    noise = cv2.GaussianBlur(rng.normal(size=depth.shape), (0, 0), 1.0)
    sigma = depth**2 * _DISPARITY / (focal * _BASELINE)
    return (depth + sigma * noise / noise.std()).astype(np.float32)


def _arc(curve: Curve, index: float) -> float:
    """Return the arc position of a fractional index in pixels."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    return float(np.interp(index, np.arange(len(curve)), length))


def _colours(
    rng: np.random.Generator, count: int, *, same: bool
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return RGB of each rope, ``(count, 3)``, and of the table, ``(3,)``; the ropes stand out from the table."""
    while True:
        ropes = rng.uniform(30, 240, (1 if same else count, 3))
        gray = rng.uniform(40, 225)
        table = np.clip(gray + rng.normal(0, 14, 3), 20, 240)
        if np.abs(ropes - table).max(axis=1).min() > 90 and ropes.max(axis=1).min() > 100:
            return np.broadcast_to(ropes, (count, 3)).copy(), table
