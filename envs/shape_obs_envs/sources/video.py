"""Frames of a video file."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import Frame
from shape_obs.source import BadRecording, EndOfSource
from shape_obs_envs.sources.sequence import SequenceSource, check_index

#: Suffixes of video files.
VIDEOS: Final = (".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".wmv")


class VideoSource(SequenceSource):
    """Frames of a video file, with presentation times as stamps, and without depth and intrinsics.

    Args:
        path: The file.
        extrinsics: See ``Source``; has no effect without intrinsics.

    Raises:
        BadRecording: By ``connect``: the file does not exist, or OpenCV cannot decode it.
    """

    kind: str = "video"
    has_depth: bool = False

    def __init__(self, path: str | Path, extrinsics: Extrinsics | str | Path | None = None) -> None:
        super().__init__(str(path), extrinsics)
        self.path = Path(path)
        self._capture: cv2.VideoCapture | None = None
        self._number, self._stamp = 0, 0.0

    def connect(self) -> None:
        """Open the file and start at its first frame."""
        if self._connected:
            return
        if not self.path.is_file():
            raise BadRecording(f"{self.path}: {'not a file' if self.path.exists() else 'no such file'}.")
        capture = cv2.VideoCapture(str(self.path))
        if not capture.isOpened():
            raise BadRecording(f"{self.path}: not a video that OpenCV can decode; it may be damaged or truncated.")
        self._capture, self._number = capture, 0
        self._period = 1.0 / (capture.get(cv2.CAP_PROP_FPS) or 30.0)
        self._connected = True

    def __len__(self) -> int:
        """Return the number of frames that the file announces, which may be one or two off; 0 before ``connect``."""
        return 0 if self._capture is None else max(int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)), 0)

    def seek(self, index: int) -> None:
        """Go to a frame, which ``read`` returns next.

        Args:
            index: 0 for the first frame.

        Raises:
            NotConnected: The file is not open.
            IndexError: There is no such frame.
        """
        self._check_connected()
        assert self._capture is not None
        check_index(index, len(self), self.name)
        self._capture.set(cv2.CAP_PROP_POS_FRAMES, index)
        self._number, self._stamp = index, (index - 1) * self._period

    def disconnect(self) -> None:
        """Close the file."""
        if self._capture is not None:
            self._capture.release()
            self._capture = None
        super().disconnect()

    def _next(self) -> Frame:
        assert self._capture is not None
        there, bgr = self._capture.read()
        if not there:
            if self._number == 0:
                raise BadRecording(f"{self.path}: it contains no frame that can be decoded.")
            raise EndOfSource(f"{self.path}: end of its {self._number} frames.")
        stamp = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        # Some containers have no times; frames are then evenly spaced.
        if self._number and stamp <= self._stamp:
            stamp = self._stamp + self._period
        self._stamp = stamp
        rgb = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)
        frame = Frame(rgb, stamp=stamp, received=time.monotonic(), number=self._number)
        self._number += 1
        return frame
