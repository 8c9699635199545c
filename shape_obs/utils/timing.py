"""Read the time, wait for it, and keep a fixed rate with absolute deadlines."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Final


class Alarm:
    """Call a function from a thread when a time has come, unless the time is replaced before.

    Args:
        act: The function. It may set or close the alarm.
        name: Name of the thread, which starts with the first time that is set.
    """

    def __init__(self, act: Callable[[], object], name: str) -> None:
        self._act, self._name = act, name
        self._due, self._closed = math.inf, False
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None

    def set(self, due: float) -> None:
        """Replace the time of the next call: ``time.monotonic()`` in seconds, infinity for no call."""
        with self._changed:
            sooner, self._due = due < self._due, due
            if self._thread is None and due < math.inf:
                self._closed = False
                self._thread = threading.Thread(target=self._watch, name=self._name, daemon=True)
                self._thread.start()
            elif sooner:  # no wake-up for a later time: the thread looks again at the earlier one
                self._changed.notify()

    def close(self) -> None:
        """End the thread. The next time that is set starts another one."""
        with self._changed:
            thread, self._thread, self._closed = self._thread, None, True
            self._changed.notify()
        if thread is not None and thread is not threading.current_thread():
            thread.join()

    def _watch(self) -> None:
        while True:
            with self._changed:
                while not self._closed and (left := self._due - time.monotonic()) > 0:
                    self._changed.wait(min(left, threading.TIMEOUT_MAX))
                if self._closed:
                    return
                self._due = math.inf
            self._act()


class Clock:
    """Time of this machine, and all ways to wait for it. A test passes a clock that it moves itself."""

    def now(self) -> float:
        """Return ``time.monotonic()`` in seconds."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait for some seconds."""
        time.sleep(seconds)

    def wait(self, condition: threading.Condition, seconds: float | None) -> None:
        """Wait until a condition, whose lock is held, is notified, or for some seconds; None: without end."""
        condition.wait(seconds)

    def alarm(self, act: Callable[[], object], name: str) -> Alarm:
        """Return an alarm of this clock; see ``Alarm``."""
        return Alarm(act, name)


CLOCK: Final = Clock()


class Rate:
    """Wait for the deadlines ``start + k * dt``, which do not depend on the duration of the steps.

    A deadline that has passed before ``wait`` is called is an overrun; later deadlines are counted from that moment, so
    that a late loop does not hurry to catch up. In this way a loop that waits for a camera also falls into step with
    it: if the camera is slightly slower than the rate, each deadline would otherwise expire just before the frame
    arrives and count as an overrun.

    Args:
        hertz: Deadlines per second.
        clock: Time, and the ways to wait for it.

    Attributes:
        dt: Seconds between deadlines.
        overruns: Number of deadlines that had passed.
        steps: Number of calls of ``wait``.

    Raises:
        ValueError: The rate is not above 0 and at most 1000 Hz.
    """

    def __init__(self, hertz: float, clock: Clock = CLOCK) -> None:
        if not 0 < hertz <= 1000:
            raise ValueError(f"rate: expected hertz above 0, at most 1000, got {hertz!r}.")
        self.dt, self._clock = 1.0 / hertz, clock
        self.start()

    def start(self) -> None:
        """Restart now: the first deadline is ``dt`` from now."""
        self.overruns = self.steps = 0
        self.deadline = self._clock.now() + self.dt

    def wait(self) -> float:
        """Sleep until the deadline.

        Returns:
            The seconds slept; if the deadline had passed, minus the seconds since then.
        """
        self.steps += 1
        left = self.deadline - self._clock.now()
        if left > 0:
            self._clock.sleep(left)
        else:
            self.overruns += 1
            self.deadline -= left
        self.deadline += self.dt
        return left
