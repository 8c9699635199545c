"""Finished: what the done runs of a study reached."""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from shape_obs.ablation.folder import done_runs
from shape_obs.ablation.run import Row
from shape_obs.ablation.score import Score
from shape_obs.ablation.scores_file import COLUMNS, SCORES, cells, read_scores
from shape_obs.ablation.study import Study
from shape_obs.utils.files import write_whole

RESULTS: Final = "results.csv"


class Finished:
    """A done run and its scores.

    Args:
        arm: Name of its arm.
        seed: Of the training.
        rows: Its scores.
        about: What ``run.json`` tells.

    Attributes:
        steps: Steps of training before each evaluation without disturbance, ascending.
        disturbances: In which it was tried out besides.
    """

    def __init__(self, arm: str, seed: int, rows: Sequence[Row], about: dict[str, Any]) -> None:
        self.arm, self.seed, self.rows, self.about = arm, seed, tuple(rows), about
        self._scores = defaultdict[tuple[str, int, str], list[Score]](list)
        for row in rows:
            self._scores[row.disturbance, row.steps, row.score.difficulty].append(row.score)
        self.steps = sorted({row.steps for row in rows if not row.disturbance})
        self.disturbances = tuple(dict.fromkeys(row.disturbance for row in rows if row.disturbance))

    def scores(self, difficulty: str, steps: int | None = None, disturbance: str = "") -> list[Score]:
        """Of one evaluation; of the last where no ``steps`` are given."""
        return self._scores[disturbance, self.steps[-1] if steps is None else steps, difficulty]

    def success(self, difficulty: str, steps: int | None = None, disturbance: str = "") -> float:
        """Goals that were reached, in per cent."""
        return 100.0 * float(np.mean([score.success for score in self.scores(difficulty, steps, disturbance)]))

    def final_mm(self, difficulty: str) -> float:
        """Mean distance of the true points from the true goal's in the end, over all goals, millimetres."""
        return float(np.mean([score.final_mm for score in self.scores(difficulty)]))

    def ms_acting(self) -> float:
        """What a step took in the last evaluation, with environment and policy; median over its episodes."""
        return float(
            np.median([row.score.ms for row in self.rows if not row.disturbance and row.steps == self.steps[-1]])
        )


def finished(study: Study, root: Path) -> list[Finished]:
    """The done runs in a study's folder, in the order of its arms and of seeds.

    Raises:
        ValueError: One was made with another configuration, or cannot be read.
    """
    runs = []
    for folder in done_runs(study, root):
        about = folder.about()
        assert about is not None
        runs.append(Finished(folder.arm, folder.seed, read_scores(folder.check(SCORES)), about))
    return runs


def write_results(runs: Sequence[Finished], root: Path) -> Path:
    """Write the scores of all runs into one long table, ``results.csv``; returns its path."""

    def write(path: Path) -> None:
        with path.open("w", encoding="utf-8", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(("arm", "seed", *COLUMNS))
            table.writerows((run.arm, run.seed, *cells(row)) for run in runs for row in run.rows)

    write_whole(root / RESULTS, write)
    return root / RESULTS
