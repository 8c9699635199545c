"""Feeds: how raw frames come to whoever reads, out of a file on demand, or from a camera through a thread."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Final, Protocol

from shape_obs.source import CameraLost, FrameTimeout, SourceError
from shape_obs_envs.sources.realsense.ladder import Ladder
from shape_obs_envs.sources.realsense.origins import Origin
from shape_obs_envs.sources.realsense.raw import RawFrame
from shape_obs_envs.sources.realsense.session import Session

#: Seconds for which the thread looks for a frame before it looks whether it should stop.
_SLICE: Final = 0.05
#: After a start a camera takes longer until the first frame comes, by this factor.
_FIRST: Final = 3.0
#: Seconds to wait for librealsense to stop.
_CLOSING: Final = 10.0
_LOG: Final = logging.getLogger(__name__)


class Feed(Protocol):
    """Raw frames, in order."""

    dropped: int

    def next(self, timeout: float, after: float | None) -> RawFrame:
        """The next one; see `RealSenseSource.read`. ``after`` is a time (``time.monotonic()``) of exposure."""
        ...

    def latest(self) -> RawFrame | None:
        """The newest there is."""
        ...

    @property
    def over(self) -> bool:
        """Whether it gives no frames any more until it is opened anew."""
        ...

    def close(self) -> None:
        """Stop."""
        ...


class FileFeed:
    """A recording, played by whoever reads it: nothing is missed.

    Args:
        session: Of a recording.
    """

    def __init__(self, session: Session) -> None:
        self._session, self.dropped = session, 0

    def next(self, timeout: float, after: float | None) -> RawFrame:
        """The next one of the file; ``after`` means nothing."""
        raw = self._session.pull(timeout)
        if raw is None:
            raise FrameTimeout(f"No frame came out of the recording within {timeout:g} s: allow more time.")
        return raw

    def latest(self) -> RawFrame | None:
        """The next one of the file too, however long reading takes."""
        return self.next(float("inf"), None)

    @property
    def over(self) -> bool:
        """A recording that was played stays over."""
        return False

    def close(self) -> None:
        """Stop."""
        self._session.stop()


class LiveFeed:
    """A camera, read by a thread of its own into a short queue: when nobody reads, the newest frames stay.

    Args:
        origin: Where it comes from.
        open_session: Starts a session; the first is started here.
        capacity: Frames that wait at most.
        patience: Seconds without a frame after which something is done about it.
        recover_timeout: Seconds without a frame after which the camera is lost.

    Attributes:
        dropped: Frames that nobody read in time.

    Raises:
        SourceError: The first session did not start.
    """

    def __init__(
        self,
        origin: Origin,
        open_session: Callable[[], Session],
        capacity: int,
        patience: float,
        recover_timeout: float,
    ) -> None:
        self._patience, self._stopping = patience, threading.Event()
        self._ladder = Ladder(origin, open_session, recover_timeout, self._stopping)
        self._frames: deque[RawFrame] = deque(maxlen=capacity)
        self._changed = threading.Condition()
        self._newest: RawFrame | None = None
        self._lost: str | None = None
        self._last_frame = time.monotonic()
        self.dropped = 0
        self._session: Session | None = open_session()
        self._who = self._session.identity
        self._thread = threading.Thread(target=self._run, name=f"{origin.name} reader", daemon=True)
        self._thread.start()

    def next(self, timeout: float, after: float | None) -> RawFrame:
        """The oldest that nobody has read, and that was exposed after ``after``."""
        deadline = time.monotonic() + timeout
        with self._changed:
            while True:
                while self._frames:
                    raw = self._frames.popleft()
                    if after is None or raw.exposed >= after:
                        return raw
                self._check()
                left = deadline - time.monotonic()
                if left <= 0:
                    raise self._timeout(timeout)
                self._changed.wait(left)

    def latest(self) -> RawFrame | None:
        """The newest there is, read or not."""
        with self._changed:
            self._check()
            return self._newest

    @property
    def over(self) -> bool:
        """The camera was lost."""
        return self._lost is not None

    def close(self) -> None:
        """Stop the thread and the camera."""
        self._stopping.set()
        self._thread.join(_CLOSING)
        if self._thread.is_alive():
            _LOG.error("%s: librealsense does not come back from stopping it; left alone.", self._who)

    def _check(self) -> None:
        if self._lost is not None:
            raise CameraLost(self._lost, serial=self._who.serial, usb=self._who.usb)

    def _timeout(self, timeout: float) -> FrameTimeout:
        silent = time.monotonic() - self._last_frame
        gate = None if self._session is None else self._session.gate
        refused = f" {gate.refused} pairs were refused since: {gate.reason}." if gate and gate.refused else ""
        return FrameTimeout(
            f"{self._who}: no new frame within {timeout:g} s; the last one came {silent:.1f} s ago.{refused}"
            f"{f' Now: {self._ladder.state}.' if self._ladder.state else ''}"
            " Look after cable, port and processor load, or allow more time.",
            serial=self._who.serial,
            usb=self._who.usb,
        )

    def _run(self) -> None:
        end = "its reader ended by an error of its own; see above"
        try:
            self._pump()
            end = "it was disconnected"
        except SourceError as error:
            end = str(error)
        finally:  # whatever happened, nobody may wait for a thread that is gone
            if self._session is not None:
                self._session.stop()
                self._session = None
            with self._changed:
                self._lost = end
                self._changed.notify_all()

    def _pump(self) -> None:
        allowed, since = _FIRST * self._patience, self._last_frame
        while not self._stopping.is_set():
            raw = self._session.pull(_SLICE) if self._session is not None else self._pause()
            now = time.monotonic()
            if raw is not None:
                self._put(raw, now)
                allowed, since = self._patience, now
            elif now - since > allowed or self._session is None:
                before = self._session
                self._session = None  # what the ladder stops, nobody may stop again
                self._session = self._ladder.climb(before, now - self._last_frame)
                allowed, since = (1 if self._session is before else _FIRST) * self._patience, time.monotonic()

    def _pause(self) -> None:
        self._stopping.wait(_SLICE)

    def _put(self, raw: RawFrame, now: float) -> None:
        self._ladder.frame_came(self._who)
        with self._changed:
            self.dropped += len(self._frames) == self._frames.maxlen
            self._frames.append(raw)
            self._newest, self._last_frame = raw, now
            self._changed.notify_all()
