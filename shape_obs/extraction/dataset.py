"""Extract the shapes of many recorded episodes into a dataset, with one Parquet file per episode."""

from __future__ import annotations

import json
import os
from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal

from shape_obs.extraction.extraction import Extraction, work
from shape_obs.extraction.task import Outcome, Task, stem
from shape_obs.recording.table import check_table_path
from shape_obs.utils.documents import read_json
from shape_obs.utils.files import listing, make_folder, write_text
from shape_obs.utils.ray_cluster import RayCluster

Engine = Literal["local", "ray"]

# Readers of datasets ignore names that begin with '_'.
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
    """Find the shapes of all episodes that the dataset does not have yet.

    Episodes in the dataset are skipped if their recording has not changed, so a run that was killed can be continued.
    Only one run at a time may write to a folder.

    Args:
        job: What to find, and where to write it.
        tasks: The episodes, as ``all_tasks`` finds them.
        engine: ``"local"`` for processes of this machine, or ``"ray"`` for a Ray cluster.
        jobs: Number of episodes at once; None for 1 with ``"local"``, and for the number of cores with ``"ray"``.
        address: Address of the Ray cluster; None starts one on this machine.

    Yields:
        The outcome of each episode, in the order in which they finish. At the end, ``_failures.json`` in the folder
        lists the failed episodes, if any.

    Raises:
        ValueError: The folder holds something else, or shapes that were found with another configuration, or an option
            is out of range.
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
    _check_folder(job.out, job.made_with())
    _remove_stale_parts(job.out, tasks)
    failed: list[Outcome] = []
    outcomes = _on_ray(job, tasks, jobs, address) if engine == "ray" else _local(job, tasks, jobs or 1)
    for outcome in outcomes:
        if outcome.status == "failed":
            failed.append(outcome)
        yield outcome
    path = job.out / FAILURES_FILE
    if failed:
        failures = [
            {"source": outcome.task.source, "index": outcome.task.index, "reason": outcome.reason}
            for outcome in sorted(failed, key=lambda outcome: (outcome.task.source, outcome.task.index))
        ]
        _write(path, failures)
    else:
        path.unlink(missing_ok=True)


def _check_folder(folder: Path, made_with: Mapping[str, Any]) -> None:
    """Record what the dataset is made with, or refuse a dataset that was made with something else."""
    path = make_folder(folder) / DATASET_FILE
    if not path.exists():
        if listing(folder):
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


def _remove_stale_parts(folder: Path, tasks: Sequence[Task]) -> None:
    """Remove parts of episodes that these recordings no longer have."""
    wanted = {task.part for task in tasks}
    # If a recording cannot be read, its episodes are unknown and its parts stay.
    for prefix in {stem(task.source) for task in tasks if task.frames is not None}:
        for part in folder.glob(f"{prefix}-[0-9][0-9][0-9][0-9]*.parquet"):
            if part.name not in wanted:
                part.unlink()


def _write(path: Path, content: Any) -> None:
    write_text(path, json.dumps(content, indent=1) + "\n")


def _local(job: Extraction, tasks: Sequence[Task], jobs: int) -> Iterator[Outcome]:
    """Yield outcomes of work in ``jobs`` processes of this machine, with one thread each.

    Raises:
        ChildProcessError: A process died.
    """
    made_with = job.made_with()
    if jobs == 1:
        for task in tasks:
            yield work(job, made_with, task)
        return
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    workers: Any = Parallel(n_jobs=jobs, return_as="generator_unordered")
    try:
        yield from workers(delayed(_work_in)(Path.cwd(), job, made_with, task) for task in tasks)
    except TerminatedWorkerError as error:
        raise ChildProcessError(
            "a process was killed, perhaps because memory ran out: run again with fewer --jobs. Finished episodes stay."
        ) from error


def _on_ray(job: Extraction, tasks: Sequence[Task], jobs: int | None, address: str | None) -> Iterator[Outcome]:
    """Yield outcomes of work on a Ray cluster, one core for each episode.

    Every machine must have the recordings and the dataset's folder under the same paths as this one.

    Raises:
        ImportError: The extra ``ray`` is missing.
        ConnectionError: There is no cluster at the address.
    """
    made_with, folder = job.made_with(), Path.cwd()
    cluster = RayCluster(address, jobs)
    try:
        yield from cluster.run(
            lambda task: _work_in(folder, job, made_with, task),
            tasks,
            lost=lambda task, reason: Outcome(task, "failed", reason=" ".join(reason.split())),
            jobs=jobs,
        )
    finally:
        cluster.close()


def _work_in(folder: Path, job: Extraction, made_with: Mapping[str, Any], task: Task) -> Outcome:
    """Call ``work`` in another process, after changing to a folder so that relative paths keep their meaning."""
    try:
        os.chdir(folder)
    except OSError as error:
        return Outcome(task, "failed", reason=f"{folder} does not exist on this machine: {error.strerror}.")
    return work(job, made_with, task)
