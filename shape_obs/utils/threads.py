"""Limit the threads of OpenCV, BLAS and OpenMP, for reproducible timings and sums and for forked processes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import lru_cache
from typing import Any

import cv2


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
