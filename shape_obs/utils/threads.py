"""Work on one thread: what else the libraries would start is held back, so timings and sums stay what they are.

Forked workers: OpenCV's thread pool does not survive a fork, so a child does without it.

The pool's threads exist in the parent alone. If one of them holds the pool's lock at the moment of the fork, the first
parallel call in the child waits for ever. Without threads OpenCV never asks the pool.

scikit-learn on one thread.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import lru_cache
from typing import Any

import cv2
from threadpoolctl import threadpool_limits


@contextmanager
def one_thread() -> Iterator[None]:
    """Hold OpenCV, BLAS and OpenMP to one thread within the block.

    Only libraries that are loaded already can be held back: import what is to be timed before.
    """
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with threadpool_limits(1):
            yield
    finally:
        cv2.setNumThreads(before)


def use_no_threads_in_forked_children() -> None:
    """Have OpenCV run serially in every process that is forked off this one; where there is no fork, do nothing."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=_without_threads)


def _without_threads() -> None:
    cv2.setNumThreads(0)


def single_thread() -> AbstractContextManager[Any]:
    """Hold OpenMP and BLAS to one thread within the block.

    Threads would be there in a parent process alone: a child that is forked off it would wait for them for ever. And
    sums that several of them add up differ from run to run.
    """
    return _controller().limit(limits=1)


@lru_cache(maxsize=1)  # looking for the libraries takes milliseconds; import those that are to be held back before
def _controller() -> Any:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
