"""RGBDSource: where frames come from, and what can go wrong there.

A camera, a recording, a folder of images, a video and an environment are read in one way. Implementations live in
``shape_obs_envs.sources``; ``shape_obs_envs.sources.open_source`` makes one from a word such as ``"d455"``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import Frame

if TYPE_CHECKING:
    from typing_extensions import Self


class SourceError(OSError):
    """A source cannot give a frame.

    Args:
        message: What was expected, what came, and what to try.
        serial: The camera's serial number, where there is one.
        usb: The USB type of its connection, ``"3.2"`` or ``"2.1"``, where it is known.
    """

    def __init__(self, message: str, *, serial: str | None = None, usb: str | None = None) -> None:
        super().__init__(message)
        self.serial, self.usb = serial, usb


class CameraNotFound(SourceError):  # noqa: N818 - names of the public API
    """No camera is there, or not the one that was asked for."""


class SeveralCameras(SourceError):  # noqa: N818
    """More than one camera is there and no serial number says which."""


class CameraLost(SourceError):  # noqa: N818
    """A camera that was there is gone, and starting it anew did not bring it back."""


class FrameTimeout(SourceError, TimeoutError):  # noqa: N818
    """No whole, new frame came in the time given."""


class StaleFrame(SourceError):  # noqa: N818
    """The newest frame is older than was allowed."""


class NotConnected(SourceError):  # noqa: N818
    """The source was read before ``connect`` or after ``disconnect``."""


class BadRecording(SourceError):  # noqa: N818
    """A file or folder is not a recording that can be read, or only a part of one."""


class EndOfSource(SourceError):  # noqa: N818
    """A recording has no more frames."""


@runtime_checkable
class RGBDSource(Protocol):
    """Where frames come from. A context manager: it connects on entry and disconnects on exit.

    Every frame is pinhole: colour is rectified, depth is aligned to it pixel by pixel, and ``frame.camera`` tells the
    intrinsics with all distortion coefficients zero. Arrays belong to the caller; a source never writes to them again.

    Python before 3.12 reads the properties when it is asked ``isinstance(source, RGBDSource)``: ask when it is
    connected.

    May also have ``anchors``, a mapping of names to places where the object was held in the last frame, and
    ``episode``, the number of the stretch without jumps that this frame belongs to; recordings keep both.
    """

    @property
    def kind(self) -> str:
        """``"d455"``, ``"software"``, ``"recording"``, ``"folder"``, ``"video"`` or ``"env"``."""
        ...

    @property
    def name(self) -> str:
        """What the source is called in messages and files: ``"d455:123456"``, a path, an environment's id."""
        ...

    @property
    def live(self) -> bool:
        """Whether frames come at their own pace and are missed when nobody reads; a recording waits."""
        ...

    @property
    def has_depth(self) -> bool:
        """Whether frames carry depth."""
        ...

    @property
    def intrinsics(self) -> Intrinsics | None:
        """Of every frame, without distortion; None where nobody knows them (photos, a video).

        Raises:
            NotConnected: Before ``connect``.
        """
        ...

    @property
    def camera(self) -> CameraModel | None:
        """The intrinsics, with the camera's place in the base frame where it is known."""
        ...

    def connect(self) -> None:
        """Open it; nothing happens when it is open already.

        Raises:
            SourceError: It cannot be opened; the subclass and the message say why.
        """
        ...

    def read(self, timeout: float = 1.0, fresh: bool = False) -> Frame:
        """Wait for the next frame.

        Args:
            timeout: Seconds to wait at most.
            fresh: Take none that was exposed before this call, so that it shows what was done before the call. Of a
                recording it is the next one.

        Raises:
            FrameTimeout: None came in time.
            EndOfSource: A recording is over.
            CameraLost: The camera is gone.
            NotConnected: Before ``connect``.
        """
        ...

    def read_latest(self, max_age: float = 0.1) -> Frame:
        """The newest frame that is there, without waiting; the same one again until a newer one comes.

        Args:
            max_age: Seconds since it arrived, at most. A recording gives its next frame, whatever its age.

        Raises:
            StaleFrame: The newest is older, or there is none yet.
            EndOfSource: A recording is over.
            CameraLost: The camera is gone.
            NotConnected: Before ``connect``.
        """
        ...

    def disconnect(self) -> None:
        """Close it; nothing happens when it is closed already. ``connect`` opens it anew."""
        ...

    def __enter__(self) -> Self:
        """Connect."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Disconnect."""
        ...


class Source(ABC):
    """What implementations share: the context manager, and the camera's place.

    Args:
        extrinsics: Where the camera stands in the base frame, or the file that says so; None where nobody knows.

    Raises:
        ValueError: The file is none of extrinsics.
        FileNotFoundError: There is no such file.
    """

    def __init__(self, extrinsics: Extrinsics | str | Path | None = None) -> None:
        self.extrinsics = Extrinsics.load(extrinsics) if isinstance(extrinsics, (str, Path)) else extrinsics

    @property
    def serial(self) -> str | None:
        """The camera's serial number, where there is one."""
        return None

    @property
    @abstractmethod
    def intrinsics(self) -> Intrinsics | None:
        """Of every frame, without distortion; None where nobody knows them."""

    @property
    def camera(self) -> CameraModel | None:
        """The intrinsics, with the camera's place in the base frame where it is known."""
        intrinsics = self.intrinsics
        if intrinsics is None or self.extrinsics is None:
            return None if intrinsics is None else CameraModel(intrinsics)
        return self.extrinsics.camera(intrinsics, self.serial)

    @abstractmethod
    def connect(self) -> None:
        """Open it."""

    @abstractmethod
    def disconnect(self) -> None:
        """Close it."""

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.disconnect()
