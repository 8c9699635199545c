"""Forked workers: OpenCV's thread pool does not survive a fork, so a child does without it.

The pool's threads exist in the parent alone. If one of them holds the pool's lock at the moment of the fork, the first
parallel call in the child waits for ever. Without threads OpenCV never asks the pool.
"""

from __future__ import annotations

import os

import cv2


def use_no_threads_in_forked_children() -> None:
    """Have OpenCV run serially in every process that is forked off this one; where there is no fork, do nothing."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=_without_threads)


def _without_threads() -> None:
    cv2.setNumThreads(0)
