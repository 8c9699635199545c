"""scikit-learn on one thread."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import lru_cache
from typing import Any


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
