"""A run as a task that any process can do: it is given a study, and gives back what belongs into the run's folder.

Engines: where the runs of a study are done. Whichever it is, equal runs give equal numbers.

An engine takes tasks and yields their outcomes as they come; about twice a second meanwhile it calls ``poll``.
"""

from __future__ import annotations
import json
import os
import platform
import tempfile
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any, Final
from shape_obs.ablation.training_run import Trained
from shape_obs.ablation.training_run import run
from shape_obs.ablation.scores import success
from shape_obs.ablation.scores import SCORES
from shape_obs.ablation.scores import scores_csv
from shape_obs.ablation.study import Study
from shape_obs.utils.threads import one_thread
import logging
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Final, Protocol


PROGRESS: Final = "progress.json"

POLICY: Final = "trained.policy"

_PACKAGES: Final = ("shape-obs", "stable-baselines3", "torch", "gymnasium", "mujoco", "numpy")



@dataclass(frozen=True)
class Task:
    """One run.

    Attributes:
        study: What is compared.
        arm: Name of one of its arms.
        seed: Of the training.
        folder: Of the run; where it can be seen, the steps done are told there.
    """

    study: Study
    arm: str
    seed: int
    folder: Path

    @property
    def name(self) -> str:
        """``"points3d/seed0"``."""
        return f"{self.arm}/seed{self.seed}"



@dataclass(frozen=True)
class Outcome:
    """What became of a run.

    Attributes:
        task: The run.
        files: Contents by name, for its folder; empty where it failed.
        about: What is told of it beside: times and versions.
        error: What was wrong; empty for nothing.
    """

    task: Task
    files: Mapping[str, bytes] = field(default_factory=dict)
    about: Mapping[str, Any] = field(default_factory=dict)
    error: str = ""



def work(task: Task) -> Outcome:
    """Do a run in this process, on one thread; whatever it raises is told in the outcome."""
    begin = time.perf_counter()
    try:
        with one_thread():
            trained = run(task.study, task.arm, task.seed, _teller(task))
            try:
                files = {SCORES: scores_csv(trained.rows).encode(), **_policy(trained, task)}
            finally:
                trained.env.close()
    except Exception:  # noqa: BLE001  a run that fails must not take the others along; its traceback is kept
        return Outcome(task, error=traceback.format_exc())
    about = {
        "ms_per_step": round(trained.ms_per_step, 3),
        "wall_s": round(time.perf_counter() - begin, 1),
        "machine": f"{platform.machine()} {platform.system()}",
        "versions": versions(),
    }
    return Outcome(task, files, about)



def versions() -> dict[str, str]:
    """Of what numbers may depend on."""
    return {"python": platform.python_version(), **{name: metadata.version(name) for name in _PACKAGES}}



def _teller(task: Task) -> Callable[[int], None]:
    """Tells the steps done, at most once a second, and ends the process when nobody is left to take the result."""
    parent, last = os.getppid(), 0.0

    def tell(steps: int) -> None:
        nonlocal last
        if os.getppid() != parent:
            os._exit(1)
        now = time.monotonic()
        if now - last > 1 and task.folder.is_dir():
            last = now
            (task.folder / PROGRESS).write_text(json.dumps({"steps": steps, "pid": os.getpid()}), encoding="ascii")

    return tell



def _policy(trained: Trained, task: Task) -> dict[str, bytes]:
    """The policy as a bundle."""
    from shape_obs.deploy.policy_bundle import save_bundle

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, POLICY)
        save_bundle(trained.model, trained.env, path, summary=_summary(trained, task))
        return {POLICY: path.read_bytes()}



def _summary(trained: Trained, task: Task) -> dict[str, Any]:
    """What the bundle tells of its training."""
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



Poll = Callable[[], object]


_SECONDS: Final = 0.5

_ONE_THREAD: Final = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}



class Engine(Protocol):
    """Does runs."""

    def __call__(self, tasks: Sequence[Task], poll: Poll) -> Iterator[Outcome]:
        """Yield the outcome of each task, the first that is done first."""
        ...



class Local:
    """Processes of this machine (joblib's loky), of one thread each.

    Each has a pool of its own: what kills one takes no other along, and its pool is made anew. The run that it did is
    tried once more after all others.

    Args:
        jobs: How many processes.

    Raises:
        ValueError: Fewer than one.
    """

    def __init__(self, jobs: int = 1) -> None:
        if jobs < 1:
            raise ValueError(f"jobs: expected 1 or more, got {jobs}.")
        self._jobs = jobs

    def __call__(self, tasks: Sequence[Task], poll: Poll = lambda: None) -> Iterator[Outcome]:
        """Yield outcomes as they come; whoever stops asking ends the runs that are under way."""
        waiting, running = deque(tasks), dict[Any, tuple[Any, Task]]()
        lost: list[Task] = []
        idle = [_pool() for _ in range(min(self._jobs, len(tasks)))]
        try:
            while waiting or running:
                while waiting and idle:
                    pool, task = idle.pop(), waiting.popleft()
                    try:
                        future = pool.submit(work, task)
                    except BrokenProcessPool:  # its process was ended while it had nothing to do
                        pool = _pool()
                        future = pool.submit(work, task)
                    running[future] = pool, task
                done, _ = wait(running, timeout=_SECONDS, return_when=FIRST_COMPLETED)
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



class Ray:
    """Tasks of a Ray cluster, of one core each.

    A task whose worker or machine is lost is tried again elsewhere. The machines need no folder in common; those that
    see the study's tell there how far they are.

    Args:
        address: Of the cluster, ``"auto"`` or ``"ray://head:10001"``; None starts one on this machine, or joins the
            one that this process has joined already.
        jobs: How many cores such a new one has; None for all.

    Raises:
        ImportError: Ray is not installed.
        ConnectionError: There is no cluster at the address.
    """

    def __init__(self, address: str | None = None, jobs: int | None = None) -> None:
        try:
            import ray
        except ImportError as error:
            raise ImportError("the engine 'ray' needs Ray: pip install 'shape-obs[ray]'") from error
        if not ray.is_initialized():
            own: dict[str, Any] = {"num_cpus": jobs, "include_dashboard": False} if address is None else {}
            # "local": without it an address in the environment would be joined.
            ray.init(address=address or "local", log_to_driver=False, logging_level=logging.WARNING, **own)

    def __call__(self, tasks: Sequence[Task], poll: Poll = lambda: None) -> Iterator[Outcome]:
        """Yield outcomes as they come; whoever stops asking ends the runs that are under way."""
        import ray
        from ray.exceptions import RayError

        remote: Any = ray.remote(num_cpus=1, max_retries=2)(work)
        running = {remote.options(name=task.name).remote(task): task for task in tasks}
        try:
            while running:
                done, _ = ray.wait(list(running), timeout=_SECONDS)
                poll()
                for reference in done:
                    task = running.pop(reference)
                    try:
                        outcome = ray.get(reference)
                    except RayError as error:
                        outcome = Outcome(task, error=f"Ray lost the run: {error}")
                    yield outcome
        finally:
            for reference in running:
                ray.cancel(reference, force=True)



def _pool() -> Any:
    # joblib's own door to it is shut: its Parallel ends all runs when one process dies.
    from joblib.externals.loky import ProcessPoolExecutor

    return ProcessPoolExecutor(1, env=_ONE_THREAD)

