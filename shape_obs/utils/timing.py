"""Keep a fixed rate with absolute deadlines."""

from __future__ import annotations

import time


class Rate:
    """Wait for the deadlines ``start + k * dt``, which do not depend on the duration of the steps.

    A deadline that has passed before ``wait`` is called is an overrun; later deadlines are counted from that moment, so
    that a late loop does not hurry to catch up. In this way a loop that waits for a camera also falls into step with
    it: if the camera is slightly slower than the rate, each deadline would otherwise expire just before the frame
    arrives and count as an overrun.

    Args:
        hertz: Deadlines per second.

    Attributes:
        dt: Seconds between deadlines.
        overruns: Number of deadlines that had passed.
        steps: Number of calls of ``wait``.

    Raises:
        ValueError: The rate is not above 0 and at most 1000 Hz.
    """

    def __init__(self, hertz: float) -> None:
        if not 0 < hertz <= 1000:
            raise ValueError(f"rate: expected hertz above 0, at most 1000, got {hertz!r}.")
        self.dt = 1.0 / hertz
        self.start()

    def start(self) -> None:
        """Restart now: the first deadline is ``dt`` from now."""
        self.overruns = self.steps = 0
        self.deadline = time.monotonic() + self.dt

    def wait(self) -> float:
        """Sleep until the deadline.

        Returns:
            The seconds slept; if the deadline had passed, minus the seconds since then.
        """
        self.steps += 1
        left = self.deadline - time.monotonic()
        if left > 0:
            time.sleep(left)
        else:
            self.overruns += 1
            self.deadline -= left
        self.deadline += self.dt
        return left
