"""Sources that deliver frames on demand: their base class, and folders."""

from __future__ import annotations

import re
import warnings
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import Frame
from shape_obs.recording import Recording, RobotInfo, Transition
from shape_obs.recording.format import CAMERA_FILE, FRAMES_FILE
from shape_obs.source import BadRecording, EndOfSource, NotConnected, Source
from shape_obs.utils.arrays import read_image
from shape_obs.utils.files import listing

#: Suffixes of photos.
PHOTOS: Final = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")


class SequenceSource(Source):
    """Base of sources that deliver one frame after the other, at the reader's pace.

    A subclass opens itself in ``connect`` and sets ``_connected``.

    Args:
        name: See ``RGBDSource``.
        extrinsics: See ``Source``; overrides the pose that the source itself provides.
    """

    kind: str
    live: bool = False

    def __init__(self, name: str, extrinsics: Extrinsics | str | Path | None = None) -> None:
        super().__init__(extrinsics)
        self.name = name
        self._connected = False

    @property
    def intrinsics(self) -> Intrinsics | None:
        """Intrinsics of all frames, without distortion; None if unknown."""
        self._check_connected()
        known = self._known_camera()
        return None if known is None else known.intrinsics

    @property
    def camera(self) -> CameraModel | None:
        """Intrinsics and, if known, the camera's pose in the base frame."""
        self._check_connected()
        return self._with_extrinsics(self._known_camera())

    def read(self, timeout: float = 1.0, fresh: bool = False) -> Frame:
        """Return the next frame; it is read or computed now, so it is always in time and always fresh."""
        self._check_connected()
        return self._next()

    def read_latest(self, max_age: float = 0.1) -> Frame:
        """Return the next frame; its age does not matter."""
        return self.read()

    def disconnect(self) -> None:
        """Close the source."""
        self._connected = False

    @abstractmethod
    def _next(self) -> Frame:
        """Return the next frame."""

    def _known_camera(self) -> CameraModel | None:
        """Return the camera that the source itself provides."""
        return None

    def _with_extrinsics(self, known: CameraModel | None) -> CameraModel | None:
        """Return the camera with the user's extrinsics, if there are any."""
        if known is None or self.extrinsics is None:
            return known
        return self.extrinsics.camera(known.intrinsics, self.serial)

    def _check_connected(self) -> None:
        if not self._connected:
            raise NotConnected(f"{self.name}: not connected: use `with source:`, or call connect() first.")


class FolderSource(SequenceSource):
    """Frames from a folder of photos, or from a folder that ``shape-obs record`` wrote.

    A recorded folder returns each frame bit for bit, with its stamp, number and camera. Photos are read in the order of
    their names (``2.png`` before ``10.png``); they have no stamps, depth or intrinsics.

    Args:
        path: The folder.
        extrinsics: See ``Source``; overrides the recorded pose of the camera.
        frames: ``(first, count)`` of a part, such as an episode; None for all frames.

    Attributes:
        anchors: Where the object was held in the last frame that was read; empty if unknown.
        episode: Episode of the last frame that was read.
        transition: The recorded step that led to the last frame that was read; None if there is none.
        state: ``(S,)`` recorded state of the robot in that frame; None if there is none.

    Raises:
        ValueError: ``frames`` is invalid.
        BadRecording: By ``connect``: the folder does not exist, is empty or unreadable, or has fewer frames than
            requested. By ``read``: a file is damaged.

    Warns:
        UserWarning: By ``connect``: the recording was interrupted; the warning lists what is left out.
    """

    anchors: Mapping[str, Sequence[float]]
    episode: int
    transition: Transition | None
    state: tuple[float, ...] | None
    kind: str = "folder"

    def __init__(
        self,
        path: str | Path,
        extrinsics: Extrinsics | str | Path | None = None,
        frames: tuple[int, int] | None = None,
    ) -> None:
        super().__init__(str(path), extrinsics)
        pair = isinstance(frames, Sequence) and len(frames) == 2  # it may come from a command line
        if frames is not None and not (pair and frames[0] >= 0 and frames[1] >= 1):
            raise ValueError(f"frames: expected (first, count), at least 0 and 1, got {frames!r}.")
        self.path = Path(path)
        self._part = frames
        self._frames: Recording | Sequence[Path] = ()
        self._left = range(0)
        self.anchors = {}
        self.episode = 0
        self.transition = None
        self.state = None

    def __len__(self) -> int:
        """Return the total number of frames to read; 0 before ``connect``."""
        return self._part[1] if self._part and self._frames else len(self._frames)

    @property
    def recording(self) -> Recording | None:
        """The whole recording; None for photos."""
        self._check_connected()
        return self._frames if isinstance(self._frames, Recording) else None

    @property
    def has_depth(self) -> bool:
        """Whether frames include depth."""
        return self.recording is not None and self.recording.has_depth

    @property
    def serial(self) -> str | None:
        """Serial number of the recorded camera."""
        return self._frames.serial if isinstance(self._frames, Recording) else None

    @property
    def robot_info(self) -> RobotInfo | None:
        """Names of the values of the recorded actions and states; None if there are none."""
        return self._frames.robot if isinstance(self._frames, Recording) else None

    def connect(self) -> None:
        """Open the folder and start at its first frame."""
        if self._connected:
            return
        if not self.path.is_dir():
            raise BadRecording(f"{self.path}: {'not a folder' if self.path.exists() else 'no such folder'}.")
        if any(file.exists() for file in self._files()):
            self._frames = self._open_recording()
            if self._frames.warning:
                warnings.warn(self._frames.warning, stacklevel=2)
        else:
            inside = listing(self.path)
            photos = (path for path in inside if path.suffix.lower() in PHOTOS and path.is_file())
            self._frames = sorted(photos, key=_natural_order)
            if not self._frames:
                bags = any(path.suffix in (".mcap", ".db3") for path in inside)
                hint = " For a rosbag2 without its metadata.yaml run `ros2 bag reindex`." if bags else ""
                raise BadRecording(
                    f"{self.path}: expected a recording ({CAMERA_FILE}, {FRAMES_FILE}, rgb/) or images "
                    f"({', '.join(PHOTOS)}), found neither.{hint}"
                )
        first, count = self._part or (0, len(self._frames))
        if first + count > len(self._frames):
            raise BadRecording(
                f"{self.path}: frames {first} ... {first + count - 1} were requested, there are {len(self._frames)}."
            )
        self._left = range(first, first + count)
        self.anchors, self.episode, self.transition, self.state = {}, 0, None, None
        self._connected = True

    def seek(self, index: int) -> None:
        """Go to a frame, which ``read`` returns next.

        Args:
            index: 0 for the first frame.

        Raises:
            NotConnected: The folder is not open.
            IndexError: There is no such frame.
        """
        self._check_connected()
        check_index(index, len(self), self.name)
        first = self._part[0] if self._part else 0
        self._left = range(first + index, first + len(self))

    def _next(self) -> Frame:
        if not self._left:
            raise EndOfSource(f"{self.path}: end of its {len(self)} frames.")
        at = self._left[0]
        if isinstance(self._frames, Recording):
            frame, self.anchors, self.episode, self.transition, self.state = self._frames[at]
            frame = replace(frame, camera=self._with_extrinsics(frame.camera))
        else:
            frame = _read_photo(self._frames[at], at)
        self._left = self._left[1:]
        return frame

    def _open_recording(self) -> Recording:
        if self._part is None:
            return Recording(self.path)
        changed = [file.stat().st_mtime_ns if file.exists() else 0 for file in self._files()]
        return _cached_recording(self.path.absolute(), *changed)

    def _files(self) -> tuple[Path, Path]:
        return self.path / CAMERA_FILE, self.path / FRAMES_FILE

    def _known_camera(self) -> CameraModel | None:
        return self.recording.camera if self.recording else None


def check_index(index: int, length: int, name: str) -> None:
    """Raise an ``IndexError`` unless a source of ``length`` frames has a frame ``index``."""
    if not 0 <= index < length:
        raise IndexError(f"{name}: expected a frame from 0 to {length - 1}, got {index}.")


@lru_cache(maxsize=1)
def _cached_recording(path: Path, *changed: int) -> Recording:
    """Open a recording once for its parts, which are mostly read one after the other."""
    return Recording(path)


def _read_photo(path: Path, number: int) -> Frame:
    try:
        return Frame(np.ascontiguousarray(read_image(path)), number=number)
    except (ValueError, OSError) as error:
        raise BadRecording(str(error)) from error


def _natural_order(path: Path) -> tuple[Any, ...]:
    """Return a sort key that orders numbers by value and everything else alphabetically."""
    parts = re.split(r"(\d+)", path.name)
    return (*((int(part), "") if part.isdecimal() else (-1, part) for part in parts), path.name)
