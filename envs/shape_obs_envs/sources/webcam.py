"""A webcam, or a network camera's stream, through OpenCV: colour only."""

from __future__ import annotations

import os
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.calibration import IntrinsicsFit
from shape_obs.camera import CameraLike, as_intrinsics
from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import Frame
from shape_obs.source import CameraNotFound, SourceError
from shape_obs_envs.arguments import above_zero
from shape_obs_envs.sources.live import LiveSource
from shape_obs_envs.sources.rectification import Rectification

#: Milliseconds after which a stream that does not answer, or stops, counts as gone.
_OPEN_TIMEOUT: Final = 5000
_READ_TIMEOUT: Final = 3000
#: Frames per second that are assumed of a camera that reports none.
_USUAL_FPS: Final = 30.0
_PROPERTIES: Final = {
    "width": cv2.CAP_PROP_FRAME_WIDTH,
    "height": cv2.CAP_PROP_FRAME_HEIGHT,
    "fps": cv2.CAP_PROP_FPS,
}


class WebcamSource(LiveSource):
    """An ``RGBDSource`` without depth, from what ``cv2.VideoCapture`` opens as a camera.

    A thread reads the camera all the time: see ``LiveSource``. ``Frame.stamp`` is ``time.monotonic()`` when the frame
    arrived. Cameras do not report their exposure through OpenCV: it is assumed to have begun two frame intervals before
    the frame arrived.

    Args:
        device: The index of the camera, a device such as ``"/dev/video2"``, or the address of a stream
            (``"rtsp://..."``, ``"http://..."``).
        extrinsics: The pose of the camera, or a file that contains it; has no effect without intrinsics.
        width: Width of the images in pixels; None for the camera's own.
        height: Height of the images in pixels; None for the camera's own.
        fps: Frames per second to ask for; a warning reports another rate. Cameras may deliver less, in low light for
            example.
        fourcc: Pixel format to ask for, such as ``"MJPG"``, with which USB 2 carries larger images.
        intrinsics: The camera's intrinsics, in any form, or the file of ``shape-obs calibrate intrinsics``; frames are
            then rectified. None if unknown: frames are as the lens shows them, and have no camera.
        buffer: Largest number of frames that wait for a reader.
        patience: Seconds without a frame after which the camera counts as lost.

    Raises:
        ValueError: An argument is invalid.
        FileNotFoundError: The file of intrinsics or extrinsics does not exist.

    Example:
        >>> with WebcamSource(0, width=1280, height=720) as source:  # doctest: +SKIP
        ...     frame = source.read()
    """

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
        intrinsics: CameraLike | str | Path = None,
        buffer: int = 8,
        patience: float = 2.0,
    ) -> None:
        text = str(device)
        super().__init__(f"webcam:{text}", extrinsics, buffer=buffer, patience=patience)
        self._device: int | str = int(text) if text.isdecimal() else text
        self._mode = {"width": width, "height": height, "fps": fps}
        if is_stream(text) and (fourcc is not None or any(value is not None for value in self._mode.values())):
            raise ValueError(f"webcam:{text}: a stream has its own size, rate and format; leave them out.")
        for name, value in self._mode.items():
            above_zero(name, value)
        if fourcc is not None and len(str(fourcc)) != 4:
            raise ValueError(f"fourcc: expected four characters, such as MJPG, got {fourcc!r}.")
        self._fourcc = fourcc
        size = None if width is None or height is None else (height, width)
        lens = IntrinsicsFit.load(intrinsics).intrinsics if isinstance(intrinsics, (str, Path)) else intrinsics
        self._rectification = None if lens is None else Rectification.of(as_intrinsics(lens, size))
        self.lens = None if self._rectification is None else self._rectification.output
        self._capture: cv2.VideoCapture | None = None
        self._first: npt.NDArray[np.uint8] | None = None

    def open(self) -> None:
        """Open the camera, and check its first image.

        Raises:
            CameraNotFound: There is no such camera, or it cannot be opened.
            SourceError: It delivers no images, or images of another size.
        """
        capture = self._opened()
        try:
            self._first = self._first_image(capture)
        except SourceError:
            capture.release()
            raise
        fps, requested = capture.get(cv2.CAP_PROP_FPS), self._mode["fps"]
        known = 1 <= fps <= 1000
        self.latency = 2 / (fps if known else _USUAL_FPS)
        if requested and known and abs(fps - requested) > 0.01 * requested:
            warnings.warn(
                f"{self.name} has no {requested:g} frames a second at this size; it delivers {fps:g}.", stacklevel=3
            )
        self._capture = capture

    def grab(self, timeout: float) -> Frame | None:
        """Return the next image; OpenCV has its own time limits."""
        assert self._capture is not None
        image, self._first = self._first, None
        arrived = time.monotonic()
        if image is None:
            try:
                if not self._capture.grab():
                    return None
                arrived = time.monotonic()
                there, image = self._capture.retrieve()
            except cv2.error as error:
                raise SourceError(f"OpenCV cannot read it: {' '.join(str(error).split())}") from error
            if not there:
                return None
        return Frame(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8), stamp=arrived, received=arrived)

    def close(self) -> None:
        """Release the camera."""
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def finish(self, frame: Frame) -> Frame:
        """Rectify the image, if the lens is known."""
        lens = self._rectification
        if lens is None or lens.maps is None or frame.rgb is None:
            return super().finish(frame)
        return replace(frame, rgb=lens.colour(frame.rgb))

    def _opened(self) -> cv2.VideoCapture:
        device = self._device
        if isinstance(device, str) and is_stream(device):
            limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, _OPEN_TIMEOUT, cv2.CAP_PROP_READ_TIMEOUT_MSEC, _READ_TIMEOUT]
            capture = cv2.VideoCapture(device, cv2.CAP_FFMPEG, limits)
        elif isinstance(device, str) and not Path(device).exists():
            raise CameraNotFound(f"{self.name}: there is no {device}; {_found()}.")
        elif isinstance(device, str) and Path(device).is_file():
            raise CameraNotFound(
                f"{self.name}: this is a file, not a camera: give {self._device} itself as the source."
            )
        else:
            capture = cv2.VideoCapture(device)
        if not capture.isOpened():
            capture.release()
            raise CameraNotFound(f"{self.name}: it cannot be opened: {_advice(device)}.")
        if self._fourcc is not None:
            capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*self._fourcc))
        for name, value in self._mode.items():
            if value is not None:
                capture.set(_PROPERTIES[name], value)
        return capture

    def _first_image(self, capture: cv2.VideoCapture) -> npt.NDArray[np.uint8]:
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
        if self.lens is not None and self.lens.size != (height, width):
            raise SourceError(
                f"{self.name}: its images have {width} x {height} pixels, the intrinsics are for {self.lens.width} x "
                f"{self.lens.height}: ask for that size, or calibrate at this one."
            )
        return np.asarray(image, np.uint8)


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
