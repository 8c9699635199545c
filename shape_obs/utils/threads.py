"""Limit the threads of libraries, and run slow work in a thread.

Limits make timings and sums reproducible, and processes safe to fork.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import lru_cache
from typing import Any, Generic, TypeVar

import cv2

T = TypeVar("T")


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit OpenCV, BLAS and OpenMP to one thread within the block.

    Only libraries that are already loaded can be limited: import what is to be timed before.
    """
    from threadpoolctl import threadpool_limits

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with threadpool_limits(1):
            yield
    finally:
        cv2.setNumThreads(before)


def single_thread() -> AbstractContextManager[Any]:
    """Limit OpenMP and BLAS to one thread within the block, for scikit-learn.

    A thread pool exists only in the process that started it: a forked child would wait for its threads forever. And
    sums over several threads differ from run to run.
    """
    return _controller().limit(limits=1)


@lru_cache(maxsize=1)  # finding the libraries takes milliseconds; import those that are to be limited before
def _controller() -> Any:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def use_no_threads_in_forked_children() -> None:
    """Make OpenCV run serially in every forked child of this process; without ``fork`` do nothing.

    The threads of OpenCV's pool exist only in the parent. If one of them holds the pool's lock at the moment of the
    fork, the first parallel call in the child waits forever. Without threads OpenCV never uses the pool.
    """
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=_without_threads)


def _without_threads() -> None:
    cv2.setNumThreads(0)


class Newest(Generic[T]):
    """A thread that works on the newest value; values that come while it is busy replace each other.

    Args:
        work: Called in the thread with one value at a time.
        name: Name of the thread.
    """

    def __init__(self, work: Callable[[T], object], name: str) -> None:
        self._work = work
        self._waiting: list[T] = []  # at most one
        self._wake, self._over = threading.Condition(), False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def put(self, value: T) -> None:
        """Work on a value next, in place of one that is still waiting; return at once."""
        with self._wake:
            self._waiting = [value]
            self._wake.notify()

    def close(self, timeout: float = 2.0) -> bool:
        """Finish the last value and end the thread.

        Args:
            timeout: Seconds to wait for it.

        Returns:
            Whether it ended; work that hangs is left alone.
        """
        with self._wake:
            self._over = True
            self._wake.notify()
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._over or self._waiting)
                if not self._waiting:
                    return
                value = self._waiting.pop()
            self._work(value)
