"""Where a marker's corners are in space, as a camera sees them."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs.frame import depth_in_metres

Array = npt.NDArray[np.float64]

_INSIDE: Final = 0.85  # of the marker, so that no depth of what lies beside it is read
_ENOUGH: Final = 0.3  # of these pixels have depth, at least
_LEAST: Final = 12  # pixels
_STRAY: Final = 3.0  # robust deviations of the depth from the marker's plane, beyond which a pixel is left out
_NORMAL: Final = 1.4826  # standard deviations in a median deviation


def marker_points(
    corners: Array, intrinsics: Intrinsics, depth: npt.NDArray[Any] | None = None, size: float | None = None
) -> Array:
    """Lift a marker's corners to space.

    With depth, each corner's ray is cut with the plane through the depth of the whole marker: the depth at a corner
    itself belongs half to the table, and hundreds of pixels are less noisy than one. Without it, the marker's size
    tells the distance, less well.

    Args:
        corners: (4,2) pixels, see ``find_markers``.
        intrinsics: Of the image.
        depth: (H,W) uint16 millimetres or floating metres; None where there is none.
        size: Side of the marker's black square, metres; None where it is not known.

    Returns:
        (4,3) metres, camera frame.

    Raises:
        ValueError: There is not enough depth on the marker, and its size is not known.
    """
    plane = None if depth is None else _plane(corners, depth)
    if plane is not None:
        return intrinsics.deproject(corners, 1 / (corners @ plane[:2] + plane[2]))
    if size is None:
        raise ValueError("there is no depth that tells where the marker is: give the marker's size.")
    half = size / 2
    square = np.array([(-half, half, 0), (half, half, 0), (half, -half, 0), (-half, -half, 0)])
    rays = np.ascontiguousarray(intrinsics.rays(corners)[:, :2])
    _, turn, shift = cv2.solvePnP(square, rays, np.eye(3), np.zeros(0), flags=cv2.SOLVEPNP_IPPE_SQUARE)
    return square @ cv2.Rodrigues(turn)[0].T + np.ravel(shift)


def has_depth(corners: Array, depth: npt.NDArray[Any]) -> bool:
    """Whether there is enough depth on a marker to tell where it is."""
    return _plane(corners, depth) is not None


def _plane(corners: Array, depth: npt.NDArray[Any]) -> Array | None:
    """(3,) a, b, c with 1/z = a u + b v + c: a plane in space is one in the inverse depth too."""
    inside = np.zeros(depth.shape, np.uint8)
    middle = corners.mean(axis=0)
    cv2.fillConvexPoly(inside, np.round(middle + _INSIDE * (corners - middle)).astype(np.int32), 1)
    rows, columns = np.nonzero(inside)
    metres = depth_in_metres(depth[rows, columns])
    known = np.isfinite(metres)
    if known.sum() < max(_LEAST, _ENOUGH * len(rows)):
        return None
    at = np.stack([columns[known], rows[known], np.ones(known.sum())], axis=1).astype(np.float64)
    inverse = 1 / metres[known]
    kept = np.abs(inverse - np.median(inverse)) < 0.2 * np.median(inverse)
    plane = np.zeros(3)
    for _ in range(3):
        plane = np.linalg.lstsq(at[kept], inverse[kept], rcond=None)[0]
        off = np.abs(at @ plane - inverse)
        kept = off <= _STRAY * _NORMAL * max(float(np.median(off)), 1e-6)
    return np.asarray(plane, np.float64)
