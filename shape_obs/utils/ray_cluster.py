"""Run tasks on a Ray cluster, one core each."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, TypeVar

from shape_obs.utils.errors import install_hint

T = TypeVar("T")
R = TypeVar("R")

#: Seconds between two calls of ``poll``.
_INTERVAL: Final = 0.5


class RayCluster:
    """A connection to a Ray cluster.

    Args:
        address: Address of the cluster, ``"auto"`` or ``"ray://head:10001"``. None starts a cluster on this machine, or
            uses the one that this process has already joined.
        jobs: Number of cores of a cluster that is started here; None for all.

    Raises:
        ImportError: Ray is not installed.
        ConnectionError: There is no cluster at the address.
    """

    def __init__(self, address: str | None = None, jobs: int | None = None) -> None:
        # Ray would otherwise build an environment for its workers when the process was started by ``uv run``.
        os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")
        try:
            import ray
        except ImportError as error:
            raise ImportError(f"--engine ray needs Ray: {install_hint('ray')} ({error})") from error
        self._joined = not ray.is_initialized()
        if self._joined:
            own: dict[str, Any] = {"num_cpus": jobs, "include_dashboard": False} if address is None else {}
            # "local", since Ray would otherwise join the cluster in the environment variable RAY_ADDRESS.
            ray.init(address=address or "local", log_to_driver=False, logging_level=logging.ERROR, **own)

    def run(
        self,
        work: Callable[[T], R],
        tasks: Sequence[T],
        *,
        lost: Callable[[T, str], R],
        jobs: int | None = None,
        poll: Callable[[], object] = lambda: None,
    ) -> Iterator[R]:
        """Yield the result of each task as soon as it is finished.

        A task whose worker or machine is lost is repeated elsewhere, twice at most. Closing the generator ends the
        tasks that are still running.

        Args:
            work: Does a task.
            tasks: The tasks.
            lost: Makes the result of a task that could not be finished, from the task and the reason.
            jobs: Largest number of tasks at once; None for as many as the cluster has cores.
            poll: Called about twice a second.
        """
        import ray
        from ray.exceptions import RayError

        remote: Any = ray.remote(num_cpus=1, max_retries=2)(work)
        waiting = iter(tasks)
        running: dict[Any, T] = {}

        def start(count: int | None) -> None:
            for _, task in zip(range(len(tasks) if count is None else count), waiting, strict=False):
                running[remote.remote(task)] = task

        start(jobs)
        try:
            while running:
                finished, _ = ray.wait(list(running), timeout=_INTERVAL)
                poll()
                for reference in finished:
                    task = running.pop(reference)
                    start(1)
                    try:
                        result = ray.get(reference)
                    except RayError as error:
                        result = lost(task, f"Ray lost the task: {error}")
                    yield result
        finally:
            for reference in running:
                ray.cancel(reference, force=True)

    def close(self) -> None:
        """Leave the cluster, and end one that was started here; leave one alone that was joined before."""
        import ray

        if self._joined:
            ray.shutdown()
