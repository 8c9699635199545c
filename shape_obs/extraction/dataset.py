"""extract: many recorded episodes into a dataset of Parquet files, one for each episode.

Where the work on episodes is done: in this process, in several of this machine, or on a Ray cluster.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal

from shape_obs.extraction.extraction import Extraction, work
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


def local(job: Extraction, tasks: Sequence[Task], jobs: int) -> Iterator[Outcome]:
    """Work in ``jobs`` processes of this machine, one thread each; outcomes come as they are done.

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
        yield from workers(delayed(_elsewhere)(Path.cwd(), job, made_with, task) for task in tasks)
    except TerminatedWorkerError as error:
        raise ChildProcessError(
            "a process was killed, perhaps for want of memory: run again with fewer --jobs; what is done is kept."
        ) from error


def on_ray(job: Extraction, tasks: Sequence[Task], jobs: int | None, address: str | None) -> Iterator[Outcome]:
    """Work on a Ray cluster with Ray Data, one CPU for each episode; outcomes come as they are done.

    Every machine of it sees the recordings and the dataset's folder under the same paths as this one.

    Args:
        job: What to find.
        tasks: The episodes.
        jobs: How many at once, at most; None for as many as there are CPUs.
        address: Of the cluster, as ``ray.init`` takes it; None starts one on this machine for as long as it takes.

    Raises:
        ImportError: Without the extra ``ray``.
        ConnectionError: There is no cluster.
    """
    os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")  # workers need no environment of their own
    try:
        import ray
        import ray.data
    except ImportError as error:
        raise ImportError(f"--engine ray needs Ray: pip install 'shape-obs[ray]' ({error})") from error

    made_with, folder = job.made_with(), Path.cwd()
    ours = not ray.is_initialized()
    if ours:
        own: dict[str, Any] = {"num_cpus": jobs, "include_dashboard": False} if address is None else {}
        # "local": without it an address in the environment would be joined.
        ray.init(address=address or "local", log_to_driver=False, logging_level=logging.ERROR, **own)

    def row(told: dict[str, Any]) -> dict[str, Any]:
        task = Task.from_dict(json.loads(told["task"]))
        return {"outcome": json.dumps(_elsewhere(folder, job, made_with, task).to_dict())}

    try:
        ray.data.DataContext.get_current().enable_progress_bars = False
        rows = [{"task": json.dumps(task.to_dict())} for task in tasks]
        found = ray.data.from_items(rows, override_num_blocks=len(rows))
        logging.getLogger("ray.data").setLevel(logging.ERROR)  # the caller has a bar of its own
        for told in found.map(row, num_cpus=1, **_at_most(ray, jobs)).iter_rows():
            yield Outcome.from_dict(json.loads(told["outcome"]))
    finally:
        if ours:
            ray.shutdown()


def _at_most(ray: Any, jobs: int | None) -> dict[str, Any]:
    """The arguments of ``map`` that hold it to so many tasks; the older of them is deprecated in Ray 2.5x."""
    if jobs is None:
        return {}
    strategy = getattr(ray.data, "TaskPoolStrategy", None)
    return {"concurrency": jobs} if strategy is None else {"compute": strategy(jobs)}


def _elsewhere(folder: Path, job: Extraction, made_with: Mapping[str, Any], task: Task) -> Outcome:
    """``work`` in a process that was started somewhere else: paths mean what they meant here."""
    try:
        os.chdir(folder)
    except OSError as error:
        return Outcome(task, "failed", reason=f"{folder} is not there on this machine: {error.strerror}.")
    return work(job, made_with, task)
