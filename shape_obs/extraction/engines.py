"""Where the work on episodes is done: in this process, in several of this machine, or on a Ray cluster."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from shape_obs.extraction.extraction import Extraction, work
from shape_obs.extraction.task import Outcome, Task


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
