"""The files of a study: tables, for people and for programs."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from shape_obs.bench.servo.study import Found
from shape_obs.bench.servo.summary import episode_rows, paired_rows, summary_rows
from shape_obs.utils.files import write_text

Row = Mapping[str, Any]

_IF_ANY: Final = ("failed", "invalid")


def write_tables(found: Found, folder: Path) -> None:
    """Write ``episodes.csv``, ``summary.csv`` and ``table.md``, and ``paired.csv`` where there are pairs."""
    rows, pairs = summary_rows(found), paired_rows(found)
    write_text(folder / "episodes.csv", as_csv(episode_rows(found)))
    write_text(folder / "summary.csv", as_csv(rows))
    if pairs:
        write_text(folder / "paired.csv", as_csv(pairs))
    page = "# Shape servoing\n\n" + as_markdown(lean(rows))
    if pairs:
        page += "\n\n## The camera beside the true points\n\n" + as_markdown(lean(pairs))
    write_text(folder / "table.md", page + "\n")


def lean(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Rows without the columns that hold nothing: no disturbance, no failure, no detector."""
    if not rows:
        return []
    kept = [name for name in rows[0] if any(row[name] not in (None, "") for row in rows)]
    kept = [name for name in kept if name not in _IF_ANY or any(row[name] for row in rows)]
    return [{name: row[name] for name in kept} for row in rows]


def as_csv(rows: Sequence[Row]) -> str:
    """Rows of equal keys, the keys first; None is an empty cell."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def as_markdown(rows: Sequence[Row]) -> str:
    """Rows of equal keys as a table in Markdown, shares and millimetres to one decimal."""
    names = list(rows[0])
    numeric = [all(isinstance(row[name], (int, float, type(None))) for row in rows) for name in names]
    lines = [names, ["---:" if right else "---" for right in numeric]]
    lines += [[_cell(value) for value in row.values()] for row in rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 10 else f"{value:.0f}"
    return str(value)
