"""Map pixels to metres on a table with markers, and find a hidden marker."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraLike, as_intrinsics
from shape_obs.markers.finder import DICTIONARY, Corners, check_ids, find_markers
from shape_obs.spec import Spec, SpecError
from shape_obs.utils.lengths import warn_unless_metres

Corner = tuple[float, float]
Array = npt.NDArray[np.float64]

_LEAST: Final = 2  # markers: with one alone, errors grow large at the far side of a table


@dataclass(frozen=True)
class MarkerLayout(Spec):
    """Markers on a flat table.

    Args:
        ids: The ids of the markers.
        corners: The four corners (x, y) of each marker in metres on the table: its own top left, top right, bottom
            right and bottom left. ``MarkerLayout.rectangle`` computes them for the usual case.
        dictionary: The marker dictionary, see ``find_markers``.
    """

    ids: tuple[int, ...]
    corners: tuple[tuple[Corner, Corner, Corner, Corner], ...]
    dictionary: str = DICTIONARY

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ids(self.ids, self.dictionary)
        if len(self.corners) != len(self.ids) or not self.ids:
            raise SpecError(
                f"MarkerLayout: expected four corners for each of the markers {list(self.ids)}, "
                f"got those of {len(self.corners)}."
            )
        if not np.all(np.isfinite(self.array)):
            raise SpecError("MarkerLayout: corners must be finite numbers of metres.")
        warn_unless_metres("MarkerLayout: corners", self.array, least=0.01, stacklevel=4)

    @classmethod
    def rectangle(
        cls,
        marker: float,
        width: float,
        height: float,
        ids: tuple[int, int, int, int] = (0, 1, 2, 3),
        dictionary: str = DICTIONARY,
    ) -> MarkerLayout:
        """Return the layout of four equal upright markers in the corners of a rectangle, aligned with its sides.

        The origin is the upper left corner of the first marker, x runs along the upper side and y down, so z points
        into the table.

        Args:
            marker: Side of a marker's black square in metres.
            width: Width of the rectangle in metres, between the outer edges of the left and the right markers.
            height: Height of the rectangle in metres, between the outer edges of the upper and the lower markers.
            ids: Top left, top right, bottom right, bottom left.
            dictionary: The marker dictionary.

        Raises:
            SpecError: A size is not positive, or the rectangle is too small for its markers.
        """
        if not (0 < marker < np.inf and 2 * marker <= width < np.inf and 2 * marker <= height < np.inf):
            raise SpecError(
                f"MarkerLayout: expected a rectangle of at least two markers' width and height, "
                f"got markers of {marker} m in {width} x {height} m."
            )
        square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * marker
        places = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * (width - marker, height - marker)
        corners: Any = (places[:, None] + square).tolist()
        return cls(ids, corners, dictionary)

    @property
    def array(self) -> Array:
        """The corners as an array ``(M, 4, 2)``."""
        return np.array(self.corners, np.float64)

    @property
    def box(self) -> tuple[Corner, Corner]:
        """The smallest and the largest (x, y) of all corners in metres."""
        every = self.array.reshape(-1, 2)
        low, high = every.min(axis=0).tolist(), every.max(axis=0).tolist()
        return (low[0], low[1]), (high[0], high[1])


class MarkersNotSeen(ValueError):  # noqa: N818 - a name of the public API
    """Too few of the markers are in the image; the message names those that are missing."""


@dataclass(frozen=True, eq=False)
class TopView:
    """The homography of a flat table in the image of a pinhole camera.

    Args:
        homography: ``(3, 3)`` table -> image: metres (x, y, 1) to homogeneous pixels.
        layout: The positions of the markers.
        seen: The ids of the markers that were found.
        rms: Root mean square distance in pixels of their corners from the layout. More than one pixel means that the
            markers lie elsewhere, or that the lens distorts the image (rectify it first).

    Example:
        >>> view = TopView.find(rgb, MarkerLayout.rectangle(marker=0.06, width=0.6, height=0.4))  # doctest: +SKIP
        >>> view.to_table(shape.points2d)  # (N, 2) metres  # doctest: +SKIP
    """

    homography: Array
    layout: MarkerLayout
    seen: tuple[int, ...]
    rms: float

    @classmethod
    def find(cls, rgb: npt.NDArray[np.uint8], layout: MarkerLayout) -> TopView:
        """Find the markers in an image and compute the homography.

        Args:
            rgb: RGB image (H, W, 3) or gray image (H, W), uint8, without lens distortion, as all sources return it.
            layout: The positions of the markers.

        Raises:
            MarkersNotSeen: Fewer than two of the markers are visible.
        """
        return cls.of(find_markers(rgb, layout.dictionary), layout)

    @classmethod
    def of(cls, corners: Corners, layout: MarkerLayout) -> TopView:
        """Compute the homography from corners that ``find_markers`` returned; other markers are ignored."""
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
        """Map pixels ``(..., 2)`` to metres ``(..., 2)`` on the table; NaN stays NaN.

        Points above the table are mapped too far from the camera.
        """
        return _mapped(np.asarray(np.linalg.inv(self.homography), np.float64), pixels)

    def to_pixels(self, points: npt.ArrayLike) -> Array:
        """Map metres ``(..., 2)`` on the table to pixels ``(..., 2)``."""
        return _mapped(self.homography, points)

    def warp(
        self, rgb: npt.NDArray[np.uint8], pixels_per_metre: float = 1000.0, margin: float = 0.0
    ) -> npt.NDArray[np.uint8]:
        """Return the table seen from straight above.

        Args:
            rgb: The image, ``(H, W, 3)``, uint8.
            pixels_per_metre: Resolution of the result.
            margin: Metres around the markers to include.

        Returns:
            An image (h, w, 3), uint8. Its upper left corner is the smallest x and y of the layout minus the margin;
            parts outside the camera's view are black.
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

    def transform_table_to_camera(self, intrinsics: CameraLike) -> Array:
        """Return the transform ``(4, 4)`` in metres, p_camera = T p_table, with z = 0 on the table.

        Args:
            intrinsics: The intrinsics of the image, which has no lens distortion, in any form with a size.

        Raises:
            ValueError: The intrinsics have distortion.
        """
        lens = as_intrinsics(intrinsics)
        if lens.distorted:
            raise ValueError(
                f"expected the intrinsics of a rectified image, a pinhole, got {lens.model} {lens.coeffs}."
            )
        points = self.layout.array[[self.layout.ids.index(each) for each in self.seen]].reshape(-1, 2)
        solid = np.concatenate([points, np.zeros((len(points), 1))], axis=1)
        _, turn, shift = cv2.solvePnP(solid, self.to_pixels(points), lens.matrix, None, flags=cv2.SOLVEPNP_IPPE)
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
    """Return the corners of the hidden one of four equal markers in the corners of a rectangle.

    The projection of the table is a homography; it and the proportions of the rectangle are fitted to the twelve
    visible corners. Each marker may have its own rotation.

    Args:
        corners: The visible three markers, ``(4, 2)`` pixels each.
        ids: The ids of all four, in order around the rectangle.

    Returns:
        ``(4, 2)`` pixels.
    """
    from scipy.optimize import least_squares

    missing = next(i for i, each in enumerate(ids) if each not in corners)
    after, opposite, before = (corners[ids[(missing + step) % 4]] for step in (1, 2, 3))
    middle = opposite.mean(axis=0)
    first, second = after.mean(axis=0) - middle, before.mean(axis=0) - middle
    if first[0] * second[1] - first[1] * second[0] < 0:  # the ids run the other way round
        after, before, first, second = before, after, second, first
    unit = float(np.sqrt(abs(_area(opposite))))
    seen = (np.stack([opposite, after, before]) - middle) / unit
    # The side of the opposite marker is the unit of length and its middle the origin; x leads to one neighbour, y to
    # the other.
    reach = np.linalg.norm([first, second], axis=1) / unit
    axes = np.stack([first, second], axis=1) / unit / reach
    turns = [_turn(square, axes) for square in seen]
    start = np.concatenate([axes.ravel(), (0, 0), (0, 0), reach, turns])
    found = least_squares(lambda unknown: (_squares(unknown)[:3] - seen).ravel(), start, method="lm")
    return _squares(found.x)[3] * unit + middle


def _squares(unknown: Array) -> Array:
    """Return all four markers seen through a homography, of shape ``(4, 4, 2)``, the hidden one last.

    Args:
        unknown: (13,) eight entries of the homography, width and height of the rectangle, rotations of the visible
            markers in radians.
    """
    homography = np.array([[*unknown[:2], unknown[4]], [*unknown[2:4], unknown[5]], [*unknown[6:8], 1.0]])
    width, height = unknown[8:10]
    turns = np.array([*unknown[10:13], unknown[10]])
    turned = np.array([[np.cos(turns), -np.sin(turns)], [np.sin(turns), np.cos(turns)]]).transpose(2, 0, 1)
    middles = np.array([(0, 0), (width, 0), (0, height), (width, height)])
    table = np.concatenate([_SQUARE @ turned.transpose(0, 2, 1) + middles[:, None], np.ones((4, 4, 1))], axis=2)
    seen = table @ homography.T
    return seen[..., :2] / seen[..., 2:]


def _turn(square: Array, axes: Array) -> float:
    """Return the rotation of a square against the axes, in radians."""
    x, y = np.linalg.solve(axes, square[1] - square[0] + square[2] - square[3])
    return float(np.arctan2(y, x))


def _area(square: Array) -> float:
    x, y = square.T
    return float(0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)))
