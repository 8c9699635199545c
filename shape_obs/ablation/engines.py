"""Engines: where the runs of a study are done. Whichever it is, equal runs give equal numbers.

An engine takes tasks and yields their outcomes as they come; about twice a second meanwhile it calls ``poll``.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Final, Protocol

from shape_obs.ablation.work import Outcome, Task, work

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
