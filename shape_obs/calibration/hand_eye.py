"""Where a camera stands in the base frame: the rigid motion that lays what it saw on what was touched.

Where a marker's corners are in space, as a camera sees them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import depth_in_metres

Array = npt.NDArray[np.float64]


LEAST_TOUCHES: Final = 4

_SPREAD: Final = 0.01  # metres by which the points must spread across the line that fits them best, rms

_OUTLYING: Final = 4.0  # times the others' rms, and

_OUTLYING_METRES: Final = 0.0015  # so far off, at least: a touch that does not fit to the others


@dataclass(frozen=True, eq=False)
class BaseFit:
    """A camera's place, and how well the touches agree with it.

    Args:
        extrinsics: The place.
        residuals: (K,) metres, by how much each touch lies off.
        rms: Of the residuals, metres.
        suspect: The touch that fits to none of the others; None if they agree.
        suspect_off: By how much it lies off where the others put it, metres.
    """

    extrinsics: Extrinsics
    residuals: Array
    rms: float
    suspect: int | None = None
    suspect_off: float = 0.0


def fit_base(
    points_camera: npt.ArrayLike,
    points_base: npt.ArrayLike,
    intrinsics: Intrinsics | None = None,
    serial: str | None = None,
    max_age_days: float = 30.0,
) -> BaseFit:
    """The rigid transform with the least squares of ``p_base - T p_camera``.

    Args:
        points_camera: (K,3) metres, camera frame.
        points_base: (K,3) metres, base frame: the same points, touched.
        intrinsics: For the file.
        serial: For the file.
        max_age_days: For the file.

    Raises:
        ValueError: Fewer than 4 points, points on a line, or numbers that are none.

    References:
        W. Kabsch, "A solution for the best rotation to relate two sets of vectors", Acta Crystallographica A32, 1976.
    """
    seen, touched = np.asarray(points_camera, np.float64), np.asarray(points_base, np.float64)
    if seen.ndim != 2 or seen.shape[1:] != (3,) or seen.shape != touched.shape:
        raise ValueError(f"fit_base: expected two arrays of shape (K, 3), got {seen.shape} and {touched.shape}.")
    if not (np.all(np.isfinite(seen)) and np.all(np.isfinite(touched))):
        raise ValueError("fit_base: expected finite metres.")
    if len(seen) < LEAST_TOUCHES:
        raise ValueError(f"{len(seen)} touches are too few, at least {LEAST_TOUCHES} are needed: touch more corners.")
    for name, points in (("corners seen", seen), ("touches", touched)):
        across = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(points))
        if across < _SPREAD:
            raise ValueError(
                f"the {name} lie within {1000 * across:.0f} mm of one line, so nothing tells how the camera is turned "
                "about it: touch corners of markers all around the table."
            )
    transform = _rigid(seen, touched)
    residuals = _off(transform, seen, touched)
    rms = float(np.sqrt(np.mean(residuals**2)))
    extrinsics = Extrinsics.from_dict(
        {"T": transform, "intrinsics": intrinsics, "serial": serial, "rms": rms, "max_age_days": max_age_days}
    )
    return BaseFit(extrinsics, residuals, rms, *_suspect(seen, touched))


def _rigid(seen: Array, touched: Array) -> Array:
    """(4,4) the motion that lays one set of points on the other."""
    middle, target = seen.mean(axis=0), touched.mean(axis=0)
    left, _, right = np.linalg.svd((touched - target).T @ (seen - middle))
    proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    transform = np.eye(4)
    transform[:3, :3] = left @ proper @ right
    transform[:3, 3] = target - transform[:3, :3] @ middle
    return transform


def _off(transform: Array, seen: Array, touched: Array) -> Array:
    off = seen @ transform[:3, :3].T + transform[:3, 3] - touched
    return np.asarray(np.linalg.norm(off, axis=1), np.float64)


def _suspect(seen: Array, touched: Array) -> tuple[int | None, float]:
    """The touch without which the others agree best, if it lies far off where they put it, and how far."""
    if len(seen) <= LEAST_TOUCHES:
        return None, 0.0
    tried = []
    for i in range(len(seen)):
        others = np.arange(len(seen)) != i
        off = _off(_rigid(seen[others], touched[others]), seen, touched)
        tried.append((float(np.sqrt(np.mean(off[others] ** 2))), float(off[i]), i))
    rms, off, i = min(tried)
    return (i, off) if off > max(_OUTLYING * rms, _OUTLYING_METRES) else (None, 0.0)


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
