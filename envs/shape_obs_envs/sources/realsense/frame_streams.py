"""Streams of raw frames: from a file on demand, or from a camera through a reader thread."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Final, Protocol

from shape_obs.source import CameraLost, CameraNotFound, FrameTimeout, SourceError
from shape_obs_envs.sources.live import FrameBuffer
from shape_obs_envs.sources.realsense.devices import Device
from shape_obs_envs.sources.realsense.session import RawFrame, Session

_LOG: Final = logging.getLogger(__name__)
_STEPS: Final = ("wait", "restart the pipeline", "reset the camera", "look for the camera again")
#: Seconds until a camera has disappeared after a reset.
_RESET: Final = 2.0

#: Seconds that the thread waits for a frame before it checks whether to stop.
_SLICE: Final = 0.05
#: The first frame after a start may take longer, by this factor.
_FIRST: Final = 3.0
#: Seconds to wait for librealsense to stop.
_CLOSING: Final = 10.0


class RecoveryPolicy:
    """Take one recovery step per call until frames come again or the time limit is reached.

    Args:
        device: The camera.
        open_session: Starts a new session, with a new context and config.
        recover_timeout: Seconds without a frame after which the camera counts as lost.
        stopping: Set when the camera is no longer needed.

    Attributes:
        state: The present step, for messages; empty while frames come.
    """

    def __init__(
        self,
        device: Device,
        open_session: Callable[[], Session],
        recover_timeout: float,
        stopping: threading.Event,
    ) -> None:
        self._device, self._open, self._stopping = device, open_session, stopping
        self._recover_timeout = recover_timeout
        self._step, self.state = 0, ""

    def reset(self, who: object) -> None:
        """Return to the first step, because a frame came."""
        if self._step:
            _LOG.warning("%s delivers frames again.", who)
        self._step, self.state = 0, ""

    def next_step(self, session: Session | None, silent: float) -> Session | None:
        """Take the next step.

        Args:
            session: The session that delivers no frames, or None.
            silent: Seconds since the last frame.

        Returns:
            The session to continue with; None while there is no camera.

        Raises:
            CameraLost: The time limit is reached.
        """
        who = str(session.identity) if session is not None else self._device.name
        if silent > self._recover_timeout:
            if session is not None:
                session.stop()
            raise CameraLost(
                f"{who} has delivered no frame for {silent:.1f} s, and neither a restart nor a reset helped"
                f"{self.state and f' ({self.state})'}: check the cable and its port, then connect again."
            )
        step = _STEPS[min(self._step, len(_STEPS) - 1)]
        self._step += 1
        self.state = f"step {min(self._step, len(_STEPS))} of {len(_STEPS)}: {step}"
        _LOG.warning("%s has delivered no frame for %.1f s; %s.", who, silent, self.state)
        if self._step == 1:
            return session
        if session is not None:
            session.stop()
        if step == "reset the camera":
            self._reset_camera()
        return self._reopen()

    def _reset_camera(self) -> None:
        try:
            self._device.find().hardware_reset()
        except (RuntimeError, SourceError) as error:
            _LOG.warning("%s could not be reset: %s", self._device.name, error)
        else:
            self._stopping.wait(_RESET)

    def _reopen(self) -> Session | None:
        if self._stopping.is_set():
            return None
        started = time.monotonic()
        try:
            session = self._open()
        except CameraNotFound as error:
            self.state = "it is not plugged in"
            _LOG.warning("%s", error)
        except (SourceError, RuntimeError) as error:
            self.state = f"it does not start: {error}"
            _LOG.warning("%s does not start: %s", self._device.name, error)
        else:
            _LOG.info("%s started in %.2f s.", session.identity, time.monotonic() - started)
            return session
        return None


class FrameStream(Protocol):
    """Raw frames, in order."""

    @property
    def dropped(self) -> int:
        """Number of frames that were not read in time."""
        ...

    def next(self, timeout: float, after: float | None) -> RawFrame:
        """Return the next frame; see ``RealSenseSource.read``. ``after`` is a ``time.monotonic()`` of exposure."""
        ...

    def latest(self) -> RawFrame | None:
        """Return the newest frame."""
        ...

    @property
    def over(self) -> bool:
        """Whether the stream delivers no more frames until it is reopened."""
        ...

    def close(self) -> None:
        """Stop."""
        ...


class FileStream:
    """A recording, played at the reader's pace: no frame is skipped.

    Args:
        session: Session of a recording.
    """

    def __init__(self, session: Session) -> None:
        self._session = session

    @property
    def dropped(self) -> int:
        """0: a recording waits for its reader."""
        return 0

    def next(self, timeout: float, after: float | None) -> RawFrame:
        """Return the next frame of the file; ``after`` is ignored."""
        raw = self._session.pull(timeout)
        if raw is None:
            raise FrameTimeout(f"The recording delivered no frame within {timeout:g} s: allow more time.")
        return raw

    def latest(self) -> RawFrame | None:
        """Return the next frame of the file, however long reading takes."""
        return self.next(float("inf"), None)

    @property
    def over(self) -> bool:
        """False: after its last frame a recording stays connected."""
        return False

    def close(self) -> None:
        """Stop."""
        self._session.stop()


class LiveStream:
    """A camera, read by its own thread into a short queue that keeps the newest frames.

    Args:
        device: The camera.
        open_session: Starts a session; the first one is started here.
        capacity: Largest number of queued frames.
        patience: Seconds without a frame after which recovery starts.
        recover_timeout: Seconds without a frame after which the camera counts as lost.

    Raises:
        SourceError: The first session did not start.
    """

    def __init__(
        self,
        device: Device,
        open_session: Callable[[], Session],
        capacity: int,
        patience: float,
        recover_timeout: float,
    ) -> None:
        self._patience, self._stopping = patience, threading.Event()
        self._recovery = RecoveryPolicy(device, open_session, recover_timeout, self._stopping)
        self._frames: FrameBuffer[RawFrame] = FrameBuffer(capacity)
        self._session: Session | None = open_session()
        self._who = self._session.identity
        self._thread = threading.Thread(target=self._run, name=f"{device.name} reader", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Number of frames that were not read in time."""
        return self._frames.dropped

    def next(self, timeout: float, after: float | None) -> RawFrame:
        """Return the oldest unread frame that was exposed after ``after``."""
        raw = self._frames.next(timeout, after)
        if raw is None:
            raise self._timeout_error(timeout)
        return raw

    def latest(self) -> RawFrame | None:
        """Return the newest frame, whether it was read before or not."""
        return self._frames.latest()

    @property
    def over(self) -> bool:
        """Whether the camera was lost."""
        return self._frames.over

    def close(self) -> None:
        """Stop the thread and the camera."""
        self._stopping.set()
        self._thread.join(_CLOSING)
        if self._thread.is_alive():
            _LOG.error("%s: librealsense does not return from stopping the camera; giving up.", self._who)

    def _timeout_error(self, timeout: float) -> FrameTimeout:
        silent = time.monotonic() - self._frames.last_arrival
        check = None if self._session is None else self._session.check
        refused = f" {check.refused} pairs were refused since: {check.reason}." if check and check.refused else ""
        return FrameTimeout(
            f"{self._who}: no new frame within {timeout:g} s; the last one came {silent:.1f} s ago.{refused}"
            f"{f' Recovery: {self._recovery.state}.' if self._recovery.state else ''}"
            " Check cable, port and processor load, or allow more time.",
            serial=self._who.serial,
            usb=self._who.usb,
        )

    def _run(self) -> None:
        end = "its reader ended with an internal error; see above"
        try:
            self._pump()
            end = "it was disconnected"
        except SourceError as error:
            end = str(error)
        finally:  # in any case: no reader may wait for a thread that has ended
            if self._session is not None:
                self._session.stop()
                self._session = None
            self._frames.end(lambda: CameraLost(end, serial=self._who.serial, usb=self._who.usb))

    def _pump(self) -> None:
        allowed, since = _FIRST * self._patience, self._frames.last_arrival
        while not self._stopping.is_set():
            raw = self._session.pull(_SLICE) if self._session is not None else self._pause()
            now = time.monotonic()
            if raw is not None:
                self._recovery.reset(self._who)
                self._frames.put(raw)
                allowed, since = self._patience, now
            elif now - since > allowed or self._session is None:
                before = self._session
                self._session = None  # a session that the recovery stops must not be stopped again
                self._session = self._recovery.next_step(before, now - self._frames.last_arrival)
                allowed, since = (1 if self._session is before else _FIRST) * self._patience, time.monotonic()

    def _pause(self) -> None:
        self._stopping.wait(_SLICE)
