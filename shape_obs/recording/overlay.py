"""Write a video of the frames with the detected shapes drawn over them."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Final

import numpy as np

from shape_obs.drawing import Image, draw_detection
from shape_obs.recording.format import Moment
from shape_obs.recording.video import Encoder, GifEncoder, open_encoder
from shape_obs.shape import Detection
from shape_obs.utils.files import begin_file, finish_file, make_folder

if TYPE_CHECKING:
    from typing_extensions import Self

#: Suffixes of overlay videos.
SUFFIXES: Final = (".mp4", ".avi", ".gif")
_ENOUGH: Final = 15  # frames from whose stamps the rate is estimated
_READABLE: Final = 480  # pixels of height; smaller images are enlarged, so that numbers are legible


class OverlayVideo:
    """Write a video, completely or not at all. Use it as a context manager; on an error an existing file is kept.

    ``.mp4`` is H.264, which browsers play, if the extra ``video`` is installed, otherwise MPEG-4 Part 2. ``.avi`` is
    Motion JPEG. ``.gif`` is reduced to 640 pixels, 12.5 pictures per second and 400 pictures.

    Args:
        path: File with the suffix ``.mp4``, ``.avi`` or ``.gif``.
        fps: Frames per second; None for the median rate of the first stamps, or 30 without stamps.

    Raises:
        ValueError: The suffix is another one.
        OSError: The folder cannot be made, or such a video cannot be written.
    """

    def __init__(self, path: str | Path, fps: float | None = None) -> None:
        self.path = Path(path)
        if self.path.suffix not in SUFFIXES:
            raise ValueError(f"{self.path}: expected a video named {', '.join('*' + suffix for suffix in SUFFIXES)}.")
        make_folder(self.path.parent)
        self._temporary: Path | None = None
        self._fps = fps
        self._early: list[Image] = []
        self._stamps: list[float] = []
        self._size: tuple[int, int] | None = None
        self._encoder: Encoder | None = None

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
        if self._encoder is None and len(self._early) < _ENOUGH and self._fps is None:
            self._early.append(picture)
        else:
            self._write(picture)

    def close(self) -> None:
        """Finish the video; without frames no file is written."""
        for picture in self._drain():
            self._write(picture)
        if self._encoder is not None:
            self._encoder.finish()
            self._encoder = None
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
            if self._encoder is not None:
                self._encoder.abort()
            if self._temporary is not None:
                self._temporary.unlink(missing_ok=True)

    def _drain(self) -> list[Image]:
        early, self._early = self._early, []
        return early

    def _write(self, picture: Image) -> None:
        if self._encoder is None:
            self._encoder = self._open()
            for waiting in self._drain():
                self._write(waiting)
        self._encoder.add(picture)

    def _open(self) -> Encoder:
        assert self._size is not None
        gaps = np.diff(self._stamps)
        gap = float(np.median(gaps)) if len(gaps) else 0.0
        fps = self._fps or (1 / gap if gap > 1e-3 else 30.0)
        self._temporary = begin_file(self.path)
        if self.path.suffix == ".gif":
            return GifEncoder(self._temporary, self._size, fps)
        return open_encoder(self._temporary, self._size, fps)
