"""``shape-obs markers``: draw a sheet of markers, or a calibration board, to print."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from shape_obs.cli.options import DICTIONARY
from shape_obs.cli.outputs import Overwrite, check_outputs
from shape_obs.cli.parsing import Option, parse, wrong_usage
from shape_obs.utils.errors import UsageError

if TYPE_CHECKING:
    from shape_obs.calibration import Board


@dataclass(frozen=True)
class Arguments:
    """Draw markers to print, true to scale, as a PDF or PNG file.

    Print the file at 100 %, without 'fit to page', and check the scale at the bottom with a ruler.
    """

    out: Annotated[Path, Option("FILE", "output", "-o")] = Path("markers.pdf")
    """The file, *.pdf or *.png."""
    ids: Annotated[tuple[int, ...], Option("ID ...", "marker", least=0)] = (0, 1, 2, 3)
    """Ids of the markers."""
    size: Annotated[float, Option("MM", "marker", above=0)] = 60.0
    """Side of a marker's black square in mm."""
    dictionary: Annotated[str, Option("NAME", "marker")] = DICTIONARY
    """Marker dictionary."""
    overwrite: Overwrite = False
    """Replace existing files."""
    paper: Annotated[Literal["a4", "letter"], Option(group="output")] = "a4"
    """Paper size."""
    charuco: Annotated[bool, Option(group="board")] = False
    """Draw the board for `calibrate intrinsics` instead."""
    board: Annotated[tuple[int, int, float, float] | None, Option("COLUMNS ROWS SQUARE MARKER", "board", above=0)] = (
        None
    )
    """With --charuco: columns, rows, side of a square and side of a marker in mm; default: 7 5 36 27."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return the exit code."""
    args = parse(Arguments, argv, "shape-obs markers", _check)
    check_outputs(args, args.out)
    from shape_obs.markers.sheet import PER_MM, board_page, marker_pages, write_pages

    if args.charuco:
        with wrong_usage():
            board = board_from(args.board, args.dictionary)
            text = describe_board(board)
            pages = [board_page(board.picture(1000 * PER_MM), text, args.paper)]
    else:
        with wrong_usage():
            pages = marker_pages(args.ids, args.size, args.dictionary, args.paper)
        text = f"{len(args.ids)} markers of {round(args.size, 1):g} mm"
    write_pages(args.out, pages)
    sheets = "one page" if len(pages) == 1 else f"{len(pages)} pages"
    print(f"wrote {args.out}: {text}, {sheets} of {args.paper}; print at 100 %", file=sys.stderr)
    return 0


def _check(args: Arguments) -> None:
    """Reject options that do not go together, before OpenCV is imported."""
    if args.out.suffix.lower() not in (".pdf", ".png"):
        raise UsageError(f"--out: expected a file named *.pdf or *.png, got {args.out}.")
    if args.charuco and (args.ids, args.size) != (Arguments.ids, Arguments.size):
        raise UsageError("--ids and --size are for single markers; with --charuco use --board.")
    if args.board is not None and not args.charuco:
        raise UsageError("--board is for a calibration board; give --charuco too.")


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
