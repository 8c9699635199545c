"""SequenceSource: what folders, videos and environments share. They wait for the reader and count their frames."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path

from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import Frame
from shape_obs.source import NotConnected, Source


class SequenceSource(Source):
    """A source that gives one frame after the other, whenever it is asked.

    A subclass opens itself in ``connect`` and says so by ``_connected``.

    Args:
        name: See ``RGBDSource``.
        extrinsics: See ``Source``; it wins over what the source knows by itself.
    """

    kind: str
    live: bool = False

    def __init__(self, name: str, extrinsics: Extrinsics | str | Path | None = None) -> None:
        super().__init__(extrinsics)
        self.name = name
        self._connected = False

    @property
    def intrinsics(self) -> Intrinsics | None:
        """Of every frame, without distortion; None where nobody knows them."""
        self._check_connected()
        known = self._known_camera()
        return None if known is None else known.intrinsics

    @property
    def camera(self) -> CameraModel | None:
        """The intrinsics, with the camera's place in the base frame where it is known."""
        self._check_connected()
        return self._placed(self._known_camera())

    def read(self, timeout: float = 1.0, fresh: bool = False) -> Frame:
        """The next frame; it is computed or read now, so it is always there in time and always fresh."""
        self._check_connected()
        return self._next()

    def read_latest(self, max_age: float = 0.1) -> Frame:
        """The next frame, whatever its age."""
        return self.read()

    def disconnect(self) -> None:
        """Close it."""
        self._connected = False

    @abstractmethod
    def _next(self) -> Frame:
        """The next frame."""

    def _known_camera(self) -> CameraModel | None:
        """What the source knows about its camera."""
        return None

    def _placed(self, known: CameraModel | None) -> CameraModel | None:
        """A camera of which the source knows ``known``, where the user says that it stands."""
        if known is None or self.extrinsics is None:
            return known
        return self.extrinsics.camera(known.intrinsics, self.serial)

    def _check_connected(self) -> None:
        if not self._connected:
            raise NotConnected(f"{self.name}: not connected: use `with source:`, or call connect() first.")
