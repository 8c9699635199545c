"""Board: a ChArUco board, a chessboard with markers in its white squares."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.markers import DICTIONARY, dictionary_named
from shape_obs.markers.finder import as_gray
from shape_obs.spec import Spec, SpecError

Array = npt.NDArray[np.float64]

FIRST_ID: Final = 20  # of the board's markers, so that they are none of those that lie on the table


@dataclass(frozen=True)
class Board(Spec):
    """A ChArUco board, as ``shape-obs markers --charuco`` prints it.

    Args:
        columns: Squares from left to right.
        rows: Squares from top to bottom.
        square: Side of a square, metres.
        marker: Side of a marker's black square, metres.
        dictionary: Which markers they are; their ids start at 20.
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
        last, count = FIRST_ID + self.columns * self.rows // 2 - 1, len(dictionary_named(self.dictionary).bytesList)
        if last >= count:
            raise SpecError(f"Board: its markers need the ids {FIRST_ID} to {last}, {self.dictionary!r} has {count}.")

    @property
    def corners(self) -> Array:
        """(K,3) metres, z = 0: where four squares meet, by their ids."""
        return np.asarray(_board(self).getChessboardCorners(), np.float64)

    def find(self, image: npt.NDArray[np.uint8]) -> tuple[npt.NDArray[np.intp], Array]:
        """The corners that are seen in an image.

        Args:
            image: (H,W,3) RGB or (H,W) gray, uint8.

        Returns:
            (K,) their ids, and (K,2) their pixels; K = 0 where no board is seen.
        """
        corners, ids, _, _ = _detector(self, threading.get_ident()).detectBoard(as_gray(image))
        if ids is None or corners is None:
            return np.zeros(0, np.intp), np.zeros((0, 2))
        return np.ravel(ids).astype(np.intp), np.asarray(corners, np.float64).reshape(-1, 2)

    def picture(self, pixels_per_metre: float) -> npt.NDArray[np.uint8]:
        """(h,w) uint8: the board without a margin."""
        size = (round(self.columns * self.square * pixels_per_metre), round(self.rows * self.square * pixels_per_metre))
        return np.asarray(_board(self).generateImage(size, marginSize=0, borderBits=1), np.uint8)


@lru_cache(maxsize=8)
def _board(board: Board) -> Any:
    ids = np.arange(FIRST_ID, FIRST_ID + board.columns * board.rows // 2, dtype=np.int32)
    size, dictionary = (board.columns, board.rows), dictionary_named(board.dictionary)
    return cv2.aruco.CharucoBoard(size, board.square, board.marker, dictionary, ids)


@lru_cache(maxsize=8)
def _detector(board: Board, thread: int) -> Any:
    """OpenCV's detector; one a thread, since nobody promises that it may be shared."""
    return cv2.aruco.CharucoDetector(_board(board))
