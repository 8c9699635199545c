"""Encode videos: H.264 where ffmpeg with libx264 is installed, otherwise what OpenCV has; and small animated GIFs."""

from __future__ import annotations

import subprocess
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import IO, Final, Protocol

import cv2
import numpy as np
from PIL import Image as Pillow

from shape_obs.drawing import Image
from shape_obs.utils.errors import install_hint

#: Codecs of OpenCV by suffix. Browsers play neither of them.
_OPENCV: Final = {".mp4": "mp4v", ".avi": "MJPG"}
#: Constant quality of libx264: thin lines and small numbers stay sharp.
_QUALITY: Final = 20

#: Largest width or height in pixels; larger pictures are reduced.
_LARGEST: Final = 640
#: Largest number of pictures per second. Durations are hundredths of a second, and browsers slow down short ones.
_FASTEST: Final = 12.5
#: Largest number of pictures, which are kept in memory until the end.
_MOST: Final = 400
#: Number of pictures from which colours are chosen; and of these colours. The other 64 of a GIF form a cube, so that no
#: later colour is far from all of them.
_EARLY: Final = 24
_CHOSEN: Final = 192
_CUBE: Final = (0, 85, 170, 255)


class Encoder(Protocol):
    """Write pictures of one size into a video file."""

    def add(self, picture: Image) -> None:
        """Add an RGB picture ``(H, W, 3)`` uint8; raise ``OSError`` if it cannot be written."""
        ...

    def finish(self) -> None:
        """Complete the file; raise ``OSError`` if it is incomplete."""
        ...

    def abort(self) -> None:
        """Stop, leaving an incomplete file. After ``finish`` this does nothing."""
        ...


def open_encoder(file: Path, size: tuple[int, int], fps: float) -> Encoder:
    """Return an encoder for a file named ``.mp4`` or ``.avi``.

    Args:
        file: The file to write.
        size: (width, height) of the pictures in pixels.
        fps: Frames per second.

    Raises:
        OSError: There is no encoder for such a video.

    Warns:
        UserWarning: There is no H.264 encoder, so an ``.mp4`` file is one that browsers do not play.
    """
    if file.suffix == ".mp4":
        ffmpeg = find_ffmpeg()
        if ffmpeg is not None:
            return H264Encoder(ffmpeg, file, size, fps)
        warnings.warn(
            "no H.264 encoder is installed, so the video is MPEG-4 Part 2, which browsers do not play: "
            f"{install_hint('video')}.",
            UserWarning,
            stacklevel=3,
        )
    return _OpenCVEncoder(file, size, fps)


@cache
def find_ffmpeg() -> str | None:
    """Return the path of an ffmpeg that has libx264: that of the extra ``video``, or of ``IMAGEIO_FFMPEG_EXE``."""
    try:
        import imageio_ffmpeg
    except ImportError:
        return None
    try:
        path = imageio_ffmpeg.get_ffmpeg_exe()
        listed = subprocess.run([path, "-hide_banner", "-encoders"], capture_output=True, timeout=30, check=True)
    except (RuntimeError, OSError, subprocess.SubprocessError):  # no program for this system, or one that fails
        return None
    return path if b" libx264 " in listed.stdout else None


class H264Encoder:
    """Encode H.264 in MP4 with 8-bit 4:2:0 colour and the index in front, as browsers and phones play it.

    Pictures with an odd width or height get a copy of their last column or row, since 4:2:0 needs even sizes.

    Args:
        ffmpeg: Path of ffmpeg, as ``find_ffmpeg`` returns it.
        file: The file to write.
        size: (width, height) of the pictures in pixels.
        fps: Frames per second.
        options: Further output options of ffmpeg.
    """

    def __init__(
        self, ffmpeg: str, file: Path, size: tuple[int, int], fps: float, options: tuple[str, ...] = ()
    ) -> None:
        self._file = file
        self._odd = size[1] % 2, size[0] % 2
        width, height = size[0] + size[0] % 2, size[1] + size[1] % 2
        command = [ffmpeg, "-y", "-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
        command += ["-s", f"{width}x{height}", "-r", str(Fraction(fps).limit_denominator(1_000_000)), "-i", "-"]
        command += ["-an", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", str(_QUALITY), *options]
        command += ["-movflags", "+faststart", "-f", "mp4", str(file)]
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - open as long as the process
        # In a session of its own, so that Ctrl-C reaches only this program.
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=self._said, start_new_session=True
        )

    def add(self, picture: Image) -> None:
        """Add an RGB picture ``(H, W, 3)`` uint8.

        Raises:
            OSError: ffmpeg ended; the message has its reason.
        """
        if any(self._odd):
            picture = np.pad(picture, ((0, self._odd[0]), (0, self._odd[1]), (0, 0)), mode="edge")
        try:
            self._pipe().write(np.ascontiguousarray(picture).data)
        except OSError as error:
            raise self._failure() from error

    def finish(self) -> None:
        """Complete the file.

        Raises:
            OSError: ffmpeg could not write all of it; the message has its reason.
        """
        try:
            self._pipe().close()
        except OSError as error:
            raise self._failure() from error
        if self._process.wait() != 0:
            raise self._failure()

    def abort(self) -> None:
        """Stop ffmpeg, leaving an incomplete file."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        with suppress(BrokenPipeError):  # what was not written yet
            self._pipe().close()
        self._said.close()

    def _pipe(self) -> IO[bytes]:
        assert self._process.stdin is not None
        return self._process.stdin

    def _failure(self) -> OSError:
        self._process.wait()
        self._said.seek(0)
        reason = " ".join(self._said.read().decode(errors="replace").split())
        return OSError(f"ffmpeg cannot write {self._file.name}: {reason[:500]}")


class _OpenCVEncoder:
    """Encode with OpenCV: MPEG-4 Part 2 in ``.mp4``, Motion JPEG in ``.avi``."""

    def __init__(self, file: Path, size: tuple[int, int], fps: float) -> None:
        codec = _OPENCV[file.suffix]
        self._writer = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*codec), round(fps, 3), size)
        if not self._writer.isOpened():
            raise OSError(f"cannot write {file}: OpenCV cannot encode {codec!r} here.")

    def add(self, picture: Image) -> None:
        self._writer.write(np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)))

    def finish(self) -> None:
        self._writer.release()

    def abort(self) -> None:
        self._writer.release()


class GifEncoder:
    """Encode a GIF that is played at the speed of the frames and repeats for ever.

    Pictures are left out so that at most 12.5 remain per second and 400 in all: a long GIF has fewer pictures per
    second. All share one palette, chosen from the first 24 pictures, without dithering: still parts do not flicker and
    take no space.

    Args:
        file: The file to write.
        size: (width, height) of the pictures in pixels.
        fps: Frames per second of the pictures that are added.
    """

    def __init__(self, file: Path, size: tuple[int, int], fps: float) -> None:
        self._file, self._fps = file, fps
        scale = min(1.0, _LARGEST / max(size))
        self._size = max(1, round(size[0] * scale)), max(1, round(size[1] * scale))
        self._every = max(1, int(np.ceil(fps / _FASTEST - 1e-6)))
        self._count = 0
        self._palette: Pillow.Image | None = None
        self._early: list[Pillow.Image] = []
        self._kept: list[Pillow.Image] = []

    def add(self, picture: Image) -> None:
        """Add an RGB picture ``(H, W, 3)`` uint8."""
        if self._count % self._every == 0:
            small = Pillow.fromarray(np.asarray(cv2.resize(picture, self._size, interpolation=cv2.INTER_AREA)))
            self._early.append(small)
            if self._palette is not None or len(self._early) == _EARLY:
                self._reduce()
            if len(self._kept) > _MOST:
                self._kept, self._every = self._kept[::2], 2 * self._every
        self._count += 1

    def finish(self) -> None:
        """Write the file.

        Raises:
            OSError: The file cannot be written.
        """
        self._reduce()
        first, *rest = self._kept
        first.save(self._file, "GIF", save_all=True, append_images=rest, duration=list(self._durations()), loop=0)

    def abort(self) -> None:
        """Forget the pictures."""
        self._early.clear()
        self._kept.clear()

    def _reduce(self) -> None:
        """Reduce the colours of pictures to those of the palette."""
        if self._early and self._palette is None:
            self._palette = _palette(self._early)
        self._kept += [small.quantize(palette=self._palette, dither=Pillow.Dither.NONE) for small in self._early]
        self._early.clear()

    def _durations(self) -> Iterator[int]:
        """Yield how long each picture is shown, in milliseconds, so that rounding errors do not add up."""
        period, shown = 100 * self._every / self._fps, 0
        for i in range(len(self._kept)):
            until = max(round((i + 1) * period), shown + 1)
            yield 10 * (until - shown)
            shown = until


def _palette(pictures: Sequence[Pillow.Image]) -> Pillow.Image:
    """Return a palette for pictures and those like them."""
    strip = np.concatenate([np.asarray(picture)[::2, ::2] for picture in pictures])
    chosen = Pillow.fromarray(strip).quantize(_CHOSEN, method=Pillow.Quantize.MEDIANCUT).getpalette() or []
    chosen = (chosen + _CHOSEN * 3 * [0])[: _CHOSEN * 3]
    cube = [value for r in _CUBE for g in _CUBE for b in _CUBE for value in (r, g, b)]
    palette = Pillow.new("P", (1, 1))
    palette.putpalette(chosen + cube)
    return palette
