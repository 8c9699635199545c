"""``shape-obs markers``: draw a sheet of markers, or a calibration board, to print."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from shape_obs.cli.options import DICTIONARY

if TYPE_CHECKING:
    from shape_obs.calibration import Board


@dataclass(frozen=True)
class Arguments:
    """Draw markers to print, true to scale, as a PDF or PNG file.

    Print the file at 100 %, without 'fit to page', and check the scale at the bottom with a ruler.
    """

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("markers.pdf")
    """The file, *.pdf or *.png."""
    ids: tuple[int, ...] = (0, 1, 2, 3)
    """Ids of the markers."""
    size: float = 60.0
    """Side of a marker's black square in mm."""
    dictionary: str = DICTIONARY
    """Marker dictionary."""
    paper: Literal["a4", "letter"] = "a4"
    """Paper size."""
    charuco: bool = False
    """Draw the board for `calibrate intrinsics` instead."""
    board: tuple[int, int, float, float] | None = None
    """With --charuco: columns, rows, side of a square and side of a marker in mm; default: 7 5 36 27."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return the exit code."""
    args = tyro.cli(Arguments, args=list(argv), prog="shape-obs markers")
    from shape_obs.markers.sheet import PER_MM, board_page, marker_pages, write_pages

    if args.charuco:
        if (args.ids, args.size) != (Arguments.ids, Arguments.size):
            raise ValueError("--ids and --size are for single markers; with --charuco use --board.")
        board = board_from(args.board, args.dictionary)
        text = describe_board(board)
        pages = [board_page(board.picture(1000 * PER_MM), text, args.paper)]
    else:
        if args.board is not None:
            raise ValueError("--board is for a calibration board; give --charuco too.")
        pages = marker_pages(args.ids, args.size, args.dictionary, args.paper)
        text = f"{len(args.ids)} markers of {round(args.size, 1):g} mm"
    write_pages(args.out, pages)
    sheets = "one page" if len(pages) == 1 else f"{len(pages)} pages"
    print(f"wrote {args.out}: {text}, {sheets} of {args.paper}; print at 100 %", file=sys.stderr)
    return 0


def describe_board(board: Board) -> str:
    """Return the description of a board that is printed on its sheet."""
    return (
        f"ChArUco board, {board.columns} x {board.rows} squares of {1000 * board.square:g} mm, "
        f"markers of {1000 * board.marker:g} mm, {board.dictionary}"
    )


def board_from(given: tuple[int, int, float, float] | None, dictionary: str = DICTIONARY) -> Board:
    """Return the board that ``--board`` describes, or the default board without it.

    Args:
        given: Columns, rows, side of a square and side of a marker in mm.
        dictionary: The marker dictionary.
    """
    from shape_obs.calibration import Board

    if given is None:
        return Board(dictionary=dictionary)
    columns, rows, square, marker = given
    return Board(columns, rows, square / 1000, marker / 1000, dictionary)
