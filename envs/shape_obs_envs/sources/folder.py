"""FolderSource: a folder of photos, or one that ``shape-obs record`` wrote."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from shape_obs.camera import CameraModel
from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import Frame
from shape_obs.recording import Recording
from shape_obs.recording.format import CAMERA_FILE, FRAMES_FILE
from shape_obs.source import BadRecording, EndOfSource
from shape_obs.utils.arrays import read_image
from shape_obs_envs.sources.sequence import SequenceSource

#: Suffixes of photos.
PHOTOS: Final = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")


class FolderSource(SequenceSource):
    """Frames from a folder.

    Of a recorded folder every frame comes back to the bit, with its stamp, number and camera. Photos are read in the
    order of their names (``2.png`` before ``10.png``); nobody knows their stamps, depth and intrinsics.

    Args:
        path: The folder.
        extrinsics: See ``Source``; for a recording it wins over the camera's place that was recorded.
        frames: (first, count) of a part, such as an episode; None for all that there are.

    Raises:
        ValueError: ``frames`` that cannot be.
        BadRecording: By ``connect``: no folder, none that can be read, nothing in it, or fewer frames than the part
            has. By ``read``: a damaged file.

    Warns:
        UserWarning: By ``connect``: the recording was interrupted, and what of it is left out.
    """

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
        self._anchors: Mapping[str, Sequence[float]] = {}
        self._episode = 0

    def __len__(self) -> int:
        """How many frames there are to read in all; 0 before ``connect``."""
        return self._part[1] if self._part and self._frames else len(self._frames)

    @property
    def recording(self) -> Recording | None:
        """All that was recorded; None for photos."""
        self._check_connected()
        return self._frames if isinstance(self._frames, Recording) else None

    @property
    def has_depth(self) -> bool:
        """Whether frames carry depth."""
        return self.recording is not None and self.recording.has_depth

    @property
    def serial(self) -> str | None:
        """Of the camera that was recorded."""
        return self._frames.serial if isinstance(self._frames, Recording) else None

    @property
    def anchors(self) -> Mapping[str, Sequence[float]]:
        """Where the object was held in the last frame that was read; empty where nobody told."""
        return self._anchors

    @property
    def episode(self) -> int:
        """Which episode the last frame that was read belongs to."""
        return self._episode

    def connect(self) -> None:
        """Open it and begin at its first frame."""
        if self._connected:
            return
        if not self.path.is_dir():
            raise BadRecording(f"{self.path}: {'not a folder' if self.path.exists() else 'no such folder'}.")
        if any(file.exists() for file in self._files()):
            self._frames = self._recorded()
            if self._frames.warning:
                warnings.warn(self._frames.warning, stacklevel=2)
        else:
            photos = (path for path in self.path.iterdir() if path.suffix.lower() in PHOTOS and path.is_file())
            self._frames = sorted(photos, key=_in_order)
            if not self._frames:
                raise BadRecording(
                    f"{self.path}: expected a recording ({CAMERA_FILE}, {FRAMES_FILE}, rgb/) or images "
                    f"({', '.join(PHOTOS)}), found neither."
                )
        first, count = self._part or (0, len(self._frames))
        if first + count > len(self._frames):
            raise BadRecording(f"{self.path}: frames {first} ... {first + count - 1} of {len(self._frames)} asked for.")
        self._left = range(first, first + count)
        self._anchors, self._episode = {}, 0
        self._connected = True

    def _next(self) -> Frame:
        if not self._left:
            raise EndOfSource(f"{self.path}: its {len(self)} frames are over.")
        at = self._left[0]
        if isinstance(self._frames, Recording):
            frame, self._anchors, self._episode = self._frames[at]
            frame = replace(frame, camera=self._placed(frame.camera))
        else:
            frame = _photo(self._frames[at], at)
        self._left = self._left[1:]
        return frame

    def _recorded(self) -> Recording:
        if self._part is None:
            return Recording(self.path)
        changed = [file.stat().st_mtime_ns if file.exists() else 0 for file in self._files()]
        return _opened(self.path.absolute(), *changed)

    def _files(self) -> tuple[Path, Path]:
        return self.path / CAMERA_FILE, self.path / FRAMES_FILE

    def _known_camera(self) -> CameraModel | None:
        return self.recording.camera if self.recording else None


@lru_cache(maxsize=1)
def _opened(path: Path, *changed: int) -> Recording:
    """Parts of one recording mostly follow each other: its lines are read once."""
    return Recording(path)


def _photo(path: Path, number: int) -> Frame:
    try:
        return Frame(np.ascontiguousarray(read_image(path)), number=number)
    except (ValueError, OSError) as error:
        raise BadRecording(str(error)) from error


def _in_order(path: Path) -> tuple[Any, ...]:
    """Numbers by their value, everything else by the alphabet."""
    parts = re.split(r"(\d+)", path.name)
    return (*((int(part), "") if part.isdecimal() else (-1, part) for part in parts), path.name)
