"""TopView: between pixels and metres on a table, from markers that lie on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from shape_obs.camera import Intrinsics
from shape_obs.markers.finder import Corners, find_markers
from shape_obs.markers.layout import MarkerLayout

Array = npt.NDArray[np.float64]

_LEAST: Final = 2  # markers: one alone tells the far side of a table badly


class MarkersNotSeen(ValueError):  # noqa: N818 - a name of the public API
    """Too few of the markers are in the image; the message names those that are missing."""


@dataclass(frozen=True, eq=False)
class TopView:
    """A flat table seen by a pinhole camera.

    Args:
        homography: (3,3) table -> image: metres (x, y, 1) to homogeneous pixels.
        layout: Where the markers lie.
        seen: The ids that it was computed from.
        rms: By how much their corners lie off where the layout says, pixels; more than one means that the markers lie
            elsewhere, or that the lens bends lines (rectify the image first).

    Example:
        >>> view = TopView.find(rgb, MarkerLayout.rectangle(marker=0.06, width=0.6, height=0.4))  # doctest: +SKIP
        >>> view.to_table(shape.points2d)  # (N,2) metres  # doctest: +SKIP
    """

    homography: Array
    layout: MarkerLayout
    seen: tuple[int, ...]
    rms: float

    @classmethod
    def find(cls, rgb: npt.NDArray[np.uint8], layout: MarkerLayout) -> TopView:
        """From an image.

        Args:
            rgb: (H,W,3) uint8 RGB, or (H,W) gray; without lens distortion, as sources give it.
            layout: Where the markers lie.

        Raises:
            MarkersNotSeen: Fewer than two of them are seen.
        """
        return cls.of(find_markers(rgb, layout.dictionary), layout)

    @classmethod
    def of(cls, corners: Corners, layout: MarkerLayout) -> TopView:
        """From corners that ``find_markers`` has found; other markers are left out."""
        seen = [i for i, each in enumerate(layout.ids) if each in corners]
        if len(seen) < min(_LEAST, len(layout.ids)):
            missing = ", ".join(str(each) for each in layout.ids if each not in corners)
            raise MarkersNotSeen(
                f"markers {missing} of {layout.dictionary!r} not seen, "
                f"at least {_LEAST} of {len(layout.ids)} are needed."
            )
        table: Array = layout.array[seen].reshape(-1, 2)
        pixels = np.concatenate([corners[layout.ids[i]] for i in seen])
        homography = np.asarray(cv2.findHomography(table, pixels)[0], np.float64)
        off = _mapped(homography, table) - pixels
        rms = float(np.sqrt(np.mean(np.sum(off * off, axis=1))))
        return cls(homography, layout, tuple(layout.ids[i] for i in seen), rms)

    def to_table(self, pixels: npt.ArrayLike) -> Array:
        """(..., 2) pixels -> (..., 2) metres on the table; NaN stays NaN. What stands above it is seen too far away."""
        return _mapped(np.asarray(np.linalg.inv(self.homography), np.float64), pixels)

    def to_pixels(self, points: npt.ArrayLike) -> Array:
        """(..., 2) metres on the table -> (..., 2) pixels."""
        return _mapped(self.homography, points)

    def warp(
        self, rgb: npt.NDArray[np.uint8], pixels_per_metre: float = 1000.0, margin: float = 0.0
    ) -> npt.NDArray[np.uint8]:
        """The table seen straight from above.

        Args:
            rgb: (H,W,3) uint8.
            pixels_per_metre: Of the picture.
            margin: Metres to show around the markers.

        Returns:
            (h,w,3) uint8: its upper left corner is the layout's least x and y, less the margin; black where the camera
            saw nothing.
        """
        if not (0 < pixels_per_metre < np.inf and 0 <= margin < np.inf):
            raise ValueError(f"warp: expected pixels_per_metre > 0 and margin >= 0, got {pixels_per_metre}, {margin}.")
        low, high = np.array(self.layout.box) + ((-margin,), (margin,))
        width, height = np.maximum(np.round((high - low) * pixels_per_metre), 1).astype(int)
        half = 0.5 / pixels_per_metre  # pixel centres at integers
        to_metres = np.array([[2 * half, 0, low[0] + half], [0, 2 * half, low[1] + half], [0, 0, 1]])
        flags: Any = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        seen = cv2.warpPerspective(rgb, self.homography @ to_metres, (int(width), int(height)), flags=flags)
        return np.asarray(seen, np.uint8)

    def transform_table_to_camera(self, intrinsics: Intrinsics) -> Array:
        """(4,4) metres: p_camera = T p_table, with z = 0 on the table.

        Args:
            intrinsics: Of the image.
        """
        points = self.layout.array[[self.layout.ids.index(each) for each in self.seen]].reshape(-1, 2)
        solid = np.concatenate([points, np.zeros((len(points), 1))], axis=1)
        _, turn, shift = cv2.solvePnP(solid, self.to_pixels(points), intrinsics.matrix, None, flags=cv2.SOLVEPNP_IPPE)
        transform = np.eye(4)
        transform[:3, :3], transform[:3, 3] = cv2.Rodrigues(turn)[0], np.ravel(shift)
        return transform


def _mapped(homography: Array, points: npt.ArrayLike) -> Array:
    array = np.asarray(points, np.float64)
    if array.ndim < 1 or array.shape[-1] != 2:
        raise ValueError(f"expected points of shape (..., 2), got {array.shape}.")
    mapped = array @ homography[:, :2].T + homography[:, 2]
    return mapped[..., :2] / mapped[..., 2:]


_SQUARE = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])


def fourth_marker(corners: Corners, ids: tuple[int, int, int, int]) -> Array:
    """Where the hidden one of four equal markers must be.

    What the camera sees of the table is a homography; it and the rectangle's proportions are fitted to the twelve
    corners that are seen. Each marker may be turned as it likes.

    Args:
        corners: Of three of them, (4,2) pixels each.
        ids: All four, as one goes around the rectangle.

    Returns:
        (4,2) pixels.
    """
    missing = next(i for i, each in enumerate(ids) if each not in corners)
    after, opposite, before = (corners[ids[(missing + step) % 4]] for step in (1, 2, 3))
    middle = opposite.mean(axis=0)
    first, second = after.mean(axis=0) - middle, before.mean(axis=0) - middle
    if first[0] * second[1] - first[1] * second[0] < 0:  # told the other way around: x before y is as in the image
        after, before, first, second = before, after, second, first
    unit = float(np.sqrt(abs(_area(opposite))))
    seen = (np.stack([opposite, after, before]) - middle) / unit
    # The opposite marker's side is the unit of length, its middle the origin; x leads to one neighbour, y to the other.
    reach = np.linalg.norm([first, second], axis=1) / unit
    axes = np.stack([first, second], axis=1) / unit / reach
    turns = [_turn(square, axes) for square in seen]
    start = np.concatenate([axes.ravel(), (0, 0), (0, 0), reach, turns])

    def off(unknown: Array) -> Array:
        _, places = _unpacked(unknown)
        return (places[:3] - seen).ravel()

    found = least_squares(off, start, method="lm")
    return _unpacked(found.x)[1][3] * unit + middle


def _unpacked(unknown: Array) -> tuple[Array, Array]:
    """The homography (3,3), and all four squares (4,4,2) seen through it, the hidden one last."""
    homography = np.array([[*unknown[:2], unknown[4]], [*unknown[2:4], unknown[5]], [*unknown[6:8], 1.0]])
    width, height = unknown[8:10]
    turns = np.array([*unknown[10:13], unknown[10]])
    turned = np.array([[np.cos(turns), -np.sin(turns)], [np.sin(turns), np.cos(turns)]]).transpose(2, 0, 1)
    middles = np.array([(0, 0), (width, 0), (0, height), (width, height)])
    table = np.concatenate([_SQUARE @ turned.transpose(0, 2, 1) + middles[:, None], np.ones((4, 4, 1))], axis=2)
    seen = table @ homography.T
    return homography, seen[..., :2] / seen[..., 2:]


def _turn(square: Array, axes: Array) -> float:
    """By how much a square is turned against the axes, radians."""
    x, y = np.linalg.solve(axes, square[1] - square[0] + square[2] - square[3])
    return float(np.arctan2(y, x))


def _area(square: Array) -> float:
    x, y = square.T
    return float(0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)))
