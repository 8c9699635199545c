"""Disturb masks, and draw ropes and sheets at a slant with all faults of depth.

The depth images have noise, holes and flying pixels: at the object's border, pixels mix the depths of the object and of
the table behind it, or lie farther behind.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import blank, covered, rotation, subpixel
from shape_obs.camera import Intrinsics
from tests.scenes.ropes import Kind, bend_radius, random_rope

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]
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
    inside, outside = (cv2.distanceTransform(part, cv2.DIST_L2, 5) for part in (mask, 255 - mask))
    bites = cv2.GaussianBlur(rng.normal(size=mask.shape).astype(np.float32), (0, 0), 2.0)
    return np.where(inside - outside > bites * depth / float(bites.std()), 255, 0).astype(np.uint8)


@dataclass(frozen=True)
class TiltedRope:
    """A rope seen at a slant."""

    mask: Mask  # (480, 640) uint8
    depth: Array  # (480, 640) metres, 0 = invalid
    curve: Array  # (P, 3) metres, camera frame
    hairpin: bool  # whether a bend is narrower than a gap of 20 points, so that equal chords leave the rope


@dataclass(frozen=True)
class TiltedSheet:
    """A sheet of 0.36 x 0.24 m seen at a slant."""

    mask: Mask  # (480, 640) uint8
    depth: Array  # (480, 640) metres, 0 = invalid
    corners: Array  # (4, 3) metres, camera frame: top left, top right, bottom right, bottom left

    def lattice(self, rows: int, cols: int) -> Array:
        """Return a lattice up to the border, (rows*cols, 3) metres, row by row from the top left."""
        v, u = np.linspace(0, 1, rows)[:, None, None], np.linspace(0, 1, cols)[:, None]
        first, right, _, down = self.corners
        return (first + u * (right - first) + v * (down - first)).reshape(-1, 3)


def tilted_rope(rng: np.random.Generator, kind: Kind = "smooth") -> TiltedRope:
    """Draw a rope on a plane that leans by 30 to 45 degrees."""
    rope, normal = random_rope(rng, kind), _leaning(rng)
    rays, depth = CAMERA.rays(rope.curve), _depth(rng, rope.mask, normal, 0.9)
    curve = rays * (0.9 * normal[2] / (rays @ normal))[:, None]
    return TiltedRope(rope.mask, depth, curve, rope.length / 20 > 2 * bend_radius(rope))


def tilted_sheet(rng: np.random.Generator) -> TiltedSheet:
    """Draw a flat sheet on a plane that leans by 30 to 45 degrees, turned by at most 20 degrees in the plane."""
    normal = _leaning(rng)
    right = np.array([1.0, 0, 0]) - normal * normal[0]
    right /= np.linalg.norm(right)
    axes = rotation(-rng.uniform(-0.35, 0.35)) @ np.stack([right, np.cross(normal, right)])
    flat = np.array([(-0.18, -0.12), (0.18, -0.12), (0.18, 0.12), (-0.18, 0.12)])
    corners = np.asarray(flat @ axes + (0.0, 0.0, 0.8), np.float64)
    canvas = blank((480, 640))
    cv2.fillPoly(canvas, [subpixel(CAMERA.project(corners))], (255,), shift=8)
    mask = covered(canvas)
    return TiltedSheet(mask, _depth(rng, mask, normal, 0.8), corners)


def _leaning(rng: np.random.Generator) -> Array:
    """Return the unit normal of a plane that leans in a random direction."""
    lean, towards = rng.uniform(*_LEAN), rng.uniform(0, 2 * np.pi)
    return np.array([np.sin(lean) * np.cos(towards), np.sin(lean) * np.sin(towards), np.cos(lean)])


def _depth(rng: np.random.Generator, mask: Mask, normal: Array, distance: float) -> Array:
    """Return the depth image of an object in a plane, so far away on the optical axis, with all faults."""
    v, u = np.mgrid[: mask.shape[0], : mask.shape[1]]
    plane = distance * normal[2] / (CAMERA.rays(np.stack([u, v], axis=-1)) @ normal)
    depth = np.where(mask > 0, plane, plane + _BEHIND) + rng.normal(0, _DEPTH_NOISE, plane.shape)
    cross = np.ones((3, 3), np.uint8)
    edge = (cv2.dilate(mask, cross) > 0) & (cv2.erode(mask, cross) == 0)
    depth[edge] += rng.uniform(0, _FLYING, int(edge.sum()))
    depth[rng.uniform(size=depth.shape) < _SPECKLE] = 0
    on, (count, size) = np.argwhere(mask), _HOLES
    for row, column in on[rng.integers(len(on), size=count)]:
        depth[max(row - size // 2, 0) : row + size // 2 + 1, max(column - size // 2, 0) : column + size // 2 + 1] = 0
    return depth
