"""Check the options of the measurements, print their tables, and show their progress."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Any

from tqdm import tqdm

from shape_obs.utils.errors import UsageError, install_hint
from tests.benchmarks.tables import as_text

Rows = Sequence[Mapping[str, Any]]


class Output:
    """Print each table when it is complete, or one JSON document at the end.

    Args:
        as_json: Whether to print JSON.
        document: The first entries of the document.
    """

    def __init__(self, as_json: bool, **document: Any) -> None:
        self.as_json, self.document = as_json, document

    def note(self, text: str) -> None:
        """Print a line, unless JSON is printed."""
        if not self.as_json:
            tqdm.write(text, file=sys.stdout)

    def table(self, title: str, rows: Rows, key: str | None = None) -> None:
        """Add rows to the document under a key, by default the title, and print them under the title."""
        if key != "":
            self.document[title if key is None else key] = rows
        if rows:
            self.note(f"\n{title}\n{as_text(rows)}")

    def claims(self, rows: Rows) -> None:
        """Add the rows that compare results with their targets."""
        self.table("asked and seen", rows, "claims")

    def close(self) -> None:
        """Print the document if JSON is asked for."""
        if self.as_json:
            print(json.dumps(self.document, indent=2))


def progress(name: str, unit: str, total: int | None = None) -> tqdm:
    """Return a progress bar on stderr that vanishes at the end."""
    return tqdm(desc=name, unit=unit, total=total, leave=False, file=sys.stderr)


def need_matplotlib() -> None:
    """Raise ImportError if matplotlib is not installed."""
    if find_spec("matplotlib") is None:
        raise ImportError(f"the figures need matplotlib: {install_hint('viz')}, or leave them out (see --help).")


def image_size(text: str, least: int, landscape: bool = True) -> tuple[int, int]:
    """Return (width, height) from text such as ``"640x480"``.

    Args:
        text: The option's value.
        least: The smallest width and height in pixels.
        landscape: Whether an image may not be higher than wide.

    Raises:
        UsageError: The text is not such a size.
    """
    width, x, height = text.partition("x")
    if x and width.isdigit() and height.isdigit():
        size = int(width), int(height)
        if least <= min(size) and max(size) <= 4096 and not (landscape and size[1] > size[0]):
            return size
    form = ", no higher than wide" if landscape else ""
    raise UsageError(
        f"--sizes: expected WIDTHxHEIGHT of at least {least} pixels each{form}, such as 640x480, got {text!r}."
    )
