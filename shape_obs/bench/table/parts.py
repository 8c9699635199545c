"""What a run has measured so far, in files: an interrupted run goes on where it stopped."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, TypeVar, cast

from shape_obs.utils.documents import read_json
from shape_obs.utils.files import write_text

T = TypeVar("T")


class Parts:
    """A folder with one small CSV file for each configuration, method and chunk of frames.

    Args:
        folder: Where; made if it is not there.
        settings: What all files of a run have in common. A folder that was begun with others is refused.

    Raises:
        ValueError: The folder holds a run with other settings.
    """

    def __init__(self, folder: Path, settings: Mapping[str, Any]) -> None:
        self._folder, note = folder / "parts", folder / "settings.json"
        if note.exists():
            before = read_json(note, "settings")
            if not isinstance(before, dict):
                raise ValueError(
                    f"{note}: expected the settings of a run, got {type(before).__name__}: remove {folder}."
                )
            for name in [*settings, *before]:
                old, new = before.get(name), settings.get(name)
                if old != new:
                    raise ValueError(
                        f"{folder} holds a run with {name} = {old}, this one has {new}: choose another folder, or "
                        "remove that one."
                    )
        self._folder.mkdir(parents=True, exist_ok=True)
        write_text(note, json.dumps(dict(settings), indent=2) + "\n")

    def has(self, configuration: str, method: str, chunk: int) -> bool:
        """Whether a chunk is done."""
        return self._path(configuration, method, chunk).exists()

    def forget(self, configuration: str, method: str) -> None:
        """Throw away all that was measured of a method."""
        shutil.rmtree(self._path(configuration, method, 0).parent, ignore_errors=True)

    def write(self, configuration: str, method: str, chunk: int, rows: Iterable[Any]) -> None:
        """Write a chunk's rows, instances of a dataclass, whole or not at all."""
        path = self._path(configuration, method, chunk)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, as_csv([asdict(row) for row in rows]))

    def read(self, configuration: str, method: str, chunk: int, kind: type[T]) -> list[T]:
        """Return the rows of a chunk that is done.

        Raises:
            ValueError: Its file is damaged.
        """
        types, path = (
            {field.name: field.type for field in fields(cast(Any, kind))},
            self._path(configuration, method, chunk),
        )
        try:
            with path.open(newline="", encoding="utf-8") as file:
                return [
                    kind(**{name: _parsed(text, types[name]) for name, text in row.items()})
                    for row in csv.DictReader(file)
                ]
        except (KeyError, TypeError, ValueError, csv.Error) as error:
            raise ValueError(
                f"{path}: not the rows of a chunk ({error!r}): remove it to measure them again."
            ) from error

    def _path(self, configuration: str, method: str, chunk: int) -> Path:
        return self._folder / configuration / method / f"{chunk:04d}.csv"


def as_csv(rows: list[dict[str, Any]]) -> str:
    """Rows of equal keys as CSV, the keys first; truth is 1 and 0."""
    lines = [",".join(rows[0])] if rows else []
    lines += [
        ",".join(str(int(value)) if isinstance(value, bool) else str(value) for value in row.values()) for row in rows
    ]
    return "\n".join(lines) + "\n"


def _parsed(text: str, annotation: Any) -> Any:
    """A value as its field is annotated: annotations are strings here."""
    return {"bool": lambda: text == "1", "int": lambda: int(text), "float": lambda: float(text)}[str(annotation)]()
