"""How long the stages of a frame take."""

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
