"""A source of RGB-D frames from a D400 camera on USB, a software D455, or a recording."""

from __future__ import annotations

import atexit
import math
import re
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from shape_obs.camera import Intrinsics
from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import Frame
from shape_obs.source import NotConnected, Source, StaleFrame
from shape_obs_envs.arguments import above_zero, count
from shape_obs_envs.sources.realsense.devices import Device, RecordingFile, SoftwareCameras, UsbCamera
from shape_obs_envs.sources.realsense.driver import librealsense, recording_suffix
from shape_obs_envs.sources.realsense.frame_streams import FileStream, FrameStream, LiveStream
from shape_obs_envs.sources.realsense.session import RawFrame, Session, Setup
from shape_obs_envs.sources.realsense.settings import CameraOptions, Filter, check_filters
from shape_obs_envs.sources.realsense.software import SoftwareD455
from shape_obs_envs.sources.rectification import Rectification
from shape_obs_envs.sources.registration import Registration

#: The models of cameras that ``RealSenseSource`` reads.
MODEL: Final = re.compile(r"d4\d\d", re.IGNORECASE)


class RealSenseSource(Source):
    """An ``RGBDSource`` through librealsense: colour rectified to a pinhole, depth aligned to it, in millimetres.

    A thread reads a live camera into a queue of ``buffer`` frames that keeps the newest. A pair of images is passed on
    only if both are new and of the same moment, so a frozen stream never looks alive. When no frames come, the thread
    waits, restarts the pipeline, resets the camera and looks it up again, one step every ``patience`` seconds (three
    times that after a start), and logs each step. Meanwhile ``read`` keeps its timeout. After ``recover_timeout``
    seconds the camera counts as lost; ``connect`` starts again.

    A recording has no clock: it waits for its reader, and each complete pair is returned once.

    ``Frame.stamp`` is the colour image's, in seconds by the camera's clock: for a D455 on USB the time of day
    (librealsense's global time), otherwise the clock of the recording or software camera. ``Frame.number`` is the
    colour camera's counter. ``Frame.exposed`` of a live camera follows from global time and exposure; without global
    time the exposure is assumed to have begun two frame intervals before the frame arrived.

    Args:
        device: A ``SoftwareD455``, or several of which ``serial`` selects one; None for a camera on USB.
        serial: Serial number of the camera; None for the only one.
        depth: Whether to read depth; None to read it from every camera, and from a recording that has it.
        model: Which of several cameras on USB to use: ``"d455"``, ``"d435"``, ``"d405"``, ...; ``"d400"`` for any. A
            single camera is used whatever its model. It is the source's ``kind``.
        recording: A .db3 or .bag file to read instead of a camera.
        width: Width of both streams in pixels. A recording has its own mode: this and all below is for cameras.
        height: Height of both streams in pixels.
        fps: Frames per second.
        exposure: Exposure of the colour camera in seconds; None for automatic.
        gain: Gain of the colour camera in its own units; None for automatic.
        white_balance: White balance of the colour camera in kelvin; None for automatic.
        laser_power: Power of the projector in milliwatts; 0 for off, None to keep it.
        preset: Preset of the depth camera: ``"default"``, ``"hand"``, ``"high_accuracy"``, ``"high_density"`` or
            ``"medium_density"``; None to keep it.
        filters: Depth filters, also for recordings: ``"temporal"``, ``"spatial"``, ``"threshold"``, ``"hole_filling"``,
            or a pair of a name and parameters, ``("temporal", {"alpha": 0.4})``.
        extrinsics: Pose of the camera, or a file that contains it.
        record_to: New .db3 file to which everything from the camera is recorded. After a restart of the pipeline the
            recording continues in a second file, ``NAME-2.db3``.
        buffer: Largest number of frames that wait for a reader.
        max_gap: Largest time in seconds between colour and depth of a pair; None for 3/4 of a frame interval.
        patience: Seconds without a frame after which recovery starts; ``math.inf`` for never.
        recover_timeout: Seconds without a frame after which a camera counts as lost.

    Attributes:
        options: Exposure and other options, as set by ``connect``.
        timings: Milliseconds that the last frame took: ``"register"``, to rectify colour and align depth to it.

    Raises:
        ValueError: An argument is invalid.
        FileNotFoundError: The extrinsics file does not exist.

    Example:
        >>> camera = SoftwareD455()  # doctest: +SKIP
        >>> with RealSenseSource(camera) as source:  # doctest: +SKIP
        ...     camera.push(rgb, depth)
        ...     frame = source.read()
    """

    options: CameraOptions
    timings: dict[str, float]

    def __init__(
        self,
        device: SoftwareD455 | Sequence[SoftwareD455] | None = None,
        *,
        serial: str | int | None = None,
        model: str = "d455",
        recording: str | Path | None = None,
        depth: bool | None = None,
        width: int = 640,
        height: int = 480,
        fps: int = 30,
        exposure: float | None = None,
        gain: float | None = None,
        white_balance: float | None = None,
        laser_power: float | None = None,
        preset: str | None = None,
        filters: Sequence[Filter] = (),
        extrinsics: Extrinsics | str | Path | None = None,
        record_to: str | Path | None = None,
        buffer: int = 8,
        max_gap: float | None = None,
        patience: float = 1.0,
        recover_timeout: float = 15.0,
    ) -> None:
        super().__init__(extrinsics)
        if recording is not None and (device is not None or serial is not None or record_to is not None):
            raise ValueError("recording: a file is read instead of a camera; do not give device, serial or record_to.")
        for name, number in (("buffer", buffer), ("patience", patience), ("recover_timeout", recover_timeout)):
            above_zero(name, number)
        if not MODEL.fullmatch(model):
            raise ValueError(f"model: expected a camera of the D400 series, such as 'd455' or 'd435', got {model!r}.")
        check_filters(filters)
        self.options = CameraOptions(exposure, gain, white_balance, laser_power, preset)
        if recording is not None and self.options != CameraOptions():
            raise ValueError(f"recording: its images are as they were taken; leave out what is set in {self.options}.")
        mode = count("width", width, 1), count("height", height, 1), count("fps", fps, 1)
        self._setup = Setup(*mode, self.options, tuple(filters), max_gap, depth)
        self._device = _device(device, None if serial is None else str(serial), recording, model.lower())
        self._record_to = None if record_to is None else Path(record_to)
        self._buffer, self._patience, self._recover_timeout = buffer, patience, recover_timeout
        self.timings = {}
        self._stream: FrameStream | None = None
        self._lock = threading.Lock()  # guards registration and the last frame: several threads may read
        self._runs = 0

    @property
    def kind(self) -> str:
        """The model, such as ``"d455"``; ``"software"`` or ``"recording"``."""
        return self._device.kind

    @property
    def name(self) -> str:
        """``"d455:SERIAL"``, ``"software:SERIAL"`` or the path."""
        known = self._device.live and self._stream is not None and self.serial
        return f"{self.kind}:{self.serial}" if known else self._device.name

    @property
    def serial(self) -> str | None:
        """The camera's serial number; None before ``connect``."""
        return None if self._stream is None else self._identity.serial

    @property
    def live(self) -> bool:
        """Whether frames come at their own rate."""
        return self._device.live

    @property
    def has_depth(self) -> bool:
        """Whether frames have depth; of a recording it is known once it is connected, unless it was asked for."""
        if self._setup.depth is None and not self.live:
            self._connected()
            return self._registration is not None
        return self._setup.depth is not False

    @property
    def dropped(self) -> int:
        """Number of frames since ``connect`` that were not read in time."""
        return self._connected().dropped

    @property
    def intrinsics(self) -> Intrinsics:
        """Intrinsics of all frames, a pinhole.

        Raises:
            NotConnected: ``connect`` has not been called.
        """
        self._connected()
        return self._rectification.output

    def connect(self) -> None:
        """Find the camera or file and start it, unless it is already running.

        Raises:
            CameraNotFound: The camera is not connected.
            SeveralCameras: There are several cameras, and no serial number was given.
            BadRecording: The file is not a recording, or incomplete.
            SourceError: The camera is in use, or does not have the mode or an option.
            ImportError: librealsense is not installed.
        """
        if self._stream is not None:
            if not self._stream.over:
                return
            self.disconnect()  # the camera was lost
        librealsense()
        self._runs = 0
        if self.live:
            self._stream = LiveStream(self._device, self._session, self._buffer, self._patience, self._recover_timeout)
        else:
            self._stream = FileStream(self._session())
        self._model, self._last = self.camera, None
        atexit.register(self.disconnect)  # librealsense aborts a process that ends while it streams

    def read(self, timeout: float = 1.0, fresh: bool = False) -> Frame:
        """Wait for the next unread frame.

        Args:
            timeout: Longest time to wait in seconds.
            fresh: Skip frames whose exposure began before this call. With librealsense's global time (a D455 on USB)
                the exposure is known; without it, frames of the first two intervals after the call are skipped, about
                the time that a D455 takes from exposure to arrival. A software camera exposes when it is pushed. A
                recording returns its next frame.

        Raises:
            FrameTimeout: No frame came in time.
            EndOfSource: The recording has ended.
            CameraLost: The camera is lost.
            NotConnected: ``connect`` has not been called.
        """
        called = time.monotonic()
        feed = self._connected()
        return self._frame(feed.next(timeout, called if fresh else None))

    def read_latest(self, max_age: float = 0.1) -> Frame:
        """Return the newest frame without waiting; the same frame again until a newer one comes.

        Args:
            max_age: Largest time in seconds since it arrived. A recording returns its next frame at any age.

        Raises:
            StaleFrame: The newest frame is older, or there is none yet.
            EndOfSource: The recording has ended.
            CameraLost: The camera is lost.
            NotConnected: ``connect`` has not been called.
        """
        raw = self._connected().latest()
        age = math.inf if raw is None else time.monotonic() - raw.received
        if raw is None or (self.live and age > max_age):
            came = "none has come yet" if raw is None else f"the newest came {age:.3f} s ago"
            raise StaleFrame(
                f"{self._identity}: expected a frame of the last {max_age:g} s, {came}.",
                serial=self._identity.serial,
                usb=self._identity.usb,
            )
        return self._frame(raw)

    def disconnect(self) -> None:
        """Stop the camera or file; does nothing if it is stopped."""
        feed, self._stream = self._stream, None
        if feed is not None:
            atexit.unregister(self.disconnect)
            feed.close()

    def _connected(self) -> FrameStream:
        if self._stream is None:
            raise NotConnected(f"{self._device.name}: not connected; call connect() first, or use `with source:`.")
        return self._stream

    def _session(self) -> Session:
        session = Session(self._device, self._setup, self._next_file())
        self._identity, geometry = session.identity, session.geometry
        if self._runs == 0:
            self._rectification = Rectification.of(session.lens)
            self._registration = geometry and Registration(
                geometry.colour, geometry.depth, geometry.rotation, geometry.translation, geometry.depth_unit
            )
        self._runs += 1
        return session

    def _next_file(self) -> Path | None:
        path = self._record_to
        if path is None:
            return None
        if path.suffix != recording_suffix():
            raise ValueError(f"record_to: this librealsense writes {recording_suffix()} files, got {str(path)!r}.")
        first, number = path, 1
        while self._runs and (number == 1 or path.exists()):
            number += 1
            path = first.with_name(f"{first.stem}-{number}{first.suffix}")
        if path.exists():
            raise FileExistsError(f"record_to: {path} exists already: remove it, or choose another name.")
        return path

    def _frame(self, raw: RawFrame) -> Frame:
        with self._lock:
            if self._last is None or self._last[0] is not raw:
                begin = time.perf_counter()
                if self._registration is None or raw.depth is None:
                    rgb, depth = self._rectification.colour(raw.colour), None
                else:
                    rgb, depth = self._registration(raw.colour, raw.depth)
                self.timings = {"register": 1e3 * (time.perf_counter() - begin)}
                self._last = raw, rgb, depth
            _, rgb, depth = self._last
            exposed = raw.exposed if self.live else None
            depth = None if depth is None else depth.copy()
            return Frame(rgb.copy(), depth, self._model, raw.stamp, raw.received, raw.number, exposed)


def _device(
    device: SoftwareD455 | Sequence[SoftwareD455] | None,
    serial: str | None,
    recording: str | Path | None,
    model: str,
) -> Device:
    if recording is not None:
        return RecordingFile(Path(recording))
    if device is None:
        return UsbCamera(serial, model)
    return SoftwareCameras([device] if isinstance(device, SoftwareD455) else list(device), serial)
