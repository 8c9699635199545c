"""Touches: where a robot's tool tip was when it touched a marker's corner, and the files that hold them."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from shape_obs.documents import parse_json
from shape_obs.files import write_text
from shape_obs.spec import Spec, SpecError

FIELDS: Final = ("marker", "corner", "x", "y", "z")
CORNERS: Final = ("top left", "top right", "bottom right", "bottom left")


@dataclass(frozen=True)
class Touch(Spec):
    """One touch.

    Args:
        marker: Its id.
        corner: 0...3: the marker's own top left, top right, bottom right, bottom left.
        x: Of the tool tip in the base frame, metres.
        y: The same.
        z: The same.
    """

    marker: int
    corner: int
    x: float
    y: float
    z: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.corner not in range(4):
            raise SpecError(f"corner: expected 0 to 3 ({', '.join(CORNERS)}), got {self.corner}.")
        if not np.all(np.isfinite((self.x, self.y, self.z))):
            raise SpecError(f"x, y, z: expected finite metres, got {self.x}, {self.y}, {self.z}.")
        if max(abs(self.x), abs(self.y), abs(self.z)) > 10:
            raise SpecError(f"x, y, z: expected metres, got {self.x}, {self.y}, {self.z}; are they millimetres?")

    @property
    def name(self) -> str:
        """In words."""
        return f"marker {self.marker}, corner {self.corner} ({CORNERS[self.corner]})"


def read_touches(path: str | Path) -> list[Touch]:
    """Read a CSV file with the header ``marker,corner,x,y,z``, or a JSON list of such objects; metres, base frame.

    Raises:
        FileNotFoundError: There is no such file.
        SpecError: The message names the row and what is wrong with it.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{path}: no such file of touches") from error
    except UnicodeDecodeError as error:
        raise SpecError(f"{path}: expected a CSV or JSON file of touches: {error}") from error
    rows = _json_rows(path, text) if path.suffix == ".json" else _csv_rows(path, text)
    if not rows:
        raise SpecError(f"{path}: holds no touches.")
    return [_touch(f"{path}: {number}", row) for number, row in rows]


def write_touches(path: str | Path, touches: Iterable[Touch]) -> None:
    """Write them as CSV, whole or not at all."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(FIELDS)
    writer.writerows([touch.to_dict()[name] for name in FIELDS] for touch in touches)
    write_text(Path(path), text.getvalue())


def _touch(where: str, row: Any) -> Touch:
    try:
        return Touch.from_dict(row)
    except SpecError as error:
        raise SpecError(f"{where}: {error}") from error


def _json_rows(path: Path, text: str) -> list[tuple[str, Any]]:
    rows = parse_json(text, str(path))
    if not isinstance(rows, list):
        raise SpecError(f"{path}: expected a list of touches, got {type(rows).__name__}.")
    return [(f"touch {number}", row) for number, row in enumerate(rows, start=1)]


def _csv_rows(path: Path, text: str) -> list[tuple[str, Any]]:
    try:
        return _checked_rows(path, csv.DictReader(io.StringIO(text), skipinitialspace=True))
    except csv.Error as error:
        raise SpecError(f"{path}: expected a CSV file of touches: {error}") from error


def _checked_rows(path: Path, reader: csv.DictReader[str]) -> list[tuple[str, Any]]:
    if [name.strip() for name in reader.fieldnames or ()] != list(FIELDS):
        raise SpecError(f"{path}: expected the header {','.join(FIELDS)}, got {','.join(reader.fieldnames or ())}.")
    return [(f"line {reader.line_num}", _numbers(path, reader.line_num, row)) for row in reader]


def _numbers(path: Path, line: int, row: Mapping[Any, Any]) -> dict[str, float]:
    try:
        return {name.strip(): float(value) for name, value in row.items()}
    except (TypeError, ValueError, AttributeError) as error:
        given = ",".join(str(value) for value in row.values())
        raise SpecError(f"{path}: line {line}: expected five numbers ({','.join(FIELDS)}), got {given}.") from error
