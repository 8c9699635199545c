"""RealSenseSource: a D455 on USB, a software D455, or a recording of one, read in the same way."""

from __future__ import annotations

import atexit
import math
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from shape_obs.camera import Intrinsics
from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import Frame
from shape_obs.source import NotConnected, Source, StaleFrame
from shape_obs_envs.sources.realsense.driver import librealsense, recording_suffix
from shape_obs_envs.sources.realsense.feeds import Feed, FileFeed, LiveFeed
from shape_obs_envs.sources.realsense.filters import Filter, check_names
from shape_obs_envs.sources.realsense.options import CameraOptions
from shape_obs_envs.sources.realsense.origins import Camera, Origin, Recording, SoftwareCameras
from shape_obs_envs.sources.realsense.raw import RawFrame
from shape_obs_envs.sources.realsense.session import Session, Setup
from shape_obs_envs.sources.realsense.software import SoftwareD455
from shape_obs_envs.sources.registration import Registration


class RealSenseSource(Source):
    """An `RGBDSource` through librealsense: colour rectified to a pinhole, depth aligned to it, in millimetres.

    A live camera is read by a thread, into a queue of ``buffer`` frames where the newest win. A pair of images is
    passed on only when both are new and of the same moment, so that a stream that froze never looks alive. When
    frames stay away, the thread waits on, restarts the pipeline, resets the camera and looks for it again, a step
    every ``patience`` seconds (three times that after a start), and logs what it does. Meanwhile `read` keeps to its
    timeout. After ``recover_timeout`` seconds the camera is lost; `connect` starts anew.

    A recording has no clock: it waits for whoever reads, and every whole pair comes out once.

    ``Frame.stamp`` is the colour image's, in seconds by the camera's clock: with a D455 on USB the time of day
    (librealsense's global time), otherwise as the recording or the software camera tells. ``Frame.number`` is the
    colour camera's count. ``Frame.exposed`` of a live camera follows from the global time and the exposure; without
    global time the exposure is taken to have begun two frame intervals before the frame arrived.

    Args:
        device: A `SoftwareD455`, or several of which ``serial`` says which; None for a camera on USB.
        serial: Serial number of the camera; None for the only one.
        recording: A .db3 or .bag file, instead of a camera.
        width: Of both streams, pixels. A recording has its own mode: this and all below is for cameras.
        height: Of both streams, pixels.
        fps: Frames per second.
        exposure: Of the colour camera, seconds; None for automatic.
        gain: Of the colour camera, in its units; None for automatic.
        white_balance: Of the colour camera, kelvin; None for automatic.
        laser_power: Of the projector, milliwatts; 0 for off, None as it is.
        preset: Of the depth camera: ``"default"``, ``"hand"``, ``"high_accuracy"``, ``"high_density"`` or
            ``"medium_density"``; None as it is.
        filters: Of depth, of a recording too: ``"temporal"``, ``"spatial"``, ``"threshold"``, ``"hole_filling"``, or a
            pair of a name and parameters, ``("temporal", {"alpha": 0.4})``.
        extrinsics: Where the camera stands, or the file that says so.
        record_to: Write all that the camera gives into this new .db3 file. When the pipeline is restarted, the
            recording goes on in a second file, ``NAME-2.db3``.
        buffer: Frames that wait for a reader at most.
        max_gap: Seconds that colour and depth of a pair may be apart; None for three quarters of a frame interval.
        patience: Seconds without a frame after which something is done about it; ``math.inf`` for never.
        recover_timeout: Seconds without a frame after which a camera is lost.

    Attributes:
        options: Exposure and the like, as they are set at `connect`.
        timings: Milliseconds that the last frame took: ``"register"``, to rectify colour and align depth to it.

    Raises:
        ValueError: An argument that makes no sense.
        FileNotFoundError: There is no such extrinsics file.

    Example:
        >>> camera = SoftwareD455()  # doctest: +SKIP
        >>> with RealSenseSource(camera) as source:  # doctest: +SKIP
        ...     camera.push(rgb, depth)
        ...     frame = source.read()
    """

    def __init__(
        self,
        device: SoftwareD455 | Sequence[SoftwareD455] | None = None,
        *,
        serial: str | None = None,
        recording: str | Path | None = None,
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
            raise ValueError("recording: a file is read instead of a camera; give no device, serial or record_to.")
        for name, number in (("buffer", buffer), ("patience", patience), ("recover_timeout", recover_timeout)):
            if not number > 0:
                raise ValueError(f"{name}: expected more than 0, got {number}.")
        check_names(filters)
        self.options = CameraOptions(exposure, gain, white_balance, laser_power, preset)
        self._setup = Setup(width, height, fps, self.options, tuple(filters), max_gap)
        self._origin = _origin(device, serial, recording)
        self._record_to = None if record_to is None else Path(record_to)
        self._buffer, self._patience, self._recover_timeout = buffer, patience, recover_timeout
        self.timings: dict[str, float] = {}
        self._feed: Feed | None = None
        self._lock = threading.Lock()  # registration and the last frame, for readers in several threads
        self._runs = 0

    @property
    def kind(self) -> str:
        """``"d455"``, ``"software"`` or ``"recording"``."""
        return self._origin.kind

    @property
    def name(self) -> str:
        """``"d455:SERIAL"``, ``"software:SERIAL"`` or the path."""
        known = self._origin.live and self._feed is not None and self.serial
        return f"{self.kind}:{self.serial}" if known else self._origin.name

    @property
    def serial(self) -> str | None:
        """The camera's serial number; None before `connect`."""
        return None if self._feed is None else self._identity.serial

    @property
    def live(self) -> bool:
        """Whether frames come at their own pace."""
        return self._origin.live

    @property
    def has_depth(self) -> bool:
        """Always."""
        return True

    @property
    def dropped(self) -> int:
        """Frames since `connect` that came and that nobody read in time."""
        return self._connected().dropped

    @property
    def intrinsics(self) -> Intrinsics:
        """Of every frame, a pinhole.

        Raises:
            NotConnected: Before `connect`.
        """
        self._connected()
        return self._register.output

    def connect(self) -> None:
        """Find the camera or file and start it; nothing happens while it runs.

        Raises:
            CameraNotFound: It is not there.
            SeveralCameras: There are several, and no serial number says which.
            BadRecording: The file is no recording, or a part of one.
            SourceError: It is in use, or has no such mode or option.
            ImportError: librealsense is missing.
        """
        if self._feed is not None:
            if not self._feed.over:
                return
            self.disconnect()  # a camera that was lost
        librealsense()
        self._runs = 0
        if self.live:
            self._feed = LiveFeed(self._origin, self._session, self._buffer, self._patience, self._recover_timeout)
        else:
            self._feed = FileFeed(self._session())
        self._model, self._last = self.camera, None
        atexit.register(self.disconnect)  # librealsense aborts a process that ends while it streams

    def read(self, timeout: float = 1.0, fresh: bool = False) -> Frame:
        """Wait for the next frame that nobody has read.

        Args:
            timeout: Seconds to wait at most.
            fresh: Take none whose exposure began before this call. With librealsense's global time (a D455 on USB) that
                is known from stamp and exposure; without it, frames of the first two intervals after the call are
                left out, which are about as long as a D455 takes from exposure to arrival. A software camera exposes
                when it is pushed. Of a recording it is the next one.

        Raises:
            FrameTimeout: None came in time.
            EndOfSource: A recording is over.
            CameraLost: The camera is gone.
            NotConnected: Before `connect`.
        """
        called = time.monotonic()
        feed = self._connected()
        return self._frame(feed.next(timeout, called if fresh else None))

    def read_latest(self, max_age: float = 0.1) -> Frame:
        """The newest frame, without waiting; the same one again until a newer one comes.

        Args:
            max_age: Seconds since it arrived, at most. A recording gives its next frame, whatever its age.

        Raises:
            StaleFrame: The newest is older, or there is none yet.
            EndOfSource: A recording is over.
            CameraLost: The camera is gone.
            NotConnected: Before `connect`.
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
        """Stop it; nothing happens when it is stopped already."""
        feed, self._feed = self._feed, None
        if feed is not None:
            atexit.unregister(self.disconnect)
            feed.close()

    def _connected(self) -> Feed:
        if self._feed is None:
            raise NotConnected(f"{self._origin.name}: not connected; call connect() first, or use it in a `with`.")
        return self._feed

    def _session(self) -> Session:
        session = Session(self._origin, self._setup, self._next_file())
        self._identity, geometry = session.identity, session.geometry
        if self._runs == 0:
            self._register = Registration(
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
            raise FileExistsError(f"record_to: {path} is there already: remove it, or take another name.")
        return path

    def _frame(self, raw: RawFrame) -> Frame:
        with self._lock:
            if self._last is None or self._last[0] is not raw:
                begin = time.perf_counter()
                rgb, depth = self._register(raw.colour, raw.depth)
                self.timings = {"register": 1e3 * (time.perf_counter() - begin)}
                self._last = raw, rgb, depth
            _, rgb, depth = self._last
            exposed = raw.exposed if self.live else None
            return Frame(rgb.copy(), depth.copy(), self._model, raw.stamp, raw.received, raw.number, exposed)


def _origin(
    device: SoftwareD455 | Sequence[SoftwareD455] | None, serial: str | None, recording: str | Path | None
) -> Origin:
    if recording is not None:
        return Recording(Path(recording))
    if device is None:
        return Camera(serial)
    return SoftwareCameras([device] if isinstance(device, SoftwareD455) else list(device), serial)
