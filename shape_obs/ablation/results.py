"""RunFolder: where a run of an ablation is kept, and whether it is done.

Finished: what the done runs of a study reached.
"""

from __future__ import annotations
import hashlib
import json
import math
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from shape_obs.ablation.study import Study
from shape_obs.ablation.executors import PROGRESS
from shape_obs.ablation.executors import Outcome
from shape_obs.utils.documents import read_json
from shape_obs.utils.files import make_folder, write_whole
import csv
from collections import defaultdict
from collections.abc import Sequence
import numpy as np
from shape_obs.ablation.training_run import Row
from shape_obs.ablation.scores import Score
from shape_obs.ablation.scores import COLUMNS
from shape_obs.ablation.scores import SCORES
from shape_obs.ablation.scores import cells
from shape_obs.ablation.scores import read_scores
from shape_obs.utils.files import write_whole


RUN: Final = "run.json"

ERROR: Final = "error.txt"



@dataclass(frozen=True)
class RunFolder:
    """``ROOT/ARM/seedK``: what came out of a run. It is done when ``run.json`` is there, which is written last.

    Args:
        root: Of the study.
        arm: Name of the arm.
        seed: Of the training.
    """

    root: Path
    arm: str
    seed: int

    @property
    def path(self) -> Path:
        """The folder."""
        return self.root / self.arm / f"seed{self.seed}"

    def begin(self) -> None:
        """Make it, empty of what an earlier try left."""
        if self.path.is_dir():
            shutil.rmtree(self.path)
        make_folder(self.path)

    def steps(self) -> int:
        """How many a run under way has told; 0 before it tells any."""
        try:
            return int(read_json(self.path / PROGRESS, "progress")["steps"])
        except (OSError, ValueError, KeyError, TypeError):  # not there yet, or half-written
            return 0

    def keep(self, outcome: Outcome) -> None:
        """Write what came out, ``run.json`` last; or why nothing did, ``error.txt``."""
        make_folder(self.path)
        (self.path / PROGRESS).unlink(missing_ok=True)
        if outcome.error:
            _write(self.path / ERROR, outcome.error.rstrip().encode() + b"\n")
            return
        (self.path / ERROR).unlink(missing_ok=True)
        for name, data in outcome.files.items():
            _write(self.path / name, data)
        study = outcome.task.study
        told = {
            "arm": self.arm, "seed": self.seed, "steps": study.steps, "hash": study.hash(self.arm), **outcome.about,
            "made_with": study.made_with(self.arm),
            "sha256": {name: hashlib.sha256(data).hexdigest() for name, data in outcome.files.items()},
        }  # fmt: skip
        _write(self.path / RUN, json.dumps(told, indent=1).encode() + b"\n")

    def about(self) -> dict[str, Any] | None:
        """Return the content of ``run.json``; None while the run is not done.

        Raises:
            ValueError: It cannot be read, or lacks something.
        """
        path = self.path / RUN
        if not path.exists():
            return None
        try:
            told = read_json(path, "run")
            _ = told["hash"], math.isfinite(told["ms_per_step"])
            _ = [told[name].items() for name in ("made_with", "versions")], told.get("sha256", {}).items()
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
            raise ValueError(f"{path}: not what a run wrote ({error!r}): remove its folder to do it again.") from error
        return told

    def check(self, name: str) -> Path:
        """Return the path of a file of a done run, after comparing it with its checksum in ``run.json``.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: It is damaged.
        """
        path, known = self.path / name, (self.about() or {}).get("sha256", {})
        # Runs of early versions have no checksums.
        if name in known and hashlib.sha256(path.read_bytes()).hexdigest() != known[name]:
            raise ValueError(
                f"{path}: damaged, its checksum differs from the one in {RUN}: remove its folder to do it again."
            )
        return path

    def done(self, study: Study) -> bool:
        """Whether the run is done, as the study wants it.

        Raises:
            ValueError: It is done, but otherwise; what differs is named.
        """
        told = self.about()
        if told is None:
            return False
        if told["hash"] != study.hash(self.arm):
            differing = "; ".join(_differences(told["made_with"], study.made_with(self.arm)))
            raise ValueError(
                f"{self.path} was made with another configuration: {differing}. Choose another folder, or remove this."
            )
        return True



def done_runs(study: Study, root: Path) -> list[RunFolder]:
    """All runs of a study's arms that are done, of whatever seeds.

    Raises:
        ValueError: One of them was made with another configuration.
    """
    found = []
    for arm in study.arms:
        seeds = [path.parent.name.removeprefix("seed") for path in (root / arm).glob(f"seed*/{RUN}")]
        found += [RunFolder(root, arm, seed) for seed in sorted(int(seed) for seed in seeds if seed.isdigit())]
    return [folder for folder in found if folder.done(study)]



def _differences(old: Any, new: Any, where: str = "") -> Iterator[str]:
    """``"steps was 100, is now 200"`` for each leaf that differs."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for name in dict.fromkeys([*old, *new]):
            place = f"{where}.{name}" if where else str(name)
            yield from _differences(old.get(name, "absent"), new.get(name, "absent"), place)
    elif old != new:
        yield f"{where} was {json.dumps(old)}, is now {json.dumps(new)}"



def _write(path: Path, data: bytes) -> None:
    write_whole(path, lambda temporary: temporary.write_bytes(data))



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

