"""Watchdog: stops the robot from outside when the loop hangs."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import Self


class Watchdog:
    """Calls ``bite`` once when it is not fed for ``seconds``. A context manager: it watches within.

    Args:
        bite: Stops the robot; called from a thread of its own.
        seconds: How long it waits.

    Attributes:
        bitten: Whether it has bitten.
    """

    def __init__(self, bite: Callable[[], None], seconds: float) -> None:
        self._bite, self._seconds = bite, seconds
        self._fed = time.monotonic()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)
        self.bitten = False

    def feed(self) -> None:
        """Tell it that the loop has come round."""
        self._fed = time.monotonic()

    def _watch(self) -> None:
        left = self._seconds
        while not self._over.wait(left):
            left = self._fed + self._seconds - time.monotonic()
            if left <= 0:
                self.bitten = True
                self._bite()
                return

    def __enter__(self) -> Self:
        self.feed()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join(self._seconds)
