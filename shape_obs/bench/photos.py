"""Photograph drawn objects on a table, maybe under a hand: colour, depth with a D455's noise, and the truth in space.

    rng = np.random.default_rng(0)
    for scene in photographs(rng, moving_rope(rng, speed=6.0), hand=True):
        detection = detector.detect(scene.rgb, scene.depth, scene.camera)

The camera frame is x right, y down, z forward, in metres.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import SIZE, Array, Mask, Object, truth_of
from shape_obs.camera import Intrinsics
from shape_obs.image.segmentation import HSVRange

Image = npt.NDArray[np.uint8]

BLUE: Final = HSVRange(low=(100, 80, 25), high=(130, 255, 255))  # segments the photographed objects
_OBJECT, _TABLE, _SKIN = (40.0, 80.0, 200.0), (150.0, 150.0, 145.0), (205.0, 150.0, 125.0)
# Of a D455: focal length at 480 rows, pixels; baseline, metres; deviation of a disparity, pixels; share without depth.
_FOCAL, _BASELINE, _DISPARITY, _HOLES = 386.0, 0.095, 0.08, 0.01


@dataclass(frozen=True)
class Hand:
    """A hand that comes from outside the image: a bar with a round tip.

    Args:
        tip: The middle of the round tip, (u, v) pixels.
        heading: Direction in which the hand points, in radians, clockwise as seen from the u axis.
        width: Thickness in pixels.
    """

    tip: tuple[float, float]
    heading: float
    width: float

    def covers(self, points: Array) -> npt.NDArray[np.bool_]:
        """Return whether the hand is over each point: (..., 2) pixels -> (...) bool."""
        ahead, offset = np.array([np.cos(self.heading), np.sin(self.heading)]), points - np.array(self.tip)
        along = np.minimum(offset @ ahead, 0.0)
        return np.linalg.norm(offset - along[..., None] * ahead, axis=-1) <= self.width / 2


@dataclass(frozen=True)
class Scene:
    """An object on a table in front of a camera, maybe under a hand.

    Args:
        rgb: ``(H, W, 3)`` uint8: a blue object on a gray table; ``BLUE`` segments it.
        mask: The visible part of the object, ``(H, W)`` uint8, 0 or 255.
        depth: ``(H, W)`` uint16 millimetres along the optical axis, 0 = invalid.
        camera: The intrinsics.
        pixels: The known points of the object in order, ``(P, 2)`` pixels, see ``truth_of``.
        points: The same points on the object's upper surface, ``(P, 3)`` metres, camera frame.
        hidden: ``(P,)`` bool: the hand is over the point, or it is out of the image.
    """

    rgb: Image
    mask: Mask
    depth: npt.NDArray[np.uint16]
    camera: Intrinsics
    pixels: Array
    points: Array
    hidden: npt.NDArray[np.bool_]


def photographs(
    rng: np.random.Generator, objects: Iterable[Object], *, hand: bool = False, tilt: float = 0.0
) -> Iterator[Scene]:
    """Photograph an object in every frame of a motion, on one table in one light.

    Args:
        rng: Draws light, noise, table and hand.
        objects: The object in every frame.
        hand: Whether a hand comes after a fifth of the frames, covers a part of the object and leaves again.
        tilt: Angle between the optical axis and the table's normal in radians.
    """
    shown, (towards, light) = list(objects), rng.uniform(0, 2 * np.pi, 2)
    normal = (np.sin(tilt) * np.cos(towards), np.sin(tilt) * np.sin(towards), np.cos(tilt))
    place, aside = rng.uniform(), rng.uniform(-0.5, 0.5)
    for i, thing in enumerate(shown):
        reach = (0.3 - abs((i + 0.5) / len(shown) - 0.5)) / 0.15
        over = _hand_over(thing, place, aside, min(reach, 1.0)) if hand and reach > 0 else None
        yield photograph(rng, thing, hand=over, normal=normal, light=light)


def photograph(
    rng: np.random.Generator,
    thing: Object,
    *,
    hand: Hand | None = None,
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0),
    distance: float = 0.7,
    light: float | None = None,
) -> Scene:
    """Photograph an object 10 mm thick on a table with a camera like a D455; a hand is 60 mm above the object.

    Args:
        rng: Draws the noise of colour and depth.
        thing: The object.
        hand: The hand, if there is one.
        normal: Unit normal of the table, camera frame; by default the camera looks straight down.
        distance: Distance of the object's surface along the optical axis in metres.
        light: Direction of the light in the image in radians; None draws it.
    """
    (height, width), truth = thing.mask.shape, truth_of(thing)
    camera, facing = pinhole((width, height)), np.array(normal)
    grid = np.stack(np.meshgrid(np.arange(float(width)), np.arange(float(height))), axis=-1)
    surface = distance * facing[2] / (camera.rays(grid) @ facing)
    depth = np.where(thing.mask > 0, surface, surface * (1 + 0.01 / (distance * facing[2])))
    rgb, mask = photographed(rng, thing.mask, contrast=1.5, noise=4.0, light=light), thing.mask
    hidden = np.any((truth < -0.5) | (truth >= np.array([width, height]) - 0.5), axis=1)
    if hand is not None:
        over = hand.covers(grid)
        mask, hidden = np.where(over, np.uint8(0), mask), hidden | hand.covers(truth)
        depth[over] = surface[over] - 0.06
        rgb[over] = np.rint(_SKIN + rng.normal(0, 4.0, (np.count_nonzero(over), 3)))
    rays = camera.rays(truth)
    points = rays * (distance * facing[2] / (rays @ facing))[:, None]
    return Scene(rgb, mask, depth_noise(rng, depth, camera), camera, truth, points, hidden)


def photographed(
    rng: np.random.Generator, mask: Mask, contrast: float, noise: float, light: float | None = None
) -> Image:
    """Draw a blue object on a gray table as an ``(H, W, 3)`` uint8 RGB image.

    Args:
        rng: Draws the noise.
        mask: The object, ``(H, W)``.
        contrast: Ratio of the light in the brightest corner of the image to the light in the darkest one.
        noise: RMS noise of the image in gray levels.
        light: Direction in which it becomes brighter, in radians; None draws it.
    """
    (height, width), angle = mask.shape, rng.uniform(0, 2 * np.pi) if light is None else light
    v, u = np.mgrid[:height, :width]
    along = u / width * np.cos(angle) + v / height * np.sin(angle)
    bright = contrast ** ((along - along.min()) / np.ptp(along) - 1.0)
    scene = np.where(mask[..., None] > 0, _OBJECT, _TABLE) * bright[..., None]
    return np.clip(np.rint(scene + rng.normal(0, noise, scene.shape)), 0, 255).astype(np.uint8)


def depth_noise(rng: np.random.Generator, depth: Array, camera: Intrinsics) -> npt.NDArray[np.uint16]:
    """Measure ``(H, W)`` metres as a D455 does: millimetres with holes, and noise that grows with the distance squared.

    Stereo matching correlates the noise of neighbouring pixels.
    """
    noise = cv2.GaussianBlur(rng.normal(size=depth.shape), (0, 0), 1.0)
    metres = depth + depth**2 * _DISPARITY / (camera.fx * _BASELINE) * noise / noise.std()
    return np.where(rng.random(depth.shape) < _HOLES, 0, np.rint(1e3 * metres).clip(0, 65535)).astype(np.uint16)


def pinhole(size: tuple[int, int]) -> Intrinsics:
    """Return a camera with the field of view of a D455 for images of ``size`` ``(width, height)``."""
    focal = _FOCAL * size[1] / SIZE[0]
    return Intrinsics(*size, focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2)


def _hand_over(thing: Object, place: float, aside: float, reach: float) -> Hand:
    """Return a hand from the border over a ``place``, a share of the object's points; it has come with ``reach`` 1."""
    size, truth = np.array(thing.mask.shape[::-1]), truth_of(thing)
    spot = truth[int(place * len(truth))]
    heading = float(np.arctan2(*(size / 2 - spot)[::-1])) + aside
    tip = spot - 0.4 * size[1] * (1 - reach) * np.array([np.cos(heading), np.sin(heading)])
    return Hand((float(tip[0]), float(tip[1])), heading, 0.075 * float(size[1]))
