"""A short queue between the thread that reads a camera and its readers; it keeps the newest frames."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from shape_obs.source import SourceError


class Timed(Protocol):
    """A frame with the time of its exposure."""

    @property
    def exposed(self) -> float | None:
        """Earliest start of the exposure: ``time.monotonic()`` in seconds; None if unknown."""
        ...


T = TypeVar("T", bound=Timed)


class FrameBuffer(Generic[T]):
    """Hold the newest frames of a camera for its readers. All methods may be called from any thread.

    Args:
        capacity: Largest number of unread frames; the oldest is dropped for a new one.

    Attributes:
        dropped: Number of frames that were not read in time.
        last_arrival: When the newest frame arrived, or the buffer was made: ``time.monotonic()`` in seconds.
    """

    def __init__(self, capacity: int) -> None:
        self._unread: deque[T] = deque(maxlen=capacity)
        self._changed = threading.Condition()
        self._newest: T | None = None
        self._end: Callable[[], SourceError] | None = None
        self.dropped, self.last_arrival = 0, time.monotonic()

    def put(self, frame: T) -> None:
        """Add a frame."""
        with self._changed:
            self.dropped += len(self._unread) == self._unread.maxlen
            self._unread.append(frame)
            self._newest, self.last_arrival = frame, time.monotonic()
            self._changed.notify_all()

    def end(self, error: Callable[[], SourceError]) -> None:
        """Let readers fail, once they have read what is left.

        Args:
            error: Makes the error, a new one for each reader.
        """
        with self._changed:
            self._end = error
            self._changed.notify_all()

    @property
    def over(self) -> bool:
        """Whether no more frames come."""
        return self._end is not None

    def next(self, timeout: float, after: float | None) -> T | None:
        """Return the oldest unread frame; None if none comes in time.

        Args:
            timeout: Longest time to wait, in seconds.
            after: Skip frames that were exposed before this ``time.monotonic()``; None to skip none.

        Raises:
            SourceError: No more frames come.
        """
        deadline = time.monotonic() + timeout
        with self._changed:
            while True:
                while self._unread:
                    frame = self._unread.popleft()
                    if after is None or frame.exposed is None or frame.exposed >= after:
                        return frame
                self._check_not_over()
                left = deadline - time.monotonic()
                if left <= 0:
                    return None
                self._changed.wait(left)

    def latest(self) -> T | None:
        """Return the newest frame, whether it was read before or not; None before the first.

        Raises:
            SourceError: No more frames come.
        """
        with self._changed:
            self._check_not_over()
            return self._newest

    def _check_not_over(self) -> None:
        if self._end is not None:
            raise self._end()
