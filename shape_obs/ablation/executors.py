"""Do the runs of a study: in this process, in several processes of this machine, or on a Ray cluster.

Equal runs give equal results wherever they are done.
"""

from __future__ import annotations

import json
import os
import platform
import tempfile
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any, Final, Protocol

from shape_obs.ablation.scores import SCORES, scores_csv, success
from shape_obs.ablation.study import Study
from shape_obs.ablation.training_run import Trained, run
from shape_obs.utils.ray_cluster import RayCluster
from shape_obs.utils.threads import one_thread

Poll = Callable[[], object]

PROGRESS: Final = "progress.json"
POLICY: Final = "trained.policy"
_PACKAGES: Final = ("shape-obs", "stable-baselines3", "torch", "gymnasium", "mujoco", "numpy")
#: Seconds between two calls of ``poll``.
_INTERVAL: Final = 0.5
_ONE_THREAD: Final = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


@dataclass(frozen=True)
class Task:
    """A run to be done.

    Attributes:
        study: The study.
        arm: Name of one of its arms.
        seed: Seed of the training.
        folder: Folder of the run; where a worker has access to it, it writes its progress there.
    """

    study: Study
    arm: str
    seed: int
    folder: Path

    @property
    def name(self) -> str:
        """Name of the run, such as ``"points3d/seed0"``."""
        return f"{self.arm}/seed{self.seed}"


@dataclass(frozen=True)
class Outcome:
    """The outcome of a run.

    Attributes:
        task: The run.
        files: Contents of the files for its folder, by name; empty if it failed.
        about: Times and versions, for ``run.json``.
        error: Traceback of an error; empty if there was none.
    """

    task: Task
    files: Mapping[str, bytes] = field(default_factory=dict)
    about: Mapping[str, Any] = field(default_factory=dict)
    error: str = ""


def work(task: Task) -> Outcome:
    """Do a run in this process with one thread; exceptions become part of the outcome."""
    begin = time.perf_counter()
    try:
        with one_thread():
            trained = run(task.study, task.arm, task.seed, _progress_writer(task))
            try:
                files = {SCORES: scores_csv(trained.rows).encode()}
                problem = _add_policy(files, trained, task)
            finally:
                trained.env.close()
    except Exception:  # noqa: BLE001  one failing run must not end the others; its traceback is kept
        return Outcome(task, error=traceback.format_exc())
    about = {
        "ms_per_step": round(trained.ms_per_step, 3),
        "wall_s": round(time.perf_counter() - begin, 1),
        "machine": f"{platform.machine()} {platform.system()}",
        "versions": versions(),
        **problem,
    }
    return Outcome(task, files, about)


def versions() -> dict[str, str]:
    """Return the versions of the packages on which the results may depend."""
    return {"python": platform.python_version(), **{name: metadata.version(name) for name in _PACKAGES}}


def _progress_writer(task: Task) -> Callable[[int], None]:
    """Return a function that writes the progress once a second, and exits when the parent process has ended."""
    parent, last = os.getppid(), 0.0

    def write(steps: int) -> None:
        nonlocal last
        if os.getppid() != parent:
            os._exit(1)
        now = time.monotonic()
        if now - last > 1 and task.folder.is_dir():
            last = now
            (task.folder / PROGRESS).write_text(json.dumps({"steps": steps, "pid": os.getpid()}), encoding="ascii")

    return write


def _add_policy(files: dict[str, bytes], trained: Trained, task: Task) -> dict[str, str]:
    """Add the file of the trained policy; return the reason if there can be none."""
    from shape_obs.policy import PolicyError, save_policy

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, POLICY)
        try:
            save_policy(trained.model, trained.env, path, summary=_summary(trained, task))
        except PolicyError as error:  # hours of training must not be lost for it
            return {"no_policy": str(error)}
        files[POLICY] = path.read_bytes()
    return {}


def _summary(trained: Trained, task: Task) -> dict[str, Any]:
    """Return the summary of the training for its file."""
    last = [row.score for row in trained.rows if not row.disturbance and row.steps == trained.model.num_timesteps]
    return {
        "arm": task.arm,
        "seed": task.seed,
        "steps": trained.model.num_timesteps,
        "success": {
            name: success([score for score in last if score.difficulty == name])
            for name in task.study.evaluation.difficulties
        },
        "made_with": task.study.made_with(task.arm),
    }


class Engine(Protocol):
    """Something that does runs."""

    def __call__(self, tasks: Sequence[Task], poll: Poll) -> Iterator[Outcome]:
        """Yield the outcome of each task as soon as it is finished; call ``poll`` about twice a second."""
        ...


class Local:
    """Do runs in processes of this machine (joblib's loky) with one thread each.

    Each process has its own pool, so that the death of one process does not end the others. Its run is repeated once,
    after all other runs, in a new pool.

    Args:
        jobs: Number of processes.

    Raises:
        ValueError: The number is below 1.
    """

    def __init__(self, jobs: int = 1) -> None:
        if jobs < 1:
            raise ValueError(f"jobs: expected 1 or more, got {jobs}.")
        self._jobs = jobs

    def __call__(self, tasks: Sequence[Task], poll: Poll = lambda: None) -> Iterator[Outcome]:
        """Yield outcomes as runs finish; closing the generator ends the runs in progress."""
        waiting, running = deque(tasks), dict[Any, tuple[Any, Task]]()
        lost: list[Task] = []
        idle = [_pool() for _ in range(min(self._jobs, len(tasks)))]
        try:
            while waiting or running:
                while waiting and idle:
                    pool, task = idle.pop(), waiting.popleft()
                    try:
                        future = pool.submit(work, task)
                    except BrokenProcessPool:  # its process was killed while it was idle
                        pool = _pool()
                        future = pool.submit(work, task)
                    running[future] = pool, task
                done, _ = wait(running, timeout=_INTERVAL, return_when=FIRST_COMPLETED)
                poll()
                for future in done:
                    pool, task = running.pop(future)
                    try:
                        outcome = future.result()
                    except BrokenProcessPool as error:
                        outcome = Outcome(task, error=f"the run's process ended: {error}")
                        pool.shutdown(wait=False)
                        pool = _pool()
                        if task not in lost:
                            lost.append(task)
                            waiting.append(task)
                            outcome = None
                    idle.append(pool)
                    if outcome is not None:
                        yield outcome
        finally:
            for pool in [*idle, *(pool for pool, _ in running.values())]:
                pool.shutdown(kill_workers=True)


def _pool() -> Any:
    # Not joblib.Parallel, which ends all runs when one process dies.
    from joblib.externals.loky import ProcessPoolExecutor

    return ProcessPoolExecutor(1, env=_ONE_THREAD)


class Ray:
    """Do runs as tasks of a Ray cluster with one core each.

    A run whose worker or machine is lost is repeated elsewhere. The machines need no shared folder; workers with
    access to the study's folder write their progress there.

    Args:
        address: Address of the cluster, ``"auto"`` or ``"ray://head:10001"``; None starts one on this machine, or uses
            the one that this process has already joined.
        jobs: Number of cores of a cluster that is started here; None for all.

    Raises:
        ImportError: Ray is not installed.
        ConnectionError: There is no cluster at the address.
    """

    def __init__(self, address: str | None = None, jobs: int | None = None) -> None:
        self._cluster = RayCluster(address, jobs)

    def __call__(self, tasks: Sequence[Task], poll: Poll = lambda: None) -> Iterator[Outcome]:
        """Yield outcomes as runs finish; closing the generator ends the runs in progress."""
        return self._cluster.run(work, tasks, lost=lambda task, reason: Outcome(task, error=reason), poll=poll)
