"""Draw cloths whose every material point is known, in the image plane.

The cloths are independent of the library's method: smooth fields bend a regular lattice, without a Coons patch.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import SIZE, Sheet, draw_sheet, flat_cloth, is_cloth, swinging_bend
from shape_obs.bench.scenes import rotation as turned_by
from shape_obs.configurations.base import Ends
from shape_obs.geometry.lattice import sample_lattice

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]
_MARGIN: Final = 12.0


def true_lattice(points: Array, rows: int, cols: int, ends: Ends) -> Array:
    """Return the true positions of a lattice's points on a cloth: (R, C, D) material points -> (rows, cols, D)."""
    down, across = (np.arange(float(count)) for count in points.shape[:2])
    fine = np.ascontiguousarray(points, dtype=np.float64)
    return sample_lattice(fine, down, across, rows, cols, ends == "centers").reshape(rows, cols, -1)


def random_sheet(
    rng: np.random.Generator, aspect: float, degrees: float, *, tilt: float = 0.0, bend: float = 0.035
) -> Sheet:
    """Draw a cloth with bent sides and corners that are not right angles.

    Args:
        rng: Draws the deformation.
        aspect: Width over height in the cloth's frame.
        degrees: Rotation, clockwise as seen.
        tilt: Perspective: how much nearer the near edge is than the far one, as a share.
        bend: Standard deviation of each bending mode, in short sides.
    """
    for _ in range(200):
        flat = flat_cloth(aspect)
        bent, towards = flat + swinging_bend(rng, flat, bend)(0.0), rng.uniform(0, 2 * np.pi)
        along = bent @ np.array([np.cos(towards), np.sin(towards)])
        points = bent / (1 - tilt * along / np.ptp(along))[..., None] @ rotation(degrees).T
        if is_cloth(points):
            low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
            room = np.array([SIZE[1], SIZE[0]]) - 2 * _MARGIN - (high - low)
            return draw_sheet(points - low + _MARGIN + np.maximum(room, 0) * rng.uniform(size=2))
    raise RuntimeError(f"no sheet of aspect {aspect} was found that neither folds nor loses its corners.")


def turning_sheet(rng: np.random.Generator, aspect: float, step: float = 1.0) -> Iterator[Sheet]:
    """Draw a bent cloth that turns once around on the spot by ``step`` degrees per frame."""
    points = random_sheet(rng, aspect, 0.0).points
    points = points - points.mean(axis=(0, 1))
    points *= min((min(SIZE) / 2 - _MARGIN) / np.linalg.norm(points, axis=-1).max(), 1.0)
    for degrees in np.arange(0.0, 360.0 + step / 2, step):
        yield draw_sheet(points @ rotation(degrees).T + np.array([SIZE[1] - 1, SIZE[0] - 1]) / 2)


def noisy(mask: Mask, rng: np.random.Generator, sigma: float = 0.15) -> Mask:
    """Return the mask that a threshold cuts from a blurred, noisy image; only the border changes."""
    soft = cv2.GaussianBlur(mask, (0, 0), 1.2) / 255.0
    return np.where(soft + rng.normal(0, sigma, mask.shape) > 0.5, np.uint8(255), np.uint8(0))


def rotation(degrees: float) -> Array:
    """Return a rotation that is clockwise as seen, since v points down, ``(2, 2)``."""
    return turned_by(np.radians(degrees))
