"""A ChArUco board, which is a chessboard with markers in its white squares, and views of it for a calibration."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.markers import DICTIONARY, dictionary_named
from shape_obs.markers.finder import as_gray
from shape_obs.spec import Spec, SpecError
from shape_obs.utils.lengths import warn_unless_metres

Array = npt.NDArray[np.float64]

FIRST_ID: Final = 20  # first id of the board's markers, which differ from those on the table
_LEAST_CORNERS: Final = 8
_APART: Final = 0.05  # mean difference of the corners of two distinct views, as a share of the image width
_STILL: Final = 0.004  # largest motion between frames of a board that is held still, as a share of the image width
_CELLS: Final = (8, 6)  # cells of the image in which corners are counted


@dataclass(frozen=True)
class Board(Spec):
    """A ChArUco board, as ``shape-obs markers --charuco`` prints it.

    Args:
        columns: Number of squares from left to right.
        rows: Number of squares from top to bottom.
        square: Side of a square in metres.
        marker: Side of a marker's black square in metres.
        dictionary: The marker dictionary; ids start at 20.
    """

    columns: int = 7
    rows: int = 5
    square: float = 0.036
    marker: float = 0.027
    dictionary: str = DICTIONARY

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.columns < 3 or self.rows < 3 or not 0 < self.marker < self.square < np.inf:
            raise SpecError(
                f"Board: expected at least 3 x 3 squares and 0 < marker < square metres, got {self.columns} x "
                f"{self.rows} squares of {self.square} m with markers of {self.marker} m."
            )
        warn_unless_metres("Board: square", self.square, most=1.0, least=0.002, stacklevel=4)
        last, count = FIRST_ID + self.columns * self.rows // 2 - 1, len(dictionary_named(self.dictionary).bytesList)
        if last >= count:
            raise SpecError(f"Board: its markers need the ids {FIRST_ID} to {last}, {self.dictionary!r} has {count}.")

    @property
    def corners(self) -> Array:
        """The points where four squares meet, in the order of their ids, of shape ``(K, 3)``, metres, z = 0."""
        return np.asarray(_board(self).getChessboardCorners(), np.float64)

    def find(self, image: npt.NDArray[np.uint8]) -> tuple[npt.NDArray[np.intp], Array]:
        """Find the visible corners in an image.

        Args:
            image: RGB image ``(H, W, 3)`` or gray image ``(H, W)``, uint8.

        Returns:
            The ids ``(K,)`` and the pixels ``(K, 2)`` of the corners; K is 0 if no board is visible.
        """
        corners, ids, _, _ = _detector(self, threading.get_ident()).detectBoard(as_gray(image))
        if ids is None or corners is None:
            return np.zeros(0, np.intp), np.zeros((0, 2))
        return np.ravel(ids).astype(np.intp), np.asarray(corners, np.float64).reshape(-1, 2)

    def picture(self, pixels_per_metre: float) -> npt.NDArray[np.uint8]:
        """Return a picture of the board without a margin, (h, w), uint8."""
        size = (round(self.columns * self.square * pixels_per_metre), round(self.rows * self.square * pixels_per_metre))
        return np.asarray(_board(self).generateImage(size, marginSize=0, borderBits=1), np.uint8)


@lru_cache(maxsize=8)
def _board(board: Board) -> Any:
    ids = np.arange(FIRST_ID, FIRST_ID + board.columns * board.rows // 2, dtype=np.int32)
    size, dictionary = (board.columns, board.rows), dictionary_named(board.dictionary)
    return cv2.aruco.CharucoBoard(size, board.square, board.marker, dictionary, ids)


@lru_cache(maxsize=8)
def _detector(board: Board, thread: int) -> Any:
    """Return OpenCV's detector, one for each thread because it is not documented as thread-safe."""
    return cv2.aruco.CharucoDetector(_board(board))


class BoardView(NamedTuple):
    """The corners of a board that one image shows.

    Args:
        ids: ``(K,)`` ids of the corners.
        pixels: ``(K, 2)`` pixels of the corners.
    """

    ids: npt.NDArray[np.intp]
    pixels: Array


class BoardViews:
    """Collect views from a sequence of images, and keep those that differ from all previous ones.

    Args:
        board: The board.
        size: ``(H, W)`` of the images.
        still: Accept only views in which the board is held still. A moving board is blurred, and a rolling shutter
            distorts it.

    Attributes:
        taken: The accepted views.
    """

    taken: list[BoardView]

    def __init__(self, board: Board, size: tuple[int, int], still: bool = False) -> None:
        self._board, self._still, self._width = board, still, size[1]
        self.size = size
        self.taken = []
        self._last: BoardView | None = None

    def offer(self, image: npt.NDArray[np.uint8]) -> str:
        """Process an image, and return why its view is rejected; empty if it is accepted.

        Args:
            image: RGB image ``(H, W, 3)`` or gray image ``(H, W)``, uint8.

        Raises:
            ValueError: The size differs from that of the other images.
        """
        if image.shape[:2] != self.size:
            raise ValueError(
                f"expected images of {self.size[1]} x {self.size[0]} pixels, got {image.shape[1]} x {image.shape[0]}."
            )
        view = BoardView(*self._board.find(image))
        before, self._last = self._last, view
        if len(view.ids) < _LEAST_CORNERS:
            return f"{len(view.ids)} corners of the board are visible, at least {_LEAST_CORNERS} are needed"
        if self._still and (before is None or self._moved(before, view) > _STILL):
            return "the board moves: hold it still for a moment"
        if any(self._moved(other, view) < _APART for other in self.taken):
            return "similar to an earlier view: move or tilt the board"
        self.taken.append(view)
        return ""

    @property
    def coverage(self) -> float:
        """Share of the 8 x 6 cells of the image in which a corner was visible, 0...1."""
        return float(self._seen().mean())

    def missing(self) -> str:
        """Return the parts of the image with few corners, in words; empty if there are none."""
        seen = self._seen()
        parts = {
            f"{vertical} {horizontal}": seen[rows, columns].mean()
            for vertical, rows in (("upper", slice(0, 3)), ("lower", slice(3, 6)))
            for horizontal, columns in (("left", slice(0, 4)), ("right", slice(4, 8)))
        }
        return ", ".join(name for name, share in parts.items() if share < 0.5)

    def _seen(self) -> npt.NDArray[np.bool_]:
        seen = np.zeros(_CELLS[::-1], bool)
        for view in self.taken:
            places = (view.pixels + 0.5) / self.size[::-1] * _CELLS
            columns, rows = np.clip(places.astype(int), 0, np.array(_CELLS) - 1).T
            seen[rows, columns] = True
        return seen

    def _moved(self, before: BoardView, now: BoardView) -> float:
        """Return the mean distance of the common corners, as a share of the image width; 1 if there are none."""
        both, first, second = np.intersect1d(before.ids, now.ids, return_indices=True)
        if not len(both):
            return 1.0
        return float(np.linalg.norm(before.pixels[first] - now.pixels[second], axis=1).mean()) / self._width
