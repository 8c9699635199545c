"""Draw sheets to print, true to scale: markers for a table, or a board for calibration."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from shape_obs.markers.finder import DICTIONARY, check_ids, dictionary_named
from shape_obs.utils.files import write_whole

Paper = Literal["a4", "letter"]
Page = npt.NDArray[np.uint8]

PAPERS: Final[dict[str, tuple[float, float]]] = {"a4": (210.0, 297.0), "letter": (215.9, 279.4)}  # mm, upright
PER_MM: Final = 10  # pixels per millimetre; sizes are multiples of 0.1 mm, so that nothing is rounded
DPI: Final = 25.4 * PER_MM
_EDGE: Final = 10.0  # mm that a printer may not print
_FOOT: Final = 18.0  # mm for the scale and the text
_QUIET: Final = 1.0  # smallest white margin around a marker, in cells
_LABEL: Final = 6.0  # mm below a marker
_SCALE: Final = 100  # mm
_INK: Final = 0


def marker_pages(ids: Sequence[int], size: float, dictionary: str = DICTIONARY, paper: Paper = "a4") -> list[Page]:
    """Draw pages of markers with their ids and sizes, cutting lines, and a scale to check the print.

    Args:
        ids: The ids of the markers.
        size: Side of a marker's black square in mm, rounded to a tenth.
        dictionary: The marker dictionary.
        paper: The paper size.

    Returns:
        Pages (h, w), uint8, with 10 pixels per millimetre.

    Raises:
        ValueError: An id is not in the dictionary, or the size does not fit on the paper.
    """
    check_ids(ids, dictionary)
    cells = 2 + dictionary_named(dictionary).markerSize
    size = round(size, 1)
    quiet = max(_QUIET * size / cells, 4.0)
    width, height = PAPERS[paper]
    step_x, step_y = size + 2 * quiet, size + 2 * quiet + _LABEL
    columns, rows = int((width - 2 * _EDGE) // step_x), int((height - 2 * _EDGE - _FOOT) // step_y)
    if not size >= cells:
        raise ValueError(f"markers of {size:g} mm are too small to print: give at least {cells} mm, one for each cell.")
    if columns < 1 or rows < 1:
        most = min(width - 2 * _EDGE, height - 2 * _EDGE - _FOOT - _LABEL) * cells / (cells + 2 * _QUIET)
        raise ValueError(f"a marker of {size:g} mm does not fit on {paper} paper: give at most {most:.0f} mm.")
    pages = []
    for begin in range(0, len(ids), columns * rows):
        page = _blank(width, height)
        for place, each in enumerate(ids[begin : begin + columns * rows]):
            left = (width - columns * step_x) / 2 + place % columns * step_x
            top = _EDGE + place // columns * step_y
            _put_marker(page, each, size, dictionary, left + quiet, top + quiet)
            _frame(page, left, top, step_x, step_y)
            _write(page, f"{dictionary}  id {each}  {size:g} mm", left + quiet, top + 2 * quiet + size + 0.5, 3.2)
        _foot(page, "Lay the markers flat, all the same way up. Corners 0, 1, 2, 3 run clockwise from the top left.")
        pages.append(page)
    return pages


def board_page(board: Page, words: str, paper: Paper = "a4") -> Page:
    """Draw a landscape page with a board.

    Args:
        board: Picture of the board (h, w), uint8, with 10 pixels per millimetre.
        words: A description of the board.
        paper: The paper size.

    Raises:
        ValueError: The board does not fit on the paper.
    """
    height, width = PAPERS[paper]
    high, wide = board.shape
    room = (height - 4 - _FOOT) * PER_MM, (width - 2 * _EDGE) * PER_MM
    if high > room[0] or wide > room[1]:
        raise ValueError(
            f"the board of {wide / PER_MM:g} x {high / PER_MM:g} mm does not fit on {paper} paper: "
            f"it has room for {room[1] / PER_MM:g} x {room[0] / PER_MM:g} mm."
        )
    page = _blank(width, height)
    left, top = (page.shape[1] - wide) // 2, 4 * PER_MM + int(room[0] - high) // 2
    page[top : top + high, left : left + wide] = board
    _foot(page, words)
    return page


def write_pages(path: Path, pages: Sequence[Page]) -> None:
    """Write pages as a PDF, or one page as a PNG that contains its resolution; completely or not at all.

    Raises:
        ValueError: The suffix is not .pdf or .png, or there are several pages for a PNG.
        OSError: The file cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix not in (".pdf", ".png"):
        raise ValueError(f"{path}: expected a name that ends in .pdf or .png, got {path.suffix or 'none'}.")
    if suffix == ".png" and len(pages) > 1:
        raise ValueError(f"{path}: {len(pages)} pages do not fit into a PNG: write a .pdf, or take smaller markers.")
    # With one bit per pixel, a PDF stores the pages without loss.
    first, *others = [Image.fromarray(page).convert("1", dither=Image.Dither.NONE) for page in pages]
    if suffix == ".pdf":
        options: dict[str, Any] = {"resolution": DPI, "save_all": True, "append_images": others}
        write_whole(path, lambda temporary: first.save(temporary, "PDF", **options))
    else:
        write_whole(path, lambda temporary: first.save(temporary, "PNG", dpi=(DPI, DPI)))


def _blank(width: float, height: float) -> Page:
    return np.full((round(height * PER_MM), round(width * PER_MM)), 255, np.uint8)


def _put_marker(page: Page, each: int, size: float, dictionary: str, left: float, top: float) -> None:
    side = round(size * PER_MM)
    marker = cv2.aruco.generateImageMarker(dictionary_named(dictionary), each, side, borderBits=1)
    row, column = round(top * PER_MM), round(left * PER_MM)
    page[row : row + side, column : column + side] = marker


def _frame(page: Page, left: float, top: float, width: float, height: float) -> None:
    """Draw a faint dotted line to cut along."""
    a, b, c, d = (round(value * PER_MM) for value in (left, top, left + width, top + height))
    for row in (b, d):
        page[row, a:c:8] = _INK
    for column in (a, c):
        page[b:d:8, column] = _INK


def _foot(page: Page, words: str) -> None:
    """Draw a scale of 100 mm at the bottom, with its explanation."""
    height = len(page)
    left, line = round(_EDGE * PER_MM), height - round(9 * PER_MM)
    page[line : line + 3, left : left + _SCALE * PER_MM + 1] = _INK
    for tick in range(0, _SCALE + 1, 5):
        length = (4 if tick % 50 == 0 else 3 if tick % 10 == 0 else 1.5) * PER_MM
        column = left + tick * PER_MM
        page[line - round(length) : line, column - 1 : column + 2] = _INK
    text_left = (left / PER_MM) + _SCALE + 4
    _write(page, f"This line is {_SCALE} mm long. If it is not: print again", text_left, line / PER_MM - 6.5, 3.0)
    _write(page, "at 100 %, without 'fit to page'.", text_left, line / PER_MM - 2.5, 3.0)
    _write(page, words, left / PER_MM, line / PER_MM + 1.5, 3.0)


def _write(page: Page, words: str, left: float, top: float, height: float) -> None:
    """Write text with letters of a height in mm, in place."""
    picture = Image.fromarray(page)
    font = ImageFont.load_default(round(1.3 * height * PER_MM))
    ImageDraw.Draw(picture).text((round(left * PER_MM), round(top * PER_MM)), words, fill=_INK, font=font)
    page[:] = np.asarray(picture)
