"""Watchdog: act from another thread when a loop hangs."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import Self


class Watchdog:
    """Call a function once when ``feed`` was not called for ``seconds``. A context manager; it watches within.

    Args:
        act: Called from a thread when the time is over.
        seconds: How long it waits.

    Attributes:
        expired: Whether the time was over.
    """

    def __init__(self, act: Callable[[], None], seconds: float) -> None:
        self._act, self._seconds = act, seconds
        self._fed = time.monotonic()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)
        self.expired = False

    def feed(self) -> None:
        """Report that the loop has come round."""
        self._fed = time.monotonic()

    def _watch(self) -> None:
        left = self._seconds
        while not self._over.wait(left):
            left = self._fed + self._seconds - time.monotonic()
            if left <= 0:
                self.expired = True
                self._act()
                return

    def __enter__(self) -> Self:
        self.feed()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
