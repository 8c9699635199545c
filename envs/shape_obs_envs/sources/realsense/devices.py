"""Devices that a pipeline can run on: cameras on USB, software cameras and recordings.

All that differs between the three is here.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

from shape_obs.source import BadRecording, CameraNotFound, EndOfSource, SeveralCameras
from shape_obs_envs.sources.realsense.driver import Identity, librealsense, plugged_cameras

if TYPE_CHECKING:
    from shape_obs_envs.sources.realsense.software import SoftwareD455

_LOG: Final = logging.getLogger(__name__)
#: The model that stands for any camera of the D400 series.
ANY_MODEL: Final = "d400"
#: Framesets queued inside librealsense while Python is busy. It stops streaming when more than 16 are held.
_QUEUED: Final = 8
#: Milliseconds without a frame after which the end of a recording is checked.
_PATIENCE: Final = 100
_SQLITE: Final = b"SQLite format 3\0"
_ROSBAG: Final = b"#ROSBAG V"
_HEADER: Final = 100  # bytes of an SQLite header

Take = Callable[[float], Any]  # seconds -> a frameset, or None


class Device(Protocol):
    """A camera or recording: finds the ``rs.device`` and starts a pipeline on it."""

    kind: str
    #: Largest time in seconds between exposure and arrival; None if unknown.
    latency: float | None
    #: Whether frames come at their own rate, in a mode and with options that can be chosen.
    live: bool

    @property
    def name(self) -> str:
        """Name to use before the device is found."""
        ...

    def find(self) -> Any:
        """Look up the ``rs.device``.

        Raises:
            CameraNotFound: It is not connected.
            SeveralCameras: There are several, and no serial number was given.
            BadRecording: The file is not a recording.
        """
        ...

    def start(self, pipeline: Any, config: Any, handle: Any) -> tuple[Any, Take]:
        """Start a pipeline on the ``rs.device``; return its profile and a function that fetches framesets."""
        ...


class UsbCamera:
    """A camera on USB.

    Args:
        serial: Serial number; None for the only camera.
        model: Which of several cameras to use, such as ``"d435"``; ``"d400"`` for any. A single camera is used
            whatever its model.
    """

    latency: float | None = None
    live = True

    def __init__(self, serial: str | None, model: str = "d455") -> None:
        self._serial, self.kind = serial, model

    @property
    def name(self) -> str:
        """The model, such as ``"d455"``, or ``"d455:SERIAL"``."""
        return self.kind if self._serial is None else f"{self.kind}:{self._serial}"

    def find(self) -> Any:
        """Look up the camera among those on USB."""
        # Starting a pipeline without looking first would wait 15 s for a camera to be plugged in.
        return _choose(listed_cameras(), self._serial, plugged_cameras(), self.kind)

    def start(self, pipeline: Any, config: Any, handle: Any) -> tuple[Any, Take]:
        """Start with a queue inside librealsense, which keeps receiving frames while Python is busy."""
        return _start_queued(pipeline, config, handle)


class SoftwareCameras:
    """Software cameras, treated as if they were all that is plugged in.

    Args:
        cameras: The cameras.
        serial: Serial number of the one to use; None for the only camera.
    """

    kind = "software"
    latency: float | None = 0.0
    live = True

    def __init__(self, cameras: Sequence[SoftwareD455], serial: str | None) -> None:
        self._cameras, self._serial = tuple(cameras), serial

    @property
    def name(self) -> str:
        """``"software:SERIAL"``, or ``"software"`` if it is not yet known which one."""
        serial = self._cameras[0].serial if len(self._cameras) == 1 else self._serial
        return "software" if serial is None else f"software:{serial}"

    def find(self) -> Any:
        """Look up the camera among those that are plugged in."""
        return _choose([camera.device for camera in self._cameras if camera.plugged], self._serial, [])

    def start(self, pipeline: Any, config: Any, handle: Any) -> tuple[Any, Take]:
        """Start as a camera on USB does."""
        return _start_queued(pipeline, config, handle)


class RecordingFile:
    """A file recorded by librealsense.

    Args:
        path: A .db3 file, or a .bag file of an earlier version.
    """

    kind = "recording"
    latency: float | None = 0.0
    live = False

    def __init__(self, path: Path) -> None:
        self._path = path

    @property
    def name(self) -> str:
        """The path."""
        return str(self._path)

    def find(self) -> Any:
        """Open the file."""
        return open_recording(self._path)

    def start(self, pipeline: Any, config: Any, handle: Any) -> tuple[Any, Take]:
        """Start without a clock, so that the file waits for its reader. With a queue, playback would stall."""
        rs = librealsense()
        playback = handle.as_playback()
        playback.set_real_time(False)
        pipeline.set_device(handle)
        playback.pause()  # otherwise the first frames are played before they can be fetched
        profile = pipeline.start(config)
        # resume() waits for the playback thread, which sometimes waits for its first frame to be fetched.
        resuming = threading.Thread(target=playback.resume, name=f"{self.name} begins")
        resuming.start()

        def take(seconds: float) -> Any:
            deadline = time.monotonic() + seconds
            while True:
                # The order matters: started, stopped, and then nothing left.
                over = not resuming.is_alive() and playback.current_status() == rs.playback_status.stopped
                came, frames = pipeline.try_wait_for_frames(_PATIENCE)
                if came:
                    return frames
                if over:
                    raise EndOfSource(f"{self.name}: end of the recording.")
                if time.monotonic() > deadline:
                    return None

        return profile, take


def listed_cameras() -> list[Any]:
    """Return each ``rs.device`` on USB that can be opened. A context caches its devices, so a new one is used."""
    rs, found = librealsense(), []
    devices = rs.context().query_devices()
    for index in range(len(devices)):
        # A camera without permission, or one that is being unplugged, is listed but does not answer.
        with contextlib.suppress(RuntimeError):
            device = devices[index]
            if device.supports(rs.camera_info.serial_number):
                found.append(device)
    return found


def open_recording(path: Path) -> Any:
    """Open a recording as an ``rs.device``.

    Args:
        path: A .db3 file (SQLite), or a .bag file (ROS bag) of librealsense before 2.58.

    Raises:
        BadRecording: The file does not exist, has another type than its suffix, or is incomplete.
    """
    if not path.is_file():
        raise BadRecording(f"{path}: there is no such file; expected a recording, .db3 or .bag.")
    _check_type(path)
    try:
        return librealsense().context().load_device(str(path))
    except RuntimeError as error:
        raise BadRecording(
            f"{path}: librealsense cannot read it, so it is not a recording of a RealSense camera or a part of it is "
            f"missing; copy it again, or use another one. ({error})"
        ) from error


def _start_queued(pipeline: Any, config: Any, handle: Any) -> tuple[Any, Take]:
    """Start a pipeline that queues its framesets; a full queue drops the oldest."""
    queue = librealsense().frame_queue(_QUEUED)
    pipeline.set_device(handle)
    profile = pipeline.start(config, queue)

    def take(seconds: float) -> Any:
        came, frame = queue.try_wait_for_frame(int(1000 * seconds))
        return frame.as_frameset() if came else None

    return profile, take


def _choose(devices: Sequence[Any], serial: str | None, plugged: Sequence[str], model: str = ANY_MODEL) -> Any:
    known = [(Identity.of(device), device) for device in devices]
    listed = ", ".join(str(identity) for identity, _ in known)
    if serial is not None:
        known = [(identity, device) for identity, device in known if identity.serial == serial]
    if len(known) > 1 and model != ANY_MODEL:
        known = [(who, device) for who, device in known if who.is_model(model)] or known
    if len(known) > 1:
        raise SeveralCameras(
            f"Several cameras are connected ({listed}): choose one by its serial number, {model}:SERIAL."
        )
    if known:
        who, device = known[0]
        if model != ANY_MODEL and not who.is_model(model):
            _LOG.info("%s is used, though the source is called %s.", who, model)
        return device
    wanted = "No RealSense camera" if serial is None else f"No camera with the serial number {serial}"
    if listed:
        raise CameraNotFound(f"{wanted} is connected; found: {listed}.", serial=serial)
    if plugged:
        raise CameraNotFound(
            f"{wanted} can be opened, though one is plugged in ({', '.join(plugged)}): install librealsense's udev "
            "rules, unplug it and plug it in again, and close other programs that use it; see "
            "docs/tutorials/real-camera.md.",
            serial=serial,
        )
    raise CameraNotFound(
        f"{wanted} is connected: plug it into a USB 3 port with a USB 3 cable, and check that `lsusb` lists it.",
        serial=serial,
    )


def _check_type(path: Path) -> None:
    """Check the first bytes: librealsense trusts the suffix, and some versions write a bag under any suffix."""
    with path.open("rb") as file:
        header = file.read(_HEADER)
    if not header:
        raise BadRecording(f"{path}: the file is empty; nothing was recorded.")
    for magic, suffix, name in ((_SQLITE, ".db3", "a .db3 recording"), (_ROSBAG, ".bag", "a ROS bag")):
        if header.startswith(magic):
            if path.suffix != suffix:
                raise BadRecording(
                    f"{path}: the content is {name}, but the suffix is {path.suffix!r}: "
                    f"rename it to {path.with_suffix(suffix).name}."
                )
            break
    else:
        raise BadRecording(f"{path}: expected a recording of a RealSense camera (.db3 or .bag), got another file type.")
    if suffix == ".db3":
        _check_length(path, header)


def _check_length(path: Path, header: bytes) -> None:
    """Compare the size with SQLite's header, which stores the page count (sqlite.org/fileformat.html, 1.3)."""
    page = int.from_bytes(header[16:18], "big")
    expected = (65536 if page == 1 else page) * int.from_bytes(header[28:32], "big")
    size, stored = path.stat().st_size, header[24:28] == header[92:96]
    if len(header) < _HEADER or (stored and size < expected):
        raise BadRecording(
            f"{path}: a part is missing: {size} bytes of {expected if len(header) == _HEADER else 'an unknown number'}."
            " The copy is truncated; copy it again."
        )
