"""Views of a board that differ enough to calibrate a camera with."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.calibration.board import Board

Array = npt.NDArray[np.float64]

_LEAST_CORNERS: Final = 8
_APART: Final = 0.05  # of the image's width, by which corners of two views differ on the mean
_STILL: Final = 0.004  # of it, by which a board that is held still moves from one frame to the next
_CELLS: Final = (8, 6)  # of the image, in which corners are counted


class BoardView(NamedTuple):
    """The corners of a board that one image shows.

    Args:
        ids: (K,) of the corners.
        pixels: (K,2).
    """

    ids: npt.NDArray[np.intp]
    pixels: Array


class BoardViews:
    """Collects views, one image after another, and takes those that differ from all before.

    Args:
        board: What to look for.
        size: (H, W) of the images.
        still: Take only what is held still: a moving board is blurred, and a camera that reads line by line bends it.

    Attributes:
        taken: The views.
    """

    def __init__(self, board: Board, size: tuple[int, int], still: bool = False) -> None:
        self._board, self._still, self._width = board, still, size[1]
        self.size = size
        self.taken: list[BoardView] = []
        self._last: BoardView | None = None

    def offer(self, image: npt.NDArray[np.uint8]) -> str:
        """Look at an image; returns why it is not taken, empty if it is.

        Args:
            image: (H,W,3) RGB or (H,W) gray, uint8.

        Raises:
            ValueError: Of another size than the images before.
        """
        if image.shape[:2] != self.size:
            raise ValueError(
                f"expected images of {self.size[1]} x {self.size[0]} pixels, got {image.shape[1]} x {image.shape[0]}."
            )
        view = BoardView(*self._board.find(image))
        before, self._last = self._last, view
        if len(view.ids) < _LEAST_CORNERS:
            return f"{len(view.ids)} corners of the board are seen, at least {_LEAST_CORNERS} are needed"
        if self._still and (before is None or self._moved(before, view) > _STILL):
            return "the board moves: hold it still for a moment"
        if any(self._moved(other, view) < _APART for other in self.taken):
            return "much like a view before: move or tilt the board"
        self.taken.append(view)
        return ""

    @property
    def coverage(self) -> float:
        """Share of the image's 8 x 6 cells in which a corner was seen, 0...1."""
        return float(self._seen().mean())

    def missing(self) -> str:
        """Where in the image few corners were seen, in words; empty where they are everywhere."""
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
        """Mean distance of the corners in both, as a share of the image's width; 1 where they share none."""
        both, first, second = np.intersect1d(before.ids, now.ids, return_indices=True)
        if not len(both):
            return 1.0
        return float(np.linalg.norm(before.pixels[first] - now.pixels[second], axis=1).mean()) / self._width
