"""A board as the command line describes it."""

from __future__ import annotations

from shape_obs.calibration import Board
from shape_obs.markers import DICTIONARY


def board_from(given: tuple[int, int, float, float] | None, dictionary: str = DICTIONARY) -> Board:
    """Columns, rows, side of a square and of a marker in mm; the default board where nothing is given."""
    if given is None:
        return Board(dictionary=dictionary)
    columns, rows, square, marker = given
    return Board(columns, rows, square / 1000, marker / 1000, dictionary)
