"""Run slow work in a thread on the newest value only, so that a loop at a fixed rate never waits for it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


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
