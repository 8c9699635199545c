"""How long the stages of a frame take.

Rate: a fixed rate with absolute deadlines, which do not move with what each step takes.
"""

from __future__ import annotations

import time


class Timed:
    """Adds the time spent in its block to a stage, in milliseconds."""

    def __init__(self, timings: dict[str, float], stage: str) -> None:
        self._timings, self._stage = timings, stage

    def __enter__(self) -> None:
        self._begin = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        spent = 1e3 * (time.perf_counter() - self._begin)
        self._timings[self._stage] = self._timings.get(self._stage, 0.0) + spent


class Rate:
    """Deadlines ``start + k * dt``.

    A deadline that has passed before it was waited for is an overrun, after which deadlines count from there: a late
    loop does not hurry to catch up. And a loop that waits for a camera falls into step with it: where the camera is
    slower by a hair, deadlines would else pass shortly before each frame, and every step would be late by that hair.

    Args:
        hertz: Deadlines a second.

    Attributes:
        dt: Seconds between deadlines.
        overruns: How many deadlines had passed.
        steps: How many were waited for.
    """

    def __init__(self, hertz: float) -> None:
        if not 0 < hertz <= 1000:
            raise ValueError(f"rate: expected hertz above 0, at most 1000, got {hertz!r}.")
        self.dt = 1.0 / hertz
        self.start()

    def start(self) -> None:
        """Begin now: the first deadline is ``dt`` from here."""
        self.overruns = self.steps = 0
        self.deadline = time.monotonic() + self.dt

    def wait(self) -> float:
        """Sleep until the deadline.

        Returns:
            Seconds that were slept; negative, by how much it was late, when the deadline had passed.
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
