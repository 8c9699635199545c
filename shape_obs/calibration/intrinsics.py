"""Fit the intrinsics of a camera to views of a board, and compare them with those of the factory."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.calibration.board import Board, BoardView
from shape_obs.camera import Intrinsics
from shape_obs.extrinsics import now
from shape_obs.geometry.rotation import best_rotation
from shape_obs.spec import Spec, SpecError
from shape_obs.utils.documents import read_json
from shape_obs.utils.files import write_text

Array = npt.NDArray[np.float64]

LEAST_VIEWS: Final = 6
# The factory's intrinsics are accepted if their rays are close to the fitted ones (a pixel is 1.8 mm at 0.7 m) and
# their residuals hardly larger. A fit with a larger uncertainty of the focal length cannot decide this.
GOOD_RAYS: Final = 0.7  # pixels rms
GOOD_RMS: Final = 0.2  # pixels more than the fitted rms
KNOWN_FOCAL: Final = 0.0025  # relative standard deviation of the focal length


@dataclass(frozen=True)
class IntrinsicsFit(Spec):
    """Fitted intrinsics of a camera, and a check of those of the factory.

    Args:
        intrinsics: The fitted intrinsics, Brown-Conrady without k3.
        rms: Root mean square residual of the corners in pixels.
        deviation: Relative standard deviation of fx and fy.
        views: Number of views.
        coverage: Share of the image's cells in which corners were visible.
        factory: The intrinsics that the camera reports; None if it reports none.
        factory_rms: Root mean square residual of the corners in pixels with the factory's intrinsics.
        factory_apart: Root mean square difference in pixels between the rays of both intrinsics at the corners, after
            the best rotation, which belongs to the pose of the camera.
        doubts: Reasons against the factory's intrinsics or against the fit; empty if there are none.
        serial: Serial number of the camera.
        created: Time of the fit, ISO 8601.
    """

    intrinsics: Intrinsics
    rms: float
    deviation: float
    views: int
    coverage: float
    factory: Intrinsics | None = None
    factory_rms: float | None = None
    factory_apart: float | None = None
    doubts: tuple[str, ...] = ()
    serial: str | None = None
    created: str = field(default_factory=now)

    @property
    def good(self) -> bool:
        """Whether there are no doubts about the camera's own intrinsics, or about the fitted ones if it has none."""
        return not self.doubts

    def save(self, path: str | Path) -> None:
        """Write the result as JSON, completely or not at all.

        Raises:
            OSError: The file cannot be written.
        """
        write_text(Path(path), json.dumps(self.to_dict(), indent=2) + "\n")

    @classmethod
    def load(cls, path: str | Path) -> IntrinsicsFit:
        """Read a file that ``save`` wrote.

        Raises:
            FileNotFoundError: There is no such file.
            SpecError: The file is not JSON, or an entry is missing.
        """
        data = read_json(path, "intrinsics")
        try:
            return cls.from_dict(data)
        except ValueError as error:
            raise SpecError(f"{path}: not a file of intrinsics, or a damaged one: {error}") from error


def fit_intrinsics(
    views: Sequence[BoardView],
    size: tuple[int, int],
    board: Board,
    factory: Intrinsics | None = None,
    coverage: float = 0.0,
    serial: str | None = None,
) -> IntrinsicsFit:
    """Fit the intrinsics of a camera, and check those of the factory.

    Args:
        views: Views of the board, as ``BoardViews`` collects them.
        size: ``(H, W)`` of the images.
        board: The board.
        factory: The intrinsics that the camera reports.
        coverage: See ``IntrinsicsFit``.
        serial: Serial number of the camera.

    Raises:
        ValueError: There are fewer than 6 views, or the board was never tilted, which leaves the focal length
            undetermined.

    References:
        Z. Zhang, "A flexible new technique for camera calibration", IEEE TPAMI 22(11), 2000.
    """
    if len(views) < LEAST_VIEWS:
        raise ValueError(
            f"{len(views)} different views of the board are too few, at least {LEAST_VIEWS} are needed: show all of "
            "it, near and far, tilted, and in every part of the image. Is it the board that --board describes?"
        )
    solid = [np.asarray(board.corners[view.ids], np.float32) for view in views]
    pixels = [np.asarray(view.pixels, np.float32).reshape(-1, 1, 2) for view in views]
    height, width = size
    nothing: Any = None
    rms, matrix, coeffs, _, _, deviations, _, _ = cv2.calibrateCameraExtended(
        solid, pixels, (width, height), nothing, nothing, flags=cv2.CALIB_FIX_K3
    )
    fitted = Intrinsics(width, height, matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], "brown_conrady")
    fitted = replace(fitted, coeffs=tuple(np.ravel(coeffs)[:5].tolist()))
    deviation = float(max(np.ravel(deviations)[:2] / (fitted.fx, fitted.fy)))
    if not np.isfinite(deviation) or deviation > 20 * KNOWN_FOCAL:
        raise ValueError(
            "the views do not determine the focal length: tilt the board, by up to 45 degrees, in all directions."
        )
    factory_rms = apart = None
    if factory is not None:
        factory_rms = float(np.sqrt(np.mean(np.concatenate(_off(views, board, factory)) ** 2)))
        apart = _apart(fitted, factory, np.concatenate([view.pixels for view in views]))
    doubts = _doubts(float(rms), deviation, apart, factory_rms)
    return IntrinsicsFit(
        fitted, float(rms), deviation, len(views), coverage, factory, factory_rms, apart, doubts, serial
    )


def _doubts(rms: float, deviation: float, apart: float | None, factory_rms: float | None) -> tuple[str, ...]:
    found = []
    if rms > 1:
        found.append(f"the corner residual is {rms:.2f} px even with the fitted intrinsics: is the board flat?")
    if deviation > KNOWN_FOCAL:
        found.append(
            f"the focal length is only known to {100 * deviation:.2f} %: show more views, tilted by up to 45 degrees."
        )
    elif apart is not None and apart > GOOD_RAYS:
        found.append(
            f"the factory's rays differ from the fitted ones by {apart:.1f} px rms: the focal lengths are wrong, the "
            "image is not rectified, or the lens was moved."
        )
    if factory_rms is not None and factory_rms > rms + GOOD_RMS:
        found.append(
            f"the corner residual is {factory_rms:.2f} px with the factory's intrinsics and {rms:.2f} px with the "
            "fitted ones."
        )
    return tuple(found)


def _apart(one: Intrinsics, other: Intrinsics, pixels: Array) -> float:
    """Return the rms difference in pixels between the rays of two intrinsics, after the best rotation."""
    first, second = (_unit(each.rays(pixels)) for each in (one, other))
    off = first - second @ best_rotation(second.T @ first)
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))) * one.fx)


def _unit(rays: Array) -> Array:
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _off(views: Sequence[BoardView], board: Board, intrinsics: Intrinsics) -> list[Array]:
    """Return for each view the distances in pixels of its corners from those of the best pose of the board."""
    off = []
    for view in views:
        solid = board.corners[view.ids]
        # The pose is fitted to rays, so that all lens models are treated alike.

        rays = np.ascontiguousarray(intrinsics.rays(view.pixels)[:, :2])
        _, turn, shift = cv2.solvePnP(solid, rays, np.eye(3), np.zeros(0), flags=cv2.SOLVEPNP_ITERATIVE)
        placed = solid @ cv2.Rodrigues(turn)[0].T + np.ravel(shift)
        off.append(np.linalg.norm(intrinsics.project(placed) - view.pixels, axis=1))
    return off
