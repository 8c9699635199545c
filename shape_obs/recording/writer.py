"""Record a source into a folder, as fast as frames arrive, so that an interruption leaves only complete frames."""

from __future__ import annotations

import json
import platform
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, fields
from importlib import metadata
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from shape_obs import __version__
from shape_obs.extrinsics import now
from shape_obs.frame import Frame
from shape_obs.recording.format import (
    CAMERA_FILE,
    END,
    FORMAT,
    FRAMES_FILE,
    VERSION,
    Moment,
    camera_to_dict,
    read_moments,
    store,
)
from shape_obs.source import EndOfSource, RGBDSource, SourceError
from shape_obs.utils.files import make_folder, write_text

if TYPE_CHECKING:
    from typing_extensions import Self

Depth = Literal["auto", "yes", "no"]


@dataclass
class Recorded:
    """The outcome of a recording.

    Attributes:
        path: The folder or file.
        frames: Number of written frames.
        missed: Number of frames, by the source's frame numbers, that were never read.
        dropped: Number of frames that were read but not written, since the encoders or the disk were too slow.
        seconds: Time from the first stamp to the last; 0 without stamps.
        stopped: ``"done"`` (a limit, or the end of the source), ``"interrupted"`` (Ctrl-C), or the message of an error.
    """

    path: Path
    frames: int = 0
    missed: int = 0
    dropped: int = 0
    seconds: float = 0.0
    stopped: str = "done"

    def __post_init__(self) -> None:
        self._last: Frame | None = None

    def count(self, frame: Frame) -> None:
        """Count a frame that was read; when the frame numbers restart, no frame counts as missed."""
        before, self._last = self._last, frame
        if before is not None and before.number is not None and frame.number is not None:
            self.missed += max(frame.number - before.number - 1, 0)
        if before is not None and before.stamp is not None and frame.stamp is not None:
            self.seconds += frame.stamp - before.stamp

    def to_dict(self) -> dict[str, Any]:
        """Return the outcome as JSON values."""
        return {**{field.name: getattr(self, field.name) for field in fields(self)}, "path": str(self.path)}


def record(
    source: RGBDSource,
    path: str | Path,
    *,
    frames: int | None = None,
    seconds: float | None = None,
    depth: Depth = "auto",
    workers: int = 2,
    on_frame: Callable[[Moment], Any] | None = None,
) -> Recorded:
    """Record a source until a limit, its end, Ctrl-C, or the loss of the camera; recorded frames are kept.

    Args:
        source: The source; it is connected if necessary.
        path: A folder that does not exist or is empty.
        frames: Largest number of frames.
        seconds: Largest duration by the stamps.
        depth: ``"auto"`` records depth if there is any, ``"yes"`` requires it, ``"no"`` leaves it out.
        workers: Number of threads that encode images.
        on_frame: Called with each frame, for a progress bar or a view; its arrays must not be changed.

    Raises:
        ValueError: A limit is out of range, or depth is required and missing.
        FileExistsError: The folder is not empty.
        OSError: A file cannot be written, as on a full disk; the message gives the number of complete frames.
        SourceError: The source cannot be opened, or has no frame.
    """
    check_new_folder(Path(path))
    source.connect()
    if depth == "yes" and not source.has_depth:
        raise ValueError(f"{source.name} has no depth to record; a {source.kind} source has only colour.")
    moments = read_moments(source, frames, seconds)
    # Read before the folder is made, so that a source without frames leaves nothing behind.
    first = next(moments, None)
    if first is None:
        raise EndOfSource(f"{source.name} has no frame.")
    recorded = Recorded(Path(path))
    with RecordingWriter(path, source, depth=source.has_depth and depth != "no", workers=workers) as writer:
        try:
            for moment in chain([first], moments):
                recorded.count(moment.frame)
                recorded.dropped += not writer.add(moment, wait=not source.live)
                if on_frame is not None:
                    on_frame(moment)
        except KeyboardInterrupt:
            recorded.stopped = "interrupted"
        except SourceError as error:
            recorded.stopped = str(error)
        writer.close(missed=recorded.missed, dropped=recorded.dropped, stopped=recorded.stopped)
    recorded.frames = writer.frames
    return recorded


class RecordingWriter:
    """Write a recording. Use it as a context manager, which finishes the recording on exit.

    Several threads encode images. Lines are appended in order, each after the files that it names, so that an
    interrupted recording has only complete lines.

    Args:
        path: A folder that does not exist or is empty.
        source: The connected source of the frames.
        depth: Whether to record depth.
        workers: Number of threads that encode images.
        pending: Largest number of frames that wait for the threads.

    Attributes:
        path: The folder.
        frames: Number of completely written frames.

    Raises:
        FileExistsError: The folder is not empty.
        OSError: The folder cannot be made or written to.
    """

    def __init__(
        self, path: str | Path, source: RGBDSource, *, depth: bool = True, workers: int = 2, pending: int = 64
    ) -> None:
        self.path = Path(path)
        check_new_folder(self.path)
        for folder in (self.path, self.path / "rgb", *([self.path / "depth"] if depth else [])):
            make_folder(folder)
        self.frames = 0
        self._depth = depth
        self._camera = source.camera
        self._count = 0
        write_text(self.path / CAMERA_FILE, json.dumps(_head(source, depth), indent=1) + "\n")
        self._lines = (self.path / FRAMES_FILE).open("xb", buffering=0)
        self._error: BaseException | None = None
        self._waiting: deque[Future[dict[str, Any]]] = deque()
        self._lock = threading.Lock()
        self._slots = threading.BoundedSemaphore(pending)
        self._pool = ThreadPoolExecutor(workers, thread_name_prefix="recording")

    def add(self, moment: Moment, *, wait: bool = True) -> bool:
        """Add a frame.

        Args:
            moment: The frame; its arrays must not be changed afterwards.
            wait: Whether to wait while too many frames are pending; otherwise the frame is dropped.

        Returns:
            Whether the frame was added.

        Raises:
            OSError: An earlier frame could not be written; the frames before it are complete.
        """
        self._check()
        if not self._slots.acquire(blocking=wait):
            return False
        with self._lock:
            future = self._pool.submit(self._store, self._count, moment)
            self._waiting.append(future)
            self._count += 1
        future.add_done_callback(lambda _: self._settle())
        return True

    def close(self, **values: Any) -> None:
        """Wait for the encoders and finish the recording; later calls do nothing.

        Args:
            values: JSON values for the last line, such as the number of dropped frames.

        Raises:
            OSError: A frame could not be written; the frames before it are complete.
        """
        if self._lines.closed:
            return
        self._pool.shutdown(wait=True)
        try:
            if self._error is None:
                self._append({END: True, "frames": self.frames, **values})
        finally:
            self._lines.close()
        self._check()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _store(self, index: int, moment: Moment) -> dict[str, Any]:
        frame = moment.frame
        line: dict[str, Any] = {"number": frame.number, "stamp": frame.stamp, "received": frame.received}
        line["episode"] = moment.episode
        if moment.anchors:
            line["anchors"] = {name: [float(value) for value in point] for name, point in moment.anchors.items()}
        camera = camera_to_dict(frame.camera)
        if camera != camera_to_dict(self._camera):
            line["camera"] = camera
        if frame.rgb is not None:
            line["rgb"] = store(self.path, "rgb", index, frame.rgb)
        if frame.depth is not None and self._depth:
            line["depth"] = store(self.path, "depth", index, frame.depth)
        return line

    def _settle(self) -> None:
        """Append the lines of all encoded frames, in order."""
        with self._lock:
            while self._waiting and self._waiting[0].done():
                future = self._waiting.popleft()
                self._slots.release()
                # After an error nothing is appended, since a line after a partial line would be lost too.
                self._error = self._error or future.exception()
                if self._error is None:
                    try:
                        self._append(future.result())
                        self.frames += 1
                    except OSError as error:
                        self._error = error

    def _append(self, line: Mapping[str, Any]) -> None:
        rest = json.dumps(line, separators=(",", ":")).encode() + b"\n"
        try:
            while rest:  # a full disk accepts a part before it raises an error
                rest = rest[self._lines.write(rest) :]
        except OSError as error:
            raise OSError(f"cannot write {self.path / FRAMES_FILE}: {error.strerror or error}") from error

    def _check(self) -> None:
        if self._error is not None:
            raise OSError(f"{self._error}; {self.frames} whole frames are kept in {self.path}.") from self._error


def check_new_folder(path: Path) -> None:
    """Check that a recording can be written to a folder, before a source is opened.

    Raises:
        FileExistsError: The folder is not empty.
        OSError: The folder cannot be made or written to.
    """
    existed = path.exists()
    if any(make_folder(path).iterdir()):
        raise FileExistsError(f"{path}: the folder is not empty; a recording needs an empty folder.")
    if not existed:  # so that a later error leaves nothing behind
        path.rmdir()


def software() -> dict[str, str]:
    """Return the versions of the packages that write a file."""
    versions = {"shape_obs": __version__, "python": platform.python_version()}
    for name, module in (("numpy", "numpy"), ("opencv-python-headless", "cv2"), ("pyrealsense2", "pyrealsense2")):
        if module in sys.modules:
            try:
                versions[name] = metadata.version(name)
            except metadata.PackageNotFoundError:  # another build of it
                versions[name] = str(getattr(sys.modules[module], "__version__", "unknown"))
    return versions


def _head(source: RGBDSource, depth: bool) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "version": VERSION,
        "source": {"kind": source.kind, "name": source.name},
        "serial": getattr(source, "serial", None),
        "depth": depth,
        **camera_to_dict(source.camera),
        "convention": "p_base = T p_camera, metres; depth/*.png in millimetres, *.npy in metres",
        "created": now(),
        "software": software(),
    }
