"""Write a video of the frames with the detected shapes drawn over them."""

from __future__ import annotations

import warnings
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Final

import numpy as np

from shape_obs.drawing import Image, draw_detection
from shape_obs.recording.format import Moment
from shape_obs.recording.video import Encoder, GifEncoder, open_encoder
from shape_obs.shape import Detection
from shape_obs.tracking.clock import LONGEST_PAUSE
from shape_obs.utils.files import begin_file, finish_file, make_folder

if TYPE_CHECKING:
    from typing_extensions import Self

#: Suffixes of overlay videos.
SUFFIXES: Final = (".mp4", ".avi", ".gif")
_ENOUGH: Final = 15  # frames from whose stamps the rate is estimated
_LONGEST_SHOWN: Final = 2.0  # seconds for which a picture is shown at most
_UNLIKE: Final = 0.1  # of its duration, by which a video may differ from the recording without a word
_READABLE: Final = 480  # pixels of height; smaller images are enlarged, so that numbers are legible


class OverlayVideo:
    """Write a video, completely or not at all. Use it as a context manager; on an error an existing file is kept.

    ``.mp4`` is H.264, which browsers play, if the extra ``video`` is installed, otherwise MPEG-4 Part 2. ``.avi`` is
    Motion JPEG. ``.gif`` is reduced to 640 pixels, 12.5 pictures per second and 400 pictures.

    A video has one rate, and frames may not: where one comes late, the picture before it is repeated, so that the video
    plays at the speed of the stamps. No frame is left out, except from a GIF.

    Args:
        path: File with the suffix ``.mp4``, ``.avi`` or ``.gif``.
        fps: Frames per second, each shown once; None for the median rate of the first stamps, at the speed of the
            stamps, or 30 without stamps.

    Warns:
        UserWarning: The video is longer or shorter than the recording by more than a tenth: a pause of more than 2 s
            was cut, or frames came faster than the first ones.

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
        self._fps, self._timed = fps or 0.0, fps is None
        self._early: list[tuple[Image, float]] = []
        self._stamp: float | None = None
        self._last: Image | None = None
        self._shown, self._due, self._seconds = 0, 0.0, 0.0  # pictures, the index that is due, and the recording's time
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
        gap = 0.0 if self._stamp is None else detection.stamp - self._stamp
        self._stamp = detection.stamp
        self._early.append((picture, gap))
        if self._fps or len(self._early) >= _ENOUGH:
            self._write_early()

    def close(self) -> None:
        """Finish the video; without frames no file is written."""
        self._write_early()
        if self._encoder is not None:
            self._encoder.finish()
            self._encoder = None
            assert self._temporary is not None
            finish_file(self._temporary, self.path)
            played = self._shown / self._fps
            if self._timed and abs(played - self._seconds) > _UNLIKE * self._seconds + 1 / self._fps:
                warnings.warn(
                    f"{self.path} lasts {played:.3g} s, but the recording {self._seconds:.3g} s: pauses of more than "
                    f"{_LONGEST_SHOWN:g} s are cut, and faster frames than the first are shown one by one.",
                    stacklevel=2,
                )

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

    def _write_early(self) -> None:
        for picture, gap in self._early:
            self._write(picture, gap)
        self._early.clear()

    def _write(self, picture: Image, gap: float) -> None:
        """Write a picture that is ``gap`` seconds later than the one before; that one is repeated while none is due."""
        if self._encoder is None:
            self._encoder = self._open()
        usual = 1 / self._fps
        if not 0 < gap <= LONGEST_PAUSE:  # the clock failed, or was set
            gap = usual if self._shown else 0.0
        self._seconds += gap
        self._due += min(gap, _LONGEST_SHOWN) * self._fps
        while self._timed and self._last is not None and self._due - self._shown > 1 - 1e-6:
            self._encoder.add(self._last)
            self._shown += 1
        self._encoder.add(picture)
        self._last = picture
        self._shown += 1

    def _open(self) -> Encoder:
        assert self._size is not None
        if not self._fps:
            gap = float(np.median([gap for _, gap in self._early if 0 < gap <= LONGEST_PAUSE] or [0.0]))
            self._fps = 1 / min(gap, _LONGEST_SHOWN) if gap > 1e-3 else 30.0
        self._temporary = begin_file(self.path)
        if self.path.suffix == ".gif":
            return GifEncoder(self._temporary, self._size, self._fps)
        return open_encoder(self._temporary, self._size, self._fps)
