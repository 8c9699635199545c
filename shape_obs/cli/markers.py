"""``shape-obs markers``: a sheet of markers, or a calibration board, to print.

A board as the command line describes it.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from shape_obs.calibration import Board
from shape_obs.markers import DICTIONARY
from shape_obs.markers.sheet import PER_MM, board_page, marker_pages, write_pages


@dataclass(frozen=True)
class Arguments:
    """Draw markers to print, true to scale: a PDF or a PNG.

    Print it at 100 %, without 'fit to page', and check the scale at its foot with a ruler.
    """

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("markers.pdf")
    """Where to: a name that ends in .pdf or .png."""
    ids: tuple[int, ...] = (0, 1, 2, 3)
    """Which markers."""
    size: float = 60.0
    """Side of a marker's black square, mm."""
    dictionary: str = DICTIONARY
    """Which family of markers."""
    paper: Literal["a4", "letter"] = "a4"
    """The sheet's size."""
    charuco: bool = False
    """Draw the board for `calibrate intrinsics` instead."""
    board: tuple[int, int, float, float] | None = None
    """With --charuco: columns, rows, side of a square and of a marker in mm; default 7 5 36 27."""


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    args = tyro.cli(Arguments, args=list(argv), prog="shape-obs markers")
    if args.charuco:
        if (args.ids, args.size) != (Arguments.ids, Arguments.size):
            raise ValueError("--ids and --size describe markers: with --charuco give --board.")
        board = board_from(args.board, args.dictionary)
        pages, told = [board_page(board.picture(1000 * PER_MM), board_words(board), args.paper)], board_words(board)
    else:
        if args.board is not None:
            raise ValueError("--board describes a board: give --charuco with it.")
        pages = marker_pages(args.ids, args.size, args.dictionary, args.paper)
        told = f"{len(args.ids)} markers of {round(args.size, 1):g} mm"
    write_pages(args.out, pages)
    sheets = "one page" if len(pages) == 1 else f"{len(pages)} pages"
    print(f"wrote {args.out}: {told}, {sheets} of {args.paper}; print at 100 %", file=sys.stderr)
    return 0


def board_words(board: Board) -> str:
    """What the sheet says about its board."""
    return (
        f"ChArUco board, {board.columns} x {board.rows} squares of {1000 * board.square:g} mm, "
        f"markers of {1000 * board.marker:g} mm, {board.dictionary}"
    )


def board_from(given: tuple[int, int, float, float] | None, dictionary: str = DICTIONARY) -> Board:
    """Columns, rows, side of a square and of a marker in mm; the default board where nothing is given."""
    if given is None:
        return Board(dictionary=dictionary)
    columns, rows, square, marker = given
    return Board(columns, rows, square / 1000, marker / 1000, dictionary)
