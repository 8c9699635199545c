"""Where a camera stands in the base frame: the rigid motion that lays what it saw on what was touched."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs.extrinsics import Extrinsics

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
