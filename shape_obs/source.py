"""RGBDSource: the interface of everything that provides frames, its check, and its errors.

Cameras, recordings, folders of images, videos and environments share this interface. Implementations are in
``shape_obs_envs.sources``; ``shape_obs_envs.sources.open_source`` makes one from a string such as ``"d455"``.
"""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Protocol, runtime_checkable

from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import Frame
from shape_obs.utils.errors import UsageError, run_last

if TYPE_CHECKING:
    from typing_extensions import Self


class SourceError(OSError):
    """A source cannot provide a frame.

    Args:
        message: What was expected, what happened, and what to try.
        serial: The serial number of the camera, if there is one.
        usb: The USB type of the connection, such as ``"3.2"`` or ``"2.1"``, if known.
    """

    def __init__(self, message: str, *, serial: str | None = None, usb: str | None = None) -> None:
        super().__init__(message)
        self.serial, self.usb = serial, usb


class CameraNotFound(SourceError):  # noqa: N818 - names of the public API
    """There is no camera, or not the requested one."""


class SeveralCameras(SourceError):  # noqa: N818
    """There is more than one camera, and no serial number was given."""


class CameraLost(SourceError):  # noqa: N818
    """The connection to a camera was lost, and restarting it failed."""


class FrameTimeout(SourceError, TimeoutError):  # noqa: N818
    """No complete new frame arrived in time."""


class StaleFrame(SourceError):  # noqa: N818
    """The newest frame is older than allowed."""


class NotConnected(SourceError):  # noqa: N818
    """The source was read before ``connect`` or after ``disconnect``."""


class BadRecording(SourceError):  # noqa: N818
    """A file or folder is not a readable recording, or is incomplete."""


class BadSettings(SourceError, UsageError):  # noqa: N818
    """A source does not take an argument, or not this value of it."""


class EndOfSource(SourceError):  # noqa: N818
    """A recording has no more frames."""


@runtime_checkable
class RGBDSource(Protocol):
    """A source of frames, and a context manager that connects on entry and disconnects on exit.

    Every frame is that of a pinhole camera: colour is rectified, depth is aligned to it pixel by pixel, and
    ``frame.camera`` holds the intrinsics with all distortion coefficients zero. Arrays belong to the caller; a source
    never writes to them again.

    Python before 3.12 evaluates the properties in ``isinstance(source, RGBDSource)``: connect the source first.

    A source may also have ``anchors``, a mapping of names to points where the object was held in the last frame;
    ``episode``, the number of the uninterrupted sequence that the frame belongs to; ``transition``, the action, reward
    and end of the step that led to it; ``state``, that of the robot; and ``robot_info``, the names of the values of
    both. Recordings store them; see ``shape_obs.recording.Moment``.
    """

    @property
    def kind(self) -> str:
        """``"d455"``, ``"webcam"``, ``"recording"``, ``"rosbag"``, ``"folder"``, ``"video"``, ``"env"``: any word."""
        ...

    @property
    def name(self) -> str:
        """The name of the source in messages and files, such as a serial number, a path or an environment id."""
        ...

    @property
    def live(self) -> bool:
        """Whether frames arrive at their own rate and are lost unless they are read; a recording waits."""
        ...

    @property
    def has_depth(self) -> bool:
        """Whether frames carry depth.

        Raises:
            NotConnected: This is known only once the source is connected.
        """
        ...

    @property
    def intrinsics(self) -> Intrinsics | None:
        """The intrinsics of every frame, without distortion; None if unknown, as for photos and videos.

        Raises:
            NotConnected: The source is not connected.
        """
        ...

    @property
    def camera(self) -> CameraModel | None:
        """The intrinsics, with the pose of the camera in the base frame if known."""
        ...

    def connect(self) -> None:
        """Open the source unless it is already open.

        Raises:
            SourceError: The source cannot be opened; the subclass and the message give the reason.
        """
        ...

    def read(self, timeout: float = 1.0, fresh: bool = False) -> Frame:
        """Wait for the next frame.

        Args:
            timeout: Longest time to wait, in seconds.
            fresh: Skip frames that were exposed before this call, so that the frame shows the effect of earlier
                actions. A recording returns its next frame.

        Raises:
            FrameTimeout: No frame arrived in time.
            EndOfSource: The recording has ended.
            CameraLost: The connection to the camera was lost.
            NotConnected: The source is not connected.
        """
        ...

    def read_latest(self, max_age: float = 0.1) -> Frame:
        """Return the newest frame without waiting; the same one again until a newer one arrives.

        Args:
            max_age: Largest time since its arrival, in seconds. A recording returns its next frame at any age.

        Raises:
            StaleFrame: The newest frame is older, or there is none yet.
            EndOfSource: The recording has ended.
            CameraLost: The connection to the camera was lost.
            NotConnected: The source is not connected.
        """
        ...

    def disconnect(self) -> None:
        """Close the source unless it is already closed; ``connect`` opens it again."""
        ...

    def __enter__(self) -> Self:
        """Connect."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Disconnect."""
        ...


_ATTRIBUTES: Final = ("kind", "name", "live", "has_depth", "intrinsics", "camera")
_METHODS: Final = ("connect", "read", "read_latest", "disconnect", "__enter__", "__exit__")


def check_source(source: Any, what: str = "source") -> None:
    """Check that an object has the interface of ``RGBDSource``, without evaluating a property or opening anything.

    Args:
        source: The object.
        what: The start of the error message, such as the word that named the object.

    Raises:
        TypeError: The message lists everything that is missing, or the arguments that ``read`` or ``read_latest``
            does not take.
    """
    name, absent = type(source).__name__, object()
    missing = [attribute for attribute in _ATTRIBUTES if inspect.getattr_static(source, attribute, absent) is absent]
    missing += [f"{method}()" for method in _METHODS if not callable(getattr(source, method, None))]
    if missing:
        raise TypeError(
            f"{what}: expected an object as shape_obs.source.RGBDSource describes it, {name} has no "
            f"{', '.join(missing)}. Subclass shape_obs_envs.sources.LiveSource, which has all but "
            "open(), grab() and close()."
        )
    for method, arguments in (("read", ("timeout", "fresh")), ("read_latest", ("max_age",))):
        taken = inspect.signature(getattr(source, method)).parameters.values()
        names = {parameter.name for parameter in taken if parameter.kind is not parameter.POSITIONAL_ONLY}
        if not names.issuperset(arguments) and not any(each.kind is each.VAR_KEYWORD for each in taken):
            raise TypeError(f"{what}: {name}.{method} must take the arguments {', '.join(arguments)}.")


class Source(ABC):
    """Base class of sources: the context manager, and the pose of the camera.

    Args:
        extrinsics: The pose of the camera in the base frame, or its file; None if unknown.

    Raises:
        ValueError: The file does not contain extrinsics.
        FileNotFoundError: There is no such file.
    """

    def __init__(self, extrinsics: Extrinsics | str | Path | None = None) -> None:
        self.extrinsics = Extrinsics.load(extrinsics) if isinstance(extrinsics, (str, Path)) else extrinsics

    @property
    def serial(self) -> str | None:
        """The serial number of the camera, if there is one."""
        return None

    @property
    @abstractmethod
    def intrinsics(self) -> Intrinsics | None:
        """The intrinsics of every frame, without distortion; None if unknown."""

    @property
    def camera(self) -> CameraModel | None:
        """The intrinsics, with the pose of the camera in the base frame if known."""
        intrinsics = self.intrinsics
        if intrinsics is None or self.extrinsics is None:
            return None if intrinsics is None else CameraModel(intrinsics)
        return self.extrinsics.camera(intrinsics, self.serial)

    @abstractmethod
    def connect(self) -> None:
        """Open the source."""

    @abstractmethod
    def disconnect(self) -> None:
        """Close the source."""

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        run_last(error, self.disconnect)
