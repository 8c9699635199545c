"""Keep the finished parts of a long measurement in a folder, so that an interrupted run can continue."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from shape_obs.bench.tables import Row
from shape_obs.utils.documents import read_json
from shape_obs.utils.files import make_folder, write_text


class Parts:
    """A folder ``parts`` with a JSON file for each part.

    Args:
        folder: The folder that contains it; it is made if necessary.
        settings: What determines the results. Parts that were made with other settings are refused.
    """

    def __init__(self, folder: Path, settings: Mapping[str, Any]) -> None:
        self._folder, self._settings = folder / "parts", dict(settings)
        make_folder(self._folder)

    def read(self, name: str) -> list[Row] | None:
        """Return the rows of a part, or None if it is not done.

        Raises:
            ValueError: The file is damaged, or was made with other settings.
        """
        path = self.path(name)
        if not path.exists():
            return None
        document = read_json(path, "results")
        try:
            before, rows = dict(document["made_with"]), [Row(row) for row in document["rows"]]
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path}: not the results of a run ({error!r}): remove it to make them again.") from error
        for setting in {**before, **self._settings}:
            old, new = before.get(setting), self._settings.get(setting)
            if old != new:
                raise ValueError(
                    f"{path} holds results with {setting} = {old}, this run has {new}: choose another folder, or "
                    "remove that one."
                )
        return rows

    def write(self, name: str, rows: Iterable[Mapping[str, Any]]) -> None:
        """Write the rows of a part."""
        path = self.path(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        document = {"made_with": self._settings, "rows": list(rows)}
        write_text(path, json.dumps(document, default=lambda value: value.item()) + "\n")

    def path(self, name: str) -> Path:
        """Return the file of a part; its name may contain folders."""
        return self._folder / f"{name}.json"
