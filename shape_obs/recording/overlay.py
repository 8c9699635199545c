"""Write a video of the frames with the detected shapes drawn over them."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from shape_obs.drawing import Image, draw_detection
from shape_obs.recording.format import Moment
from shape_obs.shape import Detection
from shape_obs.utils.files import begin_file, finish_file, make_folder

if TYPE_CHECKING:
    from typing_extensions import Self

_CODECS: Final = {".mp4": "mp4v", ".avi": "MJPG"}
_ENOUGH: Final = 15  # frames from whose stamps the rate is estimated
_READABLE: Final = 480  # pixels of height; smaller images are enlarged, so that numbers are legible


class OverlayVideo:
    """Write a video, completely or not at all. Use it as a context manager; on an error an existing file is kept.

    Args:
        path: File with the suffix ``.mp4`` or ``.avi``.
        fps: Frames per second; None for the median rate of the first stamps, or 30 without stamps.

    Raises:
        ValueError: The suffix is another one.
        OSError: The folder cannot be made, or OpenCV cannot write such a video.
    """

    def __init__(self, path: str | Path, fps: float | None = None) -> None:
        self.path = Path(path)
        if self.path.suffix not in _CODECS:
            raise ValueError(f"{self.path}: expected a video named {' or '.join('*' + suffix for suffix in _CODECS)}.")
        make_folder(self.path.parent)
        self._temporary: Path | None = None
        self._fps = fps
        self._early: list[Image] = []
        self._stamps: list[float] = []
        self._size: tuple[int, int] | None = None
        self._writer: cv2.VideoWriter | None = None

    def add(self, moment: Moment, detection: Detection) -> None:
        """Add a frame.

        Raises:
            ValueError: The frame has no colour image, or another size than the first one.
        """
        rgb = moment.frame.rgb
        if rgb is None:
            raise ValueError("an overlay video needs colour images; this source has only depth.")
        picture = draw_detection(rgb, detection, scale=max(1, round(_READABLE / rgb.shape[0])))
        size = picture.shape[1], picture.shape[0]
        self._size = self._size or size
        if size != self._size:
            raise ValueError(f"frame {moment.frame.number} has another size than the first; a video has only one size.")
        self._stamps.append(detection.stamp)
        if self._writer is None and len(self._early) < _ENOUGH and self._fps is None:
            self._early.append(picture)
        else:
            self._write(picture)

    def close(self) -> None:
        """Finish the video; without frames no file is written."""
        for picture in self._drain():
            self._write(picture)
        if self._writer is not None:
            self._writer.release()
            self._writer = None
            assert self._temporary is not None
            finish_file(self._temporary, self.path)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is None:
                self.close()
        finally:
            if self._writer is not None:
                self._writer.release()
            if self._temporary is not None:
                self._temporary.unlink(missing_ok=True)

    def _drain(self) -> list[Image]:
        early, self._early = self._early, []
        return early

    def _write(self, picture: Image) -> None:
        if self._writer is None:
            self._writer = self._open()
            for waiting in self._drain():
                self._write(waiting)
        self._writer.write(np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)))

    def _open(self) -> cv2.VideoWriter:
        assert self._size is not None
        gaps = np.diff(self._stamps)
        gap = float(np.median(gaps)) if len(gaps) else 0.0
        fps = self._fps or (1 / gap if gap > 1e-3 else 30.0)
        codec = cv2.VideoWriter.fourcc(*_CODECS[self.path.suffix])
        self._temporary = begin_file(self.path)
        writer = cv2.VideoWriter(str(self._temporary), codec, round(fps, 3), self._size)
        if not writer.isOpened():
            raise OSError(f"cannot write {self.path}: OpenCV cannot encode {_CODECS[self.path.suffix]!r} here.")
        return writer
