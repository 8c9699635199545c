"""EpisodeSource: one episode of a recorded folder, as a source."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import Frame
from shape_obs.recording import Recording
from shape_obs.recording.layout import FRAMES_FILE
from shape_obs.source import EndOfSource, NotConnected, Source


class EpisodeSource(Source):
    """A part of a recorded folder's frames, each to the bit as it was recorded.

    Args:
        path: The folder.
        frames: (first, count) of its frames.
        extrinsics: See ``Source``; wins over the camera's place that was recorded.

    Raises:
        BadRecording: By ``connect``: it is none. By ``read``: a damaged file.

    Warns:
        UserWarning: By ``connect``: the recording was interrupted.
    """

    kind: str = "folder"
    live: bool = False

    def __init__(
        self, path: str | Path, frames: tuple[int, int], extrinsics: Extrinsics | str | Path | None = None
    ) -> None:
        super().__init__(extrinsics)
        self.name = str(path)
        self.anchors: Mapping[str, Sequence[float]] = {}
        self.episode = 0
        self._frames = range(frames[0], sum(frames))
        self._at = 0
        self._recording: Recording | None = None

    def __len__(self) -> int:
        """How many frames there are."""
        return len(self._frames)

    @property
    def recording(self) -> Recording:
        """The whole folder."""
        if self._recording is None:
            raise NotConnected(f"{self.name}: not connected: use `with source:`, or call connect() first.")
        return self._recording

    @property
    def has_depth(self) -> bool:
        """Whether frames carry depth."""
        return self.recording.has_depth

    @property
    def serial(self) -> str | None:
        """Of the camera that was recorded."""
        return self.recording.serial

    @property
    def intrinsics(self) -> Intrinsics | None:
        """Of every frame, without distortion; None where nobody knows them."""
        known = self.recording.camera
        return None if known is None else known.intrinsics

    @property
    def camera(self) -> CameraModel | None:
        """The intrinsics, with the camera's place in the base frame where it is known."""
        return self._placed(self.recording.camera)

    def connect(self) -> None:
        """Open it and begin at the episode's first frame."""
        if self._recording is None:
            self._recording = _opened(self.name, (Path(self.name) / FRAMES_FILE).stat().st_mtime_ns)
            self._at = 0
            if self._recording.warning:
                warnings.warn(self._recording.warning, stacklevel=2)

    def disconnect(self) -> None:
        """Close it."""
        self._recording = None

    def read(self, timeout: float = 1.0, fresh: bool = False) -> Frame:
        """The next frame."""
        recording = self.recording
        if self._at >= len(self):
            raise EndOfSource(f"{self.name}: the {len(self)} frames of the episode are over.")
        frame, self.anchors, self.episode = recording[self._frames[self._at]]
        self._at += 1
        return replace(frame, camera=self._placed(frame.camera))

    def read_latest(self, max_age: float = 0.1) -> Frame:
        """The next frame, whatever its age."""
        return self.read()

    def _placed(self, known: CameraModel | None) -> CameraModel | None:
        if known is None or self.extrinsics is None:
            return known
        return self.extrinsics.camera(known.intrinsics, self.serial)


@lru_cache(maxsize=1)
def _opened(path: str, changed: int) -> Recording:
    """A process mostly gets episodes of one recording after another: its lines are read once."""
    return Recording(path)
