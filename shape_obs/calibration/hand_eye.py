"""Fit the pose of a camera in the base frame to points that it sees and a robot touches; locate markers in space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraLike, as_intrinsics
from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import depth_in_metres
from shape_obs.geometry.observed import MAD_SIGMA
from shape_obs.geometry.rotation import fit
from shape_obs.utils.lengths import warn_unless_metres

Array = npt.NDArray[np.float64]

LEAST_TOUCHES: Final = 4
_SPREAD: Final = 0.01  # smallest rms distance in metres of the points from the line that fits them best
# A touch is an outlier if it lies farther off than both of these.
_OUTLYING: Final = 4.0  # in units of the rms residual of the others
_OUTLYING_METRES: Final = 0.0015

_INSIDE: Final = 0.85  # part of the marker whose depth is used, so that none next to it is read
_ENOUGH: Final = 0.3  # smallest share of these pixels with depth
_LEAST: Final = 12  # smallest number of these pixels
_STRAY: Final = 3.0  # robust standard deviations from the marker's plane beyond which a pixel is ignored


@dataclass(frozen=True, eq=False)
class BaseFit:
    """The pose of a camera, and how well the touches agree with it.

    Args:
        extrinsics: The pose.
        residuals: ``(K,)`` distances in metres of the touches from their fitted positions.
        rms: Root mean square of the residuals in metres.
        suspect: Index of the touch that does not agree with the others; None if they agree.
        suspect_off: Distance in metres of the suspect from where the others put it.
    """

    extrinsics: Extrinsics
    residuals: Array
    rms: float
    suspect: int | None = None
    suspect_off: float = 0.0


def fit_base(
    points_camera: npt.ArrayLike,
    points_base: npt.ArrayLike,
    intrinsics: CameraLike = None,
    serial: str | None = None,
    max_age_days: float = 30.0,
) -> BaseFit:
    """Fit the rigid transform that minimises the squares of ``p_base - T p_camera``.

    Args:
        points_camera: ``(K, 3)`` metres, camera frame.
        points_base: ``(K, 3)`` metres, base frame: the same points, touched by the robot.
        intrinsics: The intrinsics to store in the file.
        serial: The serial number to store in the file.
        max_age_days: The maximum age to store in the file.

    Raises:
        ValueError: There are fewer than 4 points, all points lie on a line, or some are not finite.
    """
    seen, touched = np.asarray(points_camera, np.float64), np.asarray(points_base, np.float64)
    if seen.ndim != 2 or seen.shape[1:] != (3,) or seen.shape != touched.shape:
        raise ValueError(f"fit_base: expected two arrays of shape (K, 3), got {seen.shape} and {touched.shape}.")
    if not (np.all(np.isfinite(seen)) and np.all(np.isfinite(touched))):
        raise ValueError("fit_base: expected finite metres.")
    for name, points in (("points_camera", seen), ("points_base", touched)):
        warn_unless_metres(f"fit_base: {name}", points)
    if len(seen) < LEAST_TOUCHES:
        raise ValueError(f"{len(seen)} touches are too few, at least {LEAST_TOUCHES} are needed: touch more corners.")
    for name, points in (("corners seen", seen), ("touches", touched)):
        across = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(points))
        if across < _SPREAD:
            raise ValueError(
                f"the {name} lie within {1000 * across:.0f} mm of one line, which leaves the rotation about it "
                "undetermined: touch corners of markers all around the table."
            )
    transform, lens = fit(seen, touched), None if intrinsics is None else as_intrinsics(intrinsics)
    residuals = np.linalg.norm(transform.apply(seen) - touched, axis=1)
    rms = float(np.sqrt(np.mean(residuals**2)))
    extrinsics = Extrinsics.from_dict(
        {"T": transform.matrix, "intrinsics": lens, "serial": serial, "rms": rms, "max_age_days": max_age_days}
    )
    return BaseFit(extrinsics, residuals, rms, *_suspect(seen, touched))


def _suspect(seen: Array, touched: Array) -> tuple[int | None, float]:
    """Return the touch that is an outlier of the others, if any, and its distance from where they put it."""
    if len(seen) <= LEAST_TOUCHES:
        return None, 0.0
    tried = []
    for i in range(len(seen)):
        others = np.arange(len(seen)) != i
        off = np.linalg.norm(fit(seen[others], touched[others]).apply(seen) - touched, axis=1)
        tried.append((float(np.sqrt(np.mean(off[others] ** 2))), float(off[i]), i))
    rms, off, i = min(tried)
    return (i, off) if off > max(_OUTLYING * rms, _OUTLYING_METRES) else (None, 0.0)


def marker_points(
    corners: Array, intrinsics: CameraLike, depth: npt.NDArray[Any] | None = None, size: float | None = None
) -> Array:
    """Return the positions of a marker's corners in space.

    With depth, the ray of each corner is intersected with the plane through the depth of the whole marker, because half
    of the depth at a corner belongs to the table, and hundreds of pixels are less noisy than one. Without depth, the
    distance follows from the size of the marker, less accurately.

    Args:
        corners: ``(4, 2)`` pixels, see ``find_markers``.
        intrinsics: The intrinsics of the image, or what ``as_camera_model`` reads.
        depth: ``(H, W)`` uint16 millimetres or float metres; None without depth.
        size: Side of the marker's black square in metres; None if unknown.

    Returns:
        Positions of shape ``(4, 3)`` in metres, camera frame.

    Raises:
        ValueError: There is not enough depth on the marker, and its size is unknown.
    """
    intrinsics = as_intrinsics(intrinsics, None if depth is None else (depth.shape[0], depth.shape[1]))
    plane = None if depth is None else _plane(corners, depth)
    if plane is not None:
        return intrinsics.deproject(corners, 1 / (corners @ plane[:2] + plane[2]))
    if size is None:
        raise ValueError("there is not enough depth on the marker: give the marker's size.")
    warn_unless_metres("size of the marker", size, most=1.0, least=0.002)
    half = size / 2
    square = np.array([(-half, half, 0), (half, half, 0), (half, -half, 0), (-half, -half, 0)])
    rays = np.ascontiguousarray(intrinsics.rays(corners)[:, :2])
    _, turn, shift = cv2.solvePnP(square, rays, np.eye(3), np.zeros(0), flags=cv2.SOLVEPNP_IPPE_SQUARE)
    return square @ cv2.Rodrigues(turn)[0].T + np.ravel(shift)


def has_depth(corners: Array, depth: npt.NDArray[Any]) -> bool:
    """Return whether there is enough depth on a marker to locate it."""
    return _plane(corners, depth) is not None


def _plane(corners: Array, depth: npt.NDArray[Any]) -> Array | None:
    """Return (a, b, c) with 1/z = a u + b v + c, since a plane in space is also one in inverse depth."""
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
        kept = off <= _STRAY * MAD_SIGMA * max(float(np.median(off)), 1e-6)
    return np.asarray(plane, np.float64)
