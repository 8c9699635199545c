"""Store the results of runs in folders, and read them again."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import shutil
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from shape_obs.ablation.executors import PROGRESS, Outcome
from shape_obs.ablation.scores import COLUMNS, SCORES, Row, Score, cells, read_scores
from shape_obs.ablation.study import Study
from shape_obs.utils.documents import read_json
from shape_obs.utils.files import listing, make_folder, write_whole

RESULTS: Final = "results.csv"
RUN: Final = "run.json"
ERROR: Final = "error.txt"


@dataclass(frozen=True)
class RunFolder:
    """The folder ``ROOT/ARM/seedK`` of a run. The run is finished when ``run.json`` exists, which is written last.

    Args:
        root: Folder of the study.
        arm: Name of the arm.
        seed: Seed of the training.
    """

    root: Path
    arm: str
    seed: int

    @property
    def path(self) -> Path:
        """Path of the folder."""
        return self.root / self.arm / f"seed{self.seed}"

    def clear(self) -> None:
        """Make the folder, and remove the files of an interrupted run.

        Raises:
            FileExistsError: It holds something else.
        """
        if self.path.is_dir():
            names = {path.name for path in listing(self.path)}
            if names and not names & {PROGRESS, ERROR}:
                raise FileExistsError(f"{self.path} holds no run of a study: choose another folder, or move it away.")
            shutil.rmtree(self.path)
        make_folder(self.path)

    def steps(self) -> int:
        """Return the number of steps that a run in progress has written; 0 if it has written none."""
        try:
            return int(read_json(self.path / PROGRESS, "progress")["steps"])
        except (OSError, ValueError, KeyError, TypeError):  # missing, or partly written
            return 0

    def save(self, outcome: Outcome) -> None:
        """Write the files of a finished run, ``run.json`` last, or ``error.txt`` of a failed one."""
        make_folder(self.path)
        if outcome.error:
            _write(self.path / ERROR, outcome.error.rstrip().encode() + b"\n")
            (self.path / PROGRESS).unlink(missing_ok=True)
            return
        (self.path / ERROR).unlink(missing_ok=True)
        for name, data in outcome.files.items():
            _write(self.path / name, data)
        study = outcome.task.study
        about = {
            "arm": self.arm, "seed": self.seed, "steps": study.steps, "hash": study.hash(self.arm), **outcome.about,
            "made_with": study.made_with(self.arm),
            "sha256": {name: hashlib.sha256(data).hexdigest() for name, data in outcome.files.items()},
        }  # fmt: skip
        _write(self.path / RUN, json.dumps(about, indent=1).encode() + b"\n")
        (self.path / PROGRESS).unlink(missing_ok=True)  # last: it marks the folder of an unfinished run

    def about(self) -> dict[str, Any] | None:
        """Return the content of ``run.json``; None if the run is not finished.

        Raises:
            ValueError: The file cannot be read, or lacks a field.
        """
        path = self.path / RUN
        if not path.exists():
            return None
        try:
            about = read_json(path, "run")
            _ = about["hash"], math.isfinite(about["ms_per_step"])
            _ = [about[name].items() for name in ("made_with", "versions")], about.get("sha256", {}).items()
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
            raise ValueError(
                f"{path}: not written by a run ({error!r}): remove its folder to repeat the run."
            ) from error
        return about

    def check(self, name: str) -> Path:
        """Return the path of a file of a finished run, after comparing it with its checksum in ``run.json``.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: The file is damaged.
        """
        path, known = self.path / name, (self.about() or {}).get("sha256", {})
        # Runs of early versions have no checksums.
        if name in known and hashlib.sha256(path.read_bytes()).hexdigest() != known[name]:
            raise ValueError(
                f"{path}: damaged, its checksum differs from the one in {RUN}: remove its folder to repeat the run."
            )
        return path

    def done(self, study: Study) -> bool:
        """Return whether the run is finished, with the configuration of the study.

        Raises:
            ValueError: The run was done with another configuration; the message names the differences.
        """
        about = self.about()
        if about is None:
            return False
        if about["hash"] != study.hash(self.arm):
            differing = "; ".join(_differences(about["made_with"], study.made_with(self.arm)))
            raise ValueError(
                f"{self.path} was made with another configuration: {differing}. Choose another folder, or remove it."
            )
        return True


def done_runs(study: Study, root: Path) -> list[RunFolder]:
    """Return all finished runs of a study's arms, with all seeds.

    Raises:
        ValueError: A run was done with another configuration.
    """
    found = []
    for arm in study.arms:
        seeds = [path.parent.name.removeprefix("seed") for path in (root / arm).glob(f"seed*/{RUN}")]
        found += [RunFolder(root, arm, seed) for seed in sorted(int(seed) for seed in seeds if seed.isdigit())]
    return [folder for folder in found if folder.done(study)]


class FinishedRun:
    """A finished run and its scores.

    Args:
        arm: Name of its arm.
        seed: Seed of the training.
        rows: Its scores.
        about: Content of ``run.json``.

    Attributes:
        steps: Steps of training before each evaluation without disturbance, ascending.
        disturbances: Names of the disturbances under which the policy was evaluated.
    """

    def __init__(self, arm: str, seed: int, rows: Sequence[Row], about: dict[str, Any]) -> None:
        self.arm, self.seed, self.rows, self.about = arm, seed, tuple(rows), about
        self._scores = defaultdict[tuple[str, int, str], list[Score]](list)
        for row in rows:
            self._scores[row.disturbance, row.steps, row.score.difficulty].append(row.score)
        self.steps = sorted({row.steps for row in rows if not row.disturbance})
        self.disturbances = tuple(dict.fromkeys(row.disturbance for row in rows if row.disturbance))

    def scores(self, difficulty: str, steps: int | None = None, disturbance: str = "") -> list[Score]:
        """Return the scores of one evaluation; by default the last."""
        return self._scores[disturbance, self.steps[-1] if steps is None else steps, difficulty]

    def success(self, difficulty: str, steps: int | None = None, disturbance: str = "") -> float:
        """Return the percentage of goals that were reached."""
        return 100.0 * float(np.mean([score.success for score in self.scores(difficulty, steps, disturbance)]))

    def final_mm(self, difficulty: str) -> float:
        """Return the mean final distance of the true points from those of the goals, in millimetres."""
        return float(np.mean([score.final_mm for score in self.scores(difficulty)]))

    def ms_acting(self) -> float:
        """Return the duration of a step with the policy in the last evaluation, as the median over its episodes."""
        return float(
            np.median([row.score.ms for row in self.rows if not row.disturbance and row.steps == self.steps[-1]])
        )


def finished_runs(study: Study, root: Path) -> list[FinishedRun]:
    """Return the finished runs in a study's folder, sorted by arm and seed.

    Raises:
        ValueError: A run was done with another configuration, or cannot be read.
    """
    runs = []
    for folder in done_runs(study, root):
        about = folder.about()
        assert about is not None
        runs.append(FinishedRun(folder.arm, folder.seed, read_scores(folder.check(SCORES)), about))
    return runs


def write_results(runs: Sequence[FinishedRun], root: Path) -> Path:
    """Write the scores of all runs into one table, ``results.csv``, and return its path."""

    def write(path: Path) -> None:
        with path.open("w", encoding="utf-8", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(("arm", "seed", *COLUMNS))
            table.writerows((run.arm, run.seed, *cells(row)) for run in runs for row in run.rows)

    write_whole(root / RESULTS, write)
    return root / RESULTS


def _differences(old: Any, new: Any, where: str = "") -> Iterator[str]:
    """Yield ``"steps was 100, is now 200"`` for each leaf that differs."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for name in dict.fromkeys([*old, *new]):
            place = f"{where}.{name}" if where else str(name)
            yield from _differences(old.get(name, "absent"), new.get(name, "absent"), place)
    elif old != new:
        yield f"{where} was {json.dumps(old)}, is now {json.dumps(new)}"


def _write(path: Path, data: bytes) -> None:
    write_whole(path, lambda temporary: temporary.write_bytes(data))
