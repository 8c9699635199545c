"""Encode videos: H.264 where ffmpeg with libx264 is installed, otherwise what OpenCV has."""

from __future__ import annotations

import subprocess
import tempfile
import warnings
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import IO, Final, Protocol

import cv2
import numpy as np

from shape_obs.drawing import Image
from shape_obs.utils.errors import install_hint

#: Codecs of OpenCV by suffix. Browsers play neither of them.
_OPENCV: Final = {".mp4": "mp4v", ".avi": "MJPG"}
#: Constant quality of libx264: thin lines and small numbers stay sharp.
_QUALITY: Final = 20


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
        command += ["-s", f"{width}x{height}", "-r", f"{fps:.6g}", "-i", "-"]
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
