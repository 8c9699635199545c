"""VideoSource: a video file."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import Frame
from shape_obs.source import BadRecording, EndOfSource
from shape_obs_envs.sources.sequence import SequenceSource

#: Suffixes of video files.
VIDEOS: Final = (".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".wmv")


class VideoSource(SequenceSource):
    """Frames of a video file, with the times that it shows them at as stamps. It has no depth and no intrinsics.

    Args:
        path: The file.
        extrinsics: See ``Source``; of no use without intrinsics.

    Raises:
        BadRecording: By ``connect``: no file, or none that OpenCV can decode.
    """

    kind: str = "video"
    has_depth: bool = False

    def __init__(self, path: str | Path, extrinsics: Extrinsics | str | Path | None = None) -> None:
        super().__init__(str(path), extrinsics)
        self.path = Path(path)
        self._capture: cv2.VideoCapture | None = None
        self._number, self._stamp = 0, 0.0

    def connect(self) -> None:
        """Open it and begin at its first frame."""
        if self._connected:
            return
        if not self.path.is_file():
            raise BadRecording(f"{self.path}: {'not a file' if self.path.exists() else 'no such file'}.")
        capture = cv2.VideoCapture(str(self.path))
        if not capture.isOpened():
            raise BadRecording(f"{self.path}: not a video that OpenCV can decode; it may be damaged or cut short.")
        self._capture, self._number = capture, 0
        self._period = 1.0 / (capture.get(cv2.CAP_PROP_FPS) or 30.0)
        self._connected = True

    def disconnect(self) -> None:
        """Close it."""
        if self._capture is not None:
            self._capture.release()
            self._capture = None
        super().disconnect()

    def _next(self) -> Frame:
        assert self._capture is not None
        there, bgr = self._capture.read()
        if not there:
            if self._number == 0:
                raise BadRecording(f"{self.path}: it holds no frame that can be decoded.")
            raise EndOfSource(f"{self.path}: its {self._number} frames are over.")
        stamp = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        # Some containers tell no times; then frames are evenly spaced.
        if self._number and stamp <= self._stamp:
            stamp = self._stamp + self._period
        self._stamp = stamp
        rgb = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)
        frame = Frame(rgb, stamp=stamp, received=time.monotonic(), number=self._number)
        self._number += 1
        return frame
