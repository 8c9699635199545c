"""Scores as CSV: a line for each episode."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from shape_obs.ablation.run import Row
from shape_obs.ablation.score import Score

SCORES: Final = "scores.csv"
COLUMNS: Final = ("steps", "disturbance", "difficulty", "goal", "start_mm", "final_mm", "success", "ms")


def scores_csv(rows: Iterable[Row]) -> str:
    """The file's text; ``goal`` is the seed of start and goal, millimetres have four digits behind the point."""
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow(COLUMNS)
    table.writerows(cells(row) for row in rows)
    return out.getvalue()


def cells(row: Row) -> tuple[object, ...]:
    """A line of the file, in the order of ``COLUMNS``."""
    score = row.score
    return (
        row.steps, row.disturbance, score.difficulty, score.seed,
        f"{score.start_mm:.4f}", f"{score.final_mm:.4f}", int(score.success), f"{score.ms:.3f}",
    )  # fmt: skip


def read_scores(path: Path) -> list[Row]:
    """The scores of a file.

    Raises:
        FileNotFoundError: There is none.
        ValueError: It is none.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [_row(line) for line in csv.DictReader(file)]
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise ValueError(f"{path}: expected a table of {', '.join(COLUMNS)} ({error!r}).") from error
    if not rows:
        raise ValueError(f"{path}: expected a score in each line, it has none.")
    return rows


def _row(line: dict[str, str]) -> Row:
    score = Score(
        line["difficulty"], int(line["goal"]), float(line["start_mm"]), float(line["final_mm"]),
        bool(int(line["success"])), float(line["ms"]),
    )  # fmt: skip
    return Row(int(line["steps"]), line["disturbance"], score)
