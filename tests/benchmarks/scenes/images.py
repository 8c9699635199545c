"""Draw images of ropes and sheets: disturbed masks, photos in uneven light, a hand over a rope, and depth at a slant.

The depth images have noise, holes and flying pixels: at the object's border, pixels mix the depths of the object and of
the table behind it, or lie farther behind.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs.image.segmentation import HSVRange
from tests.benchmarks.scenes.ropes import Kind, Rope, blank, covered, moving_rope, random_rope, subpixel

Mask = npt.NDArray[np.uint8]
Image = npt.NDArray[np.uint8]
# Segments the objects of ``photographed``.
BLUE: Final = HSVRange(low=(100, 80, 25), high=(130, 255, 255))
_ROPE: Final = (40.0, 80.0, 200.0)
_TABLE: Final = (150.0, 150.0, 145.0)
Array = npt.NDArray[np.float64]
Where = Literal["start", "end", "middle"]
_HAND: Final = 34.0  # width of the hand in pixels
_AWAY: Final = 0.2  # share of the frames before the hand arrives, and after it has left
CAMERA: Final = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)
_LEAN: Final = (np.radians(30), np.radians(45))
_DEPTH_NOISE: Final = 0.0015  # metres
_BEHIND: Final = 0.012  # distance of the table behind the object in metres
_FLYING: Final = 0.10  # largest distance of flying pixels behind it in metres
_SPECKLE: Final = 0.10  # share of single pixels without depth
_HOLES: Final = (6, 9)  # number and side of squares on the object without depth


def salted(rng: np.random.Generator, mask: Mask, share: float) -> Mask:
    """Flip a share of all pixels of a mask."""
    return np.where(rng.random(mask.shape) < share, 255 - mask, mask).astype(np.uint8)


def ragged(rng: np.random.Generator, mask: Mask, depth: float) -> Mask:
    """Move the border of a mask in and out by ``depth`` pixels rms, in bites about five pixels long."""
    inside = cv2.distanceTransform(mask, cv2.DIST_L2, 5)
    outside = cv2.distanceTransform(255 - mask, cv2.DIST_L2, 5)
    bites = cv2.GaussianBlur(rng.normal(size=mask.shape).astype(np.float32), (0, 0), 2.0)
    bites *= depth / float(bites.std())
    return np.where(inside - outside > bites, 255, 0).astype(np.uint8)


def photographed(rng: np.random.Generator, mask: Mask, contrast: float, noise: float) -> Image:
    """Draw a blue rope on a gray table as an ``(H, W, 3)`` uint8 RGB image.

    Args:
        rng: Draws the direction of the light and the noise.
        mask: The rope, ``(H, W)``.
        contrast: Ratio of the light in the brightest corner of the image to the light in the darkest one.
        noise: RMS noise of the image in gray levels.
    """
    height, width = mask.shape
    angle = rng.uniform(0, 2 * np.pi)
    v, u = np.mgrid[:height, :width]
    along = u / width * np.cos(angle) + v / height * np.sin(angle)
    along = (along - along.min()) / np.ptp(along)
    light = contrast ** (along - 1.0)
    scene = np.where(mask[..., None] > 0, _ROPE, _TABLE) * light[..., None]
    return np.clip(np.rint(scene + rng.normal(0, noise, scene.shape)), 0, 255).astype(np.uint8)


class Hidden(NamedTuple):
    """One frame of a rope under a hand.

    Args:
        rope: The rope with its whole mask.
        mask: The visible part of the mask, ``(H, W)`` uint8.
        share: Covered share of the rope's length.
    """

    rope: Rope
    mask: npt.NDArray[np.uint8]
    share: float


def hidden_rope(
    rng: np.random.Generator, speed: float, share: float, where: Where, *, creep: int = 0, frames: int = 180
) -> Iterator[Hidden]:
    """Draw a moving rope with a hand over a part of it during the middle three fifths of the frames.

    Args:
        rng: Draws the motion.
        speed: Speed of the fastest point in pixels per frame.
        share: Share of the length that the hand covers.
        where: The covered part.
        creep: Frames over which the hand comes and goes; 0 at once.
        frames: Number of frames.
    """
    for index, rope in enumerate(moving_rope(rng, speed, frames)):
        inside = min(index - _AWAY * frames, (1 - _AWAY) * frames - index)
        covered = share * float(np.clip((inside + 1) / (creep + 1), 0, 1))
        yield Hidden(rope, _under_hand(rope, covered, where), covered)


def _under_hand(rope: Rope, share: float, where: Where) -> npt.NDArray[np.uint8]:
    mask = rope.mask.copy()
    count = round(share * len(rope.curve))
    if count >= 2:
        first = {"start": 0, "end": len(rope.curve) - count, "middle": (len(rope.curve) - count) // 2}[where]
        line = np.rint(rope.curve[first : first + count]).astype(np.int32)
        cv2.polylines(mask, [line], False, 0, round(_HAND))
    return mask


@dataclass(frozen=True)
class TiltedRope:
    """A rope seen at a slant.

    Args:
        mask: (480, 640) uint8.
        depth: (480, 640) metres, 0 = invalid.
        curve: ``(P, 3)`` metres, camera frame.
        hairpin: Whether a bend is narrower than a gap of 20 points, so that equal chords leave the rope.
    """

    mask: Mask
    depth: Array
    curve: Array
    hairpin: bool


@dataclass(frozen=True)
class TiltedSheet:
    """A sheet of 0.36 x 0.24 m seen at a slant.

    Args:
        mask: (480, 640) uint8.
        depth: (480, 640) metres, 0 = invalid.
        corners: ``(4, 3)`` metres, camera frame: top left, top right, bottom right, bottom left.
    """

    mask: Mask
    depth: Array
    corners: Array

    def lattice(self, rows: int, cols: int) -> Array:
        """Return a lattice up to the border, (rows*cols, 3) metres, row by row from the top left."""
        v, u = np.linspace(0, 1, rows)[:, None, None], np.linspace(0, 1, cols)[:, None]
        first, right, _, down = self.corners
        return (first + u * (right - first) + v * (down - first)).reshape(-1, 3)


def tilted_rope(rng: np.random.Generator, kind: Kind = "smooth") -> TiltedRope:
    """Draw a rope on a plane that leans by 30 to 45 degrees."""
    rope = random_rope(rng, kind)
    normal, point = _plane(rng, 0.9)
    rays = CAMERA.rays(rope.curve)
    curve = rays * ((point @ normal) / (rays @ normal))[:, None]
    return TiltedRope(rope.mask, _depth(rng, rope.mask, normal, point), curve, rope.length / 20 > 2 * rope.bend_radius)


def tilted_sheet(rng: np.random.Generator) -> TiltedSheet:
    """Draw a flat sheet on a plane that leans by 30 to 45 degrees, turned by at most 20 degrees in the plane."""
    normal, point = _plane(rng, 0.8)
    right = np.array([1.0, 0, 0]) - normal * normal[0]
    right /= np.linalg.norm(right)
    down, turn = np.cross(normal, right), rng.uniform(-0.35, 0.35)
    right, down = np.cos(turn) * right + np.sin(turn) * down, np.cos(turn) * down - np.sin(turn) * right
    corners = np.array([point + x * 0.18 * right + y * 0.12 * down for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    canvas = blank((480, 640))
    cv2.fillPoly(canvas, [subpixel(CAMERA.project(corners))], 255, shift=8)
    mask = covered(canvas)
    return TiltedSheet(mask, _depth(rng, mask, normal, point), corners)


def _plane(rng: np.random.Generator, distance: float) -> tuple[Array, Array]:
    """Return the normal and a point of a plane that leans in a random direction."""
    lean, towards = rng.uniform(*_LEAN), rng.uniform(0, 2 * np.pi)
    normal = np.array([np.sin(lean) * np.cos(towards), np.sin(lean) * np.sin(towards), np.cos(lean)])
    return normal, np.array([0.0, 0.0, distance])


def _depth(rng: np.random.Generator, mask: Mask, normal: Array, point: Array) -> Array:
    """Return the depth image of an object in a plane, with all faults."""
    v, u = np.mgrid[: mask.shape[0], : mask.shape[1]]
    plane = (point @ normal) / (CAMERA.rays(np.stack([u, v], axis=-1)) @ normal)
    depth = np.where(mask > 0, plane, plane + _BEHIND) + rng.normal(0, _DEPTH_NOISE, plane.shape)
    cross = np.ones((3, 3), np.uint8)
    edge = (cv2.dilate(mask, cross) > 0) & (cv2.erode(mask, cross) == 0)
    depth[edge] += rng.uniform(0, _FLYING, int(edge.sum()))
    depth[rng.uniform(size=depth.shape) < _SPECKLE] = 0
    on, (count, size) = np.argwhere(mask), _HOLES
    for row, column in on[rng.integers(len(on), size=count)]:
        depth[max(row - size // 2, 0) : row + size // 2 + 1, max(column - size // 2, 0) : column + size // 2 + 1] = 0
    return depth
