"""extract: many recorded episodes into a dataset of Parquet files, one for each episode."""

from __future__ import annotations

import json
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal

from shape_obs.extraction.engines import local, on_ray
from shape_obs.extraction.extraction import Extraction
from shape_obs.extraction.task import Outcome, Task, stem
from shape_obs.recording.table import check_table_path
from shape_obs.utils.documents import read_json
from shape_obs.utils.files import make_folder, write_text

Engine = Literal["local", "ray"]

# Readers of datasets pass over names that begin with '_'.
DATASET_FILE: Final = "_extraction.json"
FAILURES_FILE: Final = "_failures.json"


def extract(
    job: Extraction,
    tasks: Sequence[Task],
    *,
    engine: Engine = "local",
    jobs: int | None = None,
    address: str | None = None,
) -> Generator[Outcome, None, None]:
    """Find the shapes of all episodes that are not in the dataset yet.

    What is there already, of the same recording, is left alone, so a run that was killed goes on where it was. An
    episode whose recording changed is done anew. One run at a time writes to a folder.

    Args:
        job: What to find, and where to write it.
        tasks: The episodes, as ``all_tasks`` finds them.
        engine: ``"local"``, processes of this machine; ``"ray"``, a Ray cluster.
        jobs: How many episodes at once; None for 1 with ``"local"``, and as many as there are CPUs with ``"ray"``.
        address: Of the Ray cluster; None starts one on this machine.

    Yields:
        What became of each episode, in the order in which they are done. In the end ``_failures.json`` in the folder
        lists those that failed; without any there is none.

    Raises:
        ValueError: The folder holds something else, or shapes that were found with another config; or an option is out
            of range.
        ImportError: The extra ``parquet`` or ``ray`` is missing.
        OSError: The folder cannot be written to.
    """
    if jobs is not None and jobs < 1:
        raise ValueError(f"jobs: expected 1 or more, got {jobs}.")
    if job.frames is not None and job.frames < 1:
        raise ValueError(f"frames: expected 1 or more, got {job.frames}.")
    if address is not None and engine != "ray":
        raise ValueError(f"address: only engine 'ray' has one, got engine {engine!r}.")
    check_table_path(job.out / DATASET_FILE.replace(".json", ".parquet"))
    _claim(job.out, job.made_with())
    _remove_what_is_gone(job.out, tasks)
    failed: list[Outcome] = []
    outcomes = on_ray(job, tasks, jobs, address) if engine == "ray" else local(job, tasks, jobs or 1)
    for outcome in outcomes:
        if outcome.status == "failed":
            failed.append(outcome)
        yield outcome
    path = job.out / FAILURES_FILE
    if failed:
        told = [
            {"source": outcome.task.source, "index": outcome.task.index, "reason": outcome.reason}
            for outcome in sorted(failed, key=lambda outcome: (outcome.task.source, outcome.task.index))
        ]
        _write(path, told)
    else:
        path.unlink(missing_ok=True)


def _claim(folder: Path, made_with: Mapping[str, Any]) -> None:
    """Say what the dataset is made with, or see that it is made with the same."""
    path = make_folder(folder) / DATASET_FILE
    if not path.exists():
        if any(not name.name.startswith(".") for name in folder.iterdir()):
            raise ValueError(f"{folder}: the folder is not empty, and holds no extraction: choose another --out.")
        _write(path, dict(made_with))
        return
    try:
        before = dict(read_json(path, "extraction"))
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: damaged ({error}): remove the folder, or choose another --out.") from error
    for name, now in made_with.items():
        if before.get(name) != now:
            raise ValueError(
                f"{folder} holds shapes that were found with {name} {before.get(name)}, this run has {now}: choose "
                "another --out, or remove the folder."
            )


def _remove_what_is_gone(folder: Path, tasks: Sequence[Task]) -> None:
    """Remove parts of episodes that these recordings had once."""
    wanted = {task.part for task in tasks}
    # A recording that cannot be read has no frames that are known: what there is of it stays.
    for prefix in {stem(task.source) for task in tasks if task.frames is not None}:
        for part in folder.glob(f"{prefix}-[0-9][0-9][0-9][0-9]*.parquet"):
            if part.name not in wanted:
                part.unlink()


def _write(path: Path, content: Any) -> None:
    write_text(path, json.dumps(content, indent=1) + "\n")
