"""Origins: where a device comes from. All that differs between a camera, a software camera and a recording is here."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

from shape_obs.source import CameraNotFound, EndOfSource, SeveralCameras
from shape_obs_envs.sources.realsense.driver import librealsense
from shape_obs_envs.sources.realsense.identity import Identity
from shape_obs_envs.sources.realsense.recording import open_recording
from shape_obs_envs.sources.realsense.usb import plugged_cameras

if TYPE_CHECKING:
    from shape_obs_envs.sources.realsense.software import SoftwareD455

#: Framesets that wait in librealsense while Python is busy. It gives up streaming when more than 16 are held.
_WAITING: Final = 8
#: Milliseconds. The end of a recording is seen when nothing came for so long.
_PATIENCE: Final = 100

Take = Callable[[float], Any]  # seconds -> a frameset, or None


class Origin(Protocol):
    """Finds a device, and starts a pipeline on it."""

    kind: str
    #: Seconds between exposure and arrival at most; None where nobody knows.
    latency: float | None
    #: Whether frames come at their own pace, in a mode and with options that can be chosen.
    live: bool

    @property
    def name(self) -> str:
        """What it is called before it is found."""
        ...

    def find(self) -> Any:
        """The ``rs.device``, looked for anew.

        Raises:
            CameraNotFound: It is not there.
            SeveralCameras: Nobody said which.
            BadRecording: The file is none.
        """
        ...

    def start(self, pipeline: Any, config: Any, device: Any) -> tuple[Any, Take]:
        """Start a pipeline on the device that was found: its profile, and how to take framesets from it."""
        ...


class Camera:
    """A camera on USB.

    Args:
        serial: Which; None for the only one.
    """

    kind = "d455"
    latency: float | None = None
    live = True

    def __init__(self, serial: str | None) -> None:
        self._serial = serial

    @property
    def name(self) -> str:
        """``"d455"`` or ``"d455:SERIAL"``."""
        return "d455" if self._serial is None else f"d455:{self._serial}"

    def find(self) -> Any:
        """Look through what is plugged in."""
        # Starting a pipeline without looking first would wait 15 s for somebody to plug it in.
        return _choose(listed_cameras(), self._serial, plugged_cameras())

    def start(self, pipeline: Any, config: Any, device: Any) -> tuple[Any, Take]:
        """Through a queue inside librealsense: it goes on taking frames while Python is busy elsewhere."""
        return start_queued(pipeline, config, device)


class SoftwareCameras:
    """Software cameras, as if they were all that is plugged in.

    Args:
        cameras: Those that there are.
        serial: Which; None for the only one.
    """

    kind = "software"
    latency: float | None = 0.0
    live = True

    def __init__(self, cameras: Sequence[SoftwareD455], serial: str | None) -> None:
        self._cameras, self._serial = tuple(cameras), serial

    @property
    def name(self) -> str:
        """``"software:SERIAL"``, or ``"software"`` while nobody knows which."""
        serial = self._cameras[0].serial if len(self._cameras) == 1 else self._serial
        return "software" if serial is None else f"software:{serial}"

    def find(self) -> Any:
        """Look through those that are plugged in."""
        return _choose([camera.device for camera in self._cameras if camera.plugged], self._serial, [])

    def start(self, pipeline: Any, config: Any, device: Any) -> tuple[Any, Take]:
        """As a camera on USB."""
        return start_queued(pipeline, config, device)


class Recording:
    """A file that librealsense wrote.

    Args:
        path: A .db3, or a .bag of an earlier version.
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

    def start(self, pipeline: Any, config: Any, device: Any) -> tuple[Any, Take]:
        """Without a clock: the file waits for whoever reads. With a queue, as for cameras, that would stall."""
        rs = librealsense()
        playback = device.as_playback()
        playback.set_real_time(False)
        pipeline.set_device(device)
        playback.pause()  # or the first frames are played before anybody can take them
        profile = pipeline.start(config)
        # resume() waits for the playing thread, and that one, now and then, for somebody who takes the first frame.
        resuming = threading.Thread(target=playback.resume, name=f"{self.name} begins")
        resuming.start()

        def take(seconds: float) -> Any:
            deadline = time.monotonic() + seconds
            while True:
                # The order matters: begun, over, and then nothing left.
                over = not resuming.is_alive() and playback.current_status() == rs.playback_status.stopped
                came, frames = pipeline.try_wait_for_frames(_PATIENCE)
                if came:
                    return frames
                if over:
                    raise EndOfSource(f"{self.name}: the recording is over.")
                if time.monotonic() > deadline:
                    return None

        return profile, take


def listed_cameras() -> list[Any]:
    """Every ``rs.device`` on USB that can be opened. A context remembers devices, so it is a new one every time."""
    rs, found = librealsense(), []
    devices = rs.context().query_devices()
    for index in range(len(devices)):
        # One that may not be opened, or that is just going away, is listed but does not answer.
        with contextlib.suppress(RuntimeError):
            device = devices[index]
            if device.supports(rs.camera_info.serial_number):
                found.append(device)
    return found


def start_queued(pipeline: Any, config: Any, device: Any) -> tuple[Any, Take]:
    """Start a pipeline that puts its framesets into a queue; when it is full, the newest win."""
    queue = librealsense().frame_queue(_WAITING)
    pipeline.set_device(device)
    profile = pipeline.start(config, queue)

    def take(seconds: float) -> Any:
        came, frame = queue.try_wait_for_frame(int(1000 * seconds))
        return frame.as_frameset() if came else None

    return profile, take


def _choose(devices: Sequence[Any], serial: str | None, plugged: Sequence[str]) -> Any:
    known = [(Identity.of(device), device) for device in devices]
    listed = ", ".join(str(identity) for identity, _ in known)
    if serial is not None:
        known = [(identity, device) for identity, device in known if identity.serial == serial]
    if len(known) > 1:
        raise SeveralCameras(f"Several cameras are there ({listed}): say which by its serial number, d455:SERIAL.")
    if known:
        return known[0][1]
    wanted = "No RealSense camera" if serial is None else f"No camera with the serial number {serial}"
    if listed:
        raise CameraNotFound(f"{wanted} is there; those found: {listed}.", serial=serial)
    if plugged:
        raise CameraNotFound(
            f"{wanted} may be opened, though one is plugged in ({', '.join(plugged)}): install librealsense's udev "
            "rules, plug it out and in again, and see that no other program has it; docs/d455-camera.md.",
            serial=serial,
        )
    raise CameraNotFound(
        f"{wanted} is there: plug it into a USB 3 port with a USB 3 cable, and look whether `lsusb` shows it.",
        serial=serial,
    )
