"""Base class of cameras that a thread reads, so that readers always get the newest frames."""

from __future__ import annotations

import atexit
import logging
import math
import threading
import time
from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final, Generic, Protocol, TypeVar

from shape_obs.camera import CameraModel, Intrinsics, as_intrinsics
from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import Frame
from shape_obs.source import CameraLost, FrameTimeout, NotConnected, Source, SourceError, StaleFrame
from shape_obs_envs.arguments import above_zero

#: Time in seconds that the thread lets ``grab`` wait, and waits itself after one that did not.
_SLICE: Final = 0.2
_PAUSE: Final = 0.01
#: Time in seconds to wait for a driver that does not return.
_CLOSING: Final = 5.0
_LOG: Final = logging.getLogger(__name__)


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


class LiveSource(Source):
    """Base of sources that read a camera: a subclass implements ``open``, ``grab`` and ``close``.

    A thread calls ``grab`` all the time and puts the frames into a queue of ``buffer`` frames that keeps the newest.
    When no frame comes for ``patience`` seconds the camera counts as lost; ``connect`` opens it again.

    Args:
        name: The name of the source in messages, such as ``"webcam:0"``; ``kind`` is what stands before the colon.
        extrinsics: The pose of the camera, or a file that contains it.
        buffer: Largest number of frames that wait for a reader.
        patience: Seconds without a frame after which the camera counts as lost.

    Attributes:
        lens: The intrinsics of every frame, without distortion, which ``open`` sets, in any form that
            ``as_camera_model`` reads; None if unknown.
        latency: Assumed time in seconds from the start of a frame's exposure to its arrival, for frames without
            ``exposed``; a subclass may set it in ``open``.

    Raises:
        ValueError: An argument is not above 0.
    """

    lens: Intrinsics | None
    latency: float
    live: bool = True
    has_depth: bool = True

    def __init__(
        self,
        name: str,
        extrinsics: Extrinsics | str | Path | None = None,
        *,
        buffer: int = 8,
        patience: float = 2.0,
    ) -> None:
        super().__init__(extrinsics)
        for argument, value in (("buffer", buffer), ("patience", patience)):
            above_zero(argument, value)
        self.name, self.kind = name, name.partition(":")[0]
        self.lens = None
        self.latency = 0.1
        self._model: CameraModel | None = None
        self._buffer, self._patience = buffer, patience
        self._frames: FrameBuffer[Frame] | None = None
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    # ---- what a subclass implements

    @abstractmethod
    def open(self) -> None:
        """Open the camera.

        Raises:
            SourceError: It is not there, or does not start; nothing is left open.
        """

    @abstractmethod
    def grab(self, timeout: float) -> Frame | None:
        """Return the next frame, or None if none comes in about ``timeout`` seconds; called by the thread.

        The frame needs ``rgb``, ``depth`` if the source has depth, and ``stamp``; ``camera``, ``received``, ``number``
        and ``exposed`` are filled in where they are None. Its arrays must not be changed afterwards.

        Raises:
            SourceError: The camera is lost.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the camera; called by the thread, after its last ``grab``."""

    def finish(self, frame: Frame) -> Frame:
        """Return a frame with arrays of the caller's own; a subclass may do here what only read frames need."""
        rgb, depth = frame.rgb, frame.depth
        return replace(frame, rgb=None if rgb is None else rgb.copy(), depth=None if depth is None else depth.copy())

    # ---- RGBDSource

    @property
    def intrinsics(self) -> Intrinsics | None:
        """The intrinsics of every frame, without distortion; None if unknown."""
        self.connected()
        return None if self.lens is None else as_intrinsics(self.lens)

    @property
    def dropped(self) -> int:
        """Number of frames since ``connect`` that were not read in time."""
        return self.connected().dropped

    def connect(self) -> None:
        """Open the camera and start to read it.

        Raises:
            SourceError: It cannot be opened; the subclass and the message give the reason.
        """
        if self._frames is not None:
            if not self._frames.over:
                return
            self.disconnect()  # the camera was lost
        self.open()
        self._frames, self._stopping = FrameBuffer(self._buffer), threading.Event()
        self._model = self.camera
        arguments = self._frames, self._stopping
        self._thread = threading.Thread(target=self._run, args=arguments, name=f"{self.name} reader", daemon=True)
        self._thread.start()
        atexit.register(self.disconnect)  # a process that ends while a driver reads may crash

    def read(self, timeout: float = 1.0, fresh: bool = False) -> Frame:
        """Wait for the next unread frame; with ``fresh``, for one whose assumed exposure began after the call."""
        called, frames = time.monotonic(), self.connected()
        frame = frames.next(timeout, called if fresh else None)
        if frame is None:
            silent = time.monotonic() - frames.last_arrival
            raise FrameTimeout(
                f"{self.name}: no new frame within {timeout:g} s; the last one came {silent:.1f} s ago. Check the "
                "cable and the processor load, or allow more time."
            )
        return self._finished(frame)

    def read_latest(self, max_age: float = 0.1) -> Frame:
        """Return the newest frame without waiting."""
        frame = self.connected().latest()
        age = math.inf if frame is None or frame.received is None else time.monotonic() - frame.received
        if frame is None or age > max_age:
            came = "none has come yet" if frame is None else f"the newest came {age:.3f} s ago"
            raise StaleFrame(f"{self.name}: expected a frame of the last {max_age:g} s, {came}.")
        return self._finished(frame)

    def disconnect(self) -> None:
        """Close the camera; does nothing if it is closed."""
        thread, self._thread, self._frames = self._thread, None, None
        if thread is None:
            return
        atexit.unregister(self.disconnect)
        self._stopping.set()
        thread.join(_CLOSING)
        if thread.is_alive():
            _LOG.error("%s: the driver does not return; the camera is released when it does.", self.name)

    def connected(self) -> FrameBuffer[Frame]:
        """Return the queue of frames.

        Raises:
            NotConnected: ``connect`` has not been called.
        """
        if self._frames is None:
            raise NotConnected(f"{self.name}: not connected: use `with source:`, or call connect() first.")
        return self._frames

    def _finished(self, frame: Frame) -> Frame:
        finished = self.finish(frame)
        return finished if finished.camera is not None else replace(finished, camera=self._model)

    def _run(self, frames: FrameBuffer[Frame], stopping: threading.Event) -> None:
        end = "its reader ended with an internal error; see above"
        try:
            end = self._read_until(frames, stopping)
        except SourceError as error:
            end = str(error)
        finally:  # in any case: no reader may wait for a thread that has ended
            message = f"{self.name}: {end}. Check it, and connect again."
            frames.end(lambda: CameraLost(message))
            self.close()

    def _read_until(self, frames: FrameBuffer[Frame], stopping: threading.Event) -> str:
        """Read the camera until it is lost or ``stopping`` is set; return why it ended."""
        number, last = 0, time.monotonic()
        while not stopping.is_set():
            frame = self.grab(_SLICE)
            now = time.monotonic()
            if frame is not None:
                received = now if frame.received is None else frame.received
                exposed = received - self.latency if frame.exposed is None else frame.exposed
                count = number if frame.number is None else frame.number
                frames.put(replace(frame, received=received, number=count, exposed=exposed))
                number, last = number + 1, now
            elif now - last > self._patience:
                return f"no frame for {self._patience:g} s: the camera was unplugged or stopped, or its stream ended"
            else:
                stopping.wait(_PAUSE)
        return "it was disconnected"
