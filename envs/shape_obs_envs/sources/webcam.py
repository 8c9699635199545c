"""A webcam, or a network camera's stream, through OpenCV: colour only."""

from __future__ import annotations

import atexit
import logging
import math
import os
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from shape_obs.calibration import IntrinsicsFit
from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import Frame
from shape_obs.source import CameraLost, CameraNotFound, FrameTimeout, NotConnected, Source, SourceError, StaleFrame
from shape_obs_envs.sources.frame_buffer import FrameBuffer
from shape_obs_envs.sources.rectification import Rectification

#: Time in seconds that the reader waits before it asks a silent camera again.
_PAUSE: Final = 0.01
#: Time in seconds to wait for a driver that does not return.
_CLOSING: Final = 5.0
#: Milliseconds after which a stream that does not answer, or stops, counts as gone.
_OPEN_TIMEOUT: Final = 5000
_READ_TIMEOUT: Final = 3000
_PROPERTIES: Final = {
    "width": cv2.CAP_PROP_FRAME_WIDTH,
    "height": cv2.CAP_PROP_FRAME_HEIGHT,
    "fps": cv2.CAP_PROP_FPS,
}
_LOG: Final = logging.getLogger(__name__)


class WebcamSource(Source):
    """An ``RGBDSource`` without depth, from what ``cv2.VideoCapture`` opens as a camera.

    A thread reads the camera all the time, so that frames are new, into a queue of ``buffer`` frames that keeps the
    newest. ``Frame.stamp`` is ``time.monotonic()`` when the frame arrived. Cameras do not report their exposure through
    OpenCV: it is assumed to have begun two frame intervals before the frame arrived.

    When no frame comes for ``patience`` seconds the camera counts as lost; ``connect`` opens it again.

    Args:
        device: The index of the camera, a device such as ``"/dev/video2"``, or the address of a stream
            (``"rtsp://..."``, ``"http://..."``).
        extrinsics: The pose of the camera, or a file that contains it; has no effect without intrinsics.
        width: Width of the images in pixels; None for the camera's own.
        height: Height of the images in pixels; None for the camera's own.
        fps: Frames per second to ask for; cameras may deliver less, in low light for example.
        fourcc: Pixel format to ask for, such as ``"MJPG"``, with which USB 2 carries larger images.
        intrinsics: The camera's intrinsics, or the file of ``shape-obs calibrate intrinsics``; frames are then
            rectified. None if unknown: frames are as the lens shows them, and have no camera.
        buffer: Largest number of frames that wait for a reader.
        patience: Seconds without a frame after which the camera counts as lost.

    Raises:
        ValueError: An argument is invalid.
        FileNotFoundError: The file of intrinsics or extrinsics does not exist.

    Example:
        >>> with WebcamSource(0, width=1280, height=720) as source:  # doctest: +SKIP
        ...     frame = source.read()
    """

    kind: str = "webcam"
    live: bool = True
    has_depth: bool = False

    def __init__(
        self,
        device: int | str = 0,
        extrinsics: Extrinsics | str | Path | None = None,
        *,
        width: int | None = None,
        height: int | None = None,
        fps: float | None = None,
        fourcc: str | None = None,
        intrinsics: Intrinsics | str | Path | None = None,
        buffer: int = 8,
        patience: float = 2.0,
    ) -> None:
        super().__init__(extrinsics)
        text = str(device)
        self._device: int | str = int(text) if text.isdecimal() else text
        self._mode = {"width": width, "height": height, "fps": fps}
        if is_stream(text) and (fourcc is not None or any(value is not None for value in self._mode.values())):
            raise ValueError(f"webcam:{text}: a stream has its own size, rate and format; leave them out.")
        for name, value in (*self._mode.items(), ("buffer", buffer), ("patience", patience)):
            if value is not None and not value > 0:
                raise ValueError(f"{name}: expected more than 0, got {value!r}.")
        if fourcc is not None and len(str(fourcc)) != 4:
            raise ValueError(f"fourcc: expected four characters, such as MJPG, got {fourcc!r}.")
        self.name = f"webcam:{text}"
        self._fourcc, self._buffer, self._patience = fourcc, buffer, patience
        lens = IntrinsicsFit.load(intrinsics).intrinsics if isinstance(intrinsics, (str, Path)) else intrinsics
        self._rectification = None if lens is None else Rectification.of(lens)
        self._model: CameraModel | None = None
        self._frames: FrameBuffer[Frame] | None = None
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def dropped(self) -> int:
        """Number of frames since ``connect`` that were not read in time."""
        return self._connected().dropped

    @property
    def intrinsics(self) -> Intrinsics | None:
        """The given intrinsics without their distortion; None if unknown."""
        self._connected()
        return None if self._rectification is None else self._rectification.output

    def connect(self) -> None:
        """Open the camera and wait for its first frame.

        Raises:
            CameraNotFound: There is no such camera, or it cannot be opened.
            SourceError: It delivers no images, or images of another size.
        """
        if self._frames is not None:
            if not self._frames.over:
                return
            self.disconnect()  # the camera was lost
        capture = self._opened()
        try:
            image = self._first_image(capture)
        except SourceError:
            capture.release()
            raise
        self._frames, self._stopping = FrameBuffer(self._buffer), threading.Event()
        self._model = self.camera
        fps = capture.get(cv2.CAP_PROP_FPS)
        interval = 1 / fps if 1 <= fps <= 1000 else 1 / 30
        arguments = (capture, image, interval, self._frames, self._stopping)
        self._thread = threading.Thread(target=self._run, args=arguments, name=f"{self.name} reader", daemon=True)
        self._thread.start()
        atexit.register(self.disconnect)  # a process that ends while a driver reads may crash

    def read(self, timeout: float = 1.0, fresh: bool = False) -> Frame:
        """Wait for the next unread frame; with ``fresh``, for one whose assumed exposure began after the call."""
        called, frames = time.monotonic(), self._connected()
        frame = frames.next(timeout, called if fresh else None)
        if frame is None:
            silent = time.monotonic() - frames.last_arrival
            raise FrameTimeout(
                f"{self.name}: no new frame within {timeout:g} s; the last one came {silent:.1f} s ago. Check the "
                "cable and the processor load, or allow more time."
            )
        return self._rectified(frame)

    def read_latest(self, max_age: float = 0.1) -> Frame:
        """Return the newest frame without waiting."""
        frame = self._connected().latest()
        age = math.inf if frame is None or frame.received is None else time.monotonic() - frame.received
        if frame is None or age > max_age:
            came = "none has come yet" if frame is None else f"the newest came {age:.3f} s ago"
            raise StaleFrame(f"{self.name}: expected a frame of the last {max_age:g} s, {came}.")
        return self._rectified(frame)

    def disconnect(self) -> None:
        """Release the camera; does nothing if it is released."""
        thread, self._thread, self._frames = self._thread, None, None
        if thread is None:
            return
        atexit.unregister(self.disconnect)
        self._stopping.set()
        thread.join(_CLOSING)
        if thread.is_alive():
            _LOG.error(
                "%s: the driver does not return from reading the camera; it is released when it does.", self.name
            )

    def _connected(self) -> FrameBuffer[Frame]:
        if self._frames is None:
            raise NotConnected(f"{self.name}: not connected: use `with source:`, or call connect() first.")
        return self._frames

    def _opened(self) -> cv2.VideoCapture:
        if isinstance(self._device, str) and is_stream(self._device):
            limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, _OPEN_TIMEOUT, cv2.CAP_PROP_READ_TIMEOUT_MSEC, _READ_TIMEOUT]
            capture = cv2.VideoCapture(self._device, cv2.CAP_FFMPEG, limits)
        elif isinstance(self._device, str) and not Path(self._device).exists():
            raise CameraNotFound(f"{self.name}: there is no {self._device}; {_found()}.")
        elif isinstance(self._device, str) and Path(self._device).is_file():
            raise CameraNotFound(
                f"{self.name}: this is a file, not a camera: give {self._device} itself as the source."
            )
        else:
            capture = cv2.VideoCapture(self._device)
        if not capture.isOpened():
            capture.release()
            raise CameraNotFound(f"{self.name}: it cannot be opened: {_advice(self._device)}.")
        if self._fourcc is not None:
            capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*self._fourcc))
        for name, value in self._mode.items():
            if value is not None:
                capture.set(_PROPERTIES[name], value)
        return capture

    def _first_image(self, capture: cv2.VideoCapture) -> cv2.typing.MatLike:
        there, image = capture.read()
        if not there:
            raise SourceError(
                f"{self.name}: it opens but delivers no image: close other programs that use it, try another USB port, "
                "or ask for a smaller size or another format, such as --set fourcc=MJPG."
            )
        height, width = image.shape[:2]
        asked = self._mode["width"] or width, self._mode["height"] or height
        if asked != (width, height):
            raise SourceError(
                f"{self.name} has no {asked[0]:g} x {asked[1]:g} pixels; the nearest is {width} x {height}: ask for "
                "that."
            )
        if self._rectification is not None and self._rectification.output.size != (height, width):
            lens = self._rectification.output
            raise SourceError(
                f"{self.name}: its images have {width} x {height} pixels, the intrinsics are for {lens.width} x "
                f"{lens.height}: ask for that size, or calibrate at this one."
            )
        return image

    def _run(
        self,
        capture: cv2.VideoCapture,
        image: cv2.typing.MatLike,
        interval: float,
        frames: FrameBuffer[Frame],
        stopping: threading.Event,
    ) -> None:
        """Read the camera until it is lost or ``stopping`` is set. Only this thread uses and releases ``capture``."""
        end, number, arrived = "its reader ended with an internal error; see above", 0, time.monotonic()
        try:
            while not stopping.is_set():
                rgb = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)
                exposed = arrived - 2 * interval
                frames.put(Frame(rgb, None, None, arrived, arrived, number, exposed))
                there = False
                while not there and not stopping.is_set() and time.monotonic() - arrived < self._patience:
                    there = capture.grab()
                    if not there:
                        stopping.wait(_PAUSE)
                if not there:
                    break
                arrived, number = time.monotonic(), number + 1
                there, image = capture.retrieve()
                if not there:
                    break
            end = "it was disconnected"
            if not stopping.is_set():
                end = f"no frame for {self._patience:g} s: the camera was unplugged or stopped, or its stream ended"
        except cv2.error as error:
            end = f"OpenCV cannot read it: {' '.join(str(error).split())}"
        finally:  # in any case: no reader may wait for a thread that has ended
            capture.release()
            message = f"{self.name}: {end}. Check it, and connect again."
            frames.end(lambda: CameraLost(message))

    def _rectified(self, frame: Frame) -> Frame:
        """Return a frame of the caller's own, with the camera."""
        assert frame.rgb is not None
        lens = self._rectification
        rgb = frame.rgb.copy() if lens is None or lens.maps is None else lens.colour(frame.rgb)
        return replace(frame, rgb=rgb, camera=self._model)


def is_stream(device: str) -> bool:
    """Return whether a device of a ``WebcamSource`` is the address of a stream."""
    return "://" in device


def _advice(device: int | str) -> str:
    """Return what is wrong with a camera that cannot be opened."""
    if isinstance(device, str) and is_stream(device):
        return "the address does not answer, or not with a stream that OpenCV's FFmpeg decodes"
    if sys.platform != "linux":
        return "check that it is plugged in, and that this program may use the camera in the system's privacy settings"
    path = Path(f"/dev/video{device}" if isinstance(device, int) else device)
    if not path.exists():
        return f"there is no {path}; {_found()}"
    if not os.access(path, os.R_OK | os.W_OK):
        return f"{path} may not be read by this user: add the user to the group 'video' and log in again"
    return f"{path} is in use by another program, or is not a capture device (a webcam often has two); {_found()}"


def _found() -> str:
    devices = sorted(str(path) for path in Path("/dev").glob("video*"))
    return f"found {', '.join(devices)}" if devices else "no camera is plugged in"
