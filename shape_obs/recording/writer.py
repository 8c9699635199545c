"""RecordingWriter: frames into a folder, as fast as they come, so that whatever happens what is written is whole.

record: from a source into a folder.
"""

from __future__ import annotations

import json
import platform
import sys
import threading
from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from importlib import metadata
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from shape_obs import __version__
from shape_obs.camera import CameraModel
from shape_obs.extrinsics import now
from shape_obs.recording.format import CAMERA_FILE, END, FORMAT, FRAMES_FILE, VERSION, Moment, camera_to_dict, store
from shape_obs.source import RGBDSource
from shape_obs.utils.files import make_folder, write_text

if TYPE_CHECKING:
    from typing_extensions import Self
from collections.abc import Callable
from dataclasses import dataclass, fields
from itertools import chain
from typing import Literal

from shape_obs.frame import Frame
from shape_obs.recording.format import read_moments
from shape_obs.source import EndOfSource, SourceError


class RecordingWriter:
    """Writes a recording. A context manager: it ends the recording on exit.

    Images are encoded by a few threads (OpenCV does that outside the interpreter's lock); lines are appended in order,
    each after the files that it names.

    Args:
        path: A folder that does not exist or is empty.
        source: Where the frames come from; connected. It tells the camera, and who it is.
        depth: Whether depth is recorded.
        workers: Threads that encode.
        pending: Frames that may wait for them.

    Attributes:
        path: The folder.
        frames: How many frames are wholly written.

    Raises:
        FileExistsError: The folder is not empty.
        OSError: It cannot be made or written to.
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
        """Take a frame to be written.

        Args:
            moment: Its arrays must not be written to afterwards.
            wait: For the encoders to catch up; otherwise a frame that they have no room for is dropped.

        Returns:
            Whether it was taken.

        Raises:
            OSError: An earlier frame could not be written; the frames before it are whole.
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

    def close(self, **told: Any) -> None:
        """Wait for the encoders and end the recording; nothing happens when that was done.

        Args:
            told: JSON-able values for the last line, such as how many frames were dropped.

        Raises:
            OSError: A frame could not be written; the frames before it are whole.
        """
        if self._lines.closed:
            return
        self._pool.shutdown(wait=True)
        try:
            if self._error is None:
                self._append({END: True, "frames": self.frames, **told})
        finally:
            self._lines.close()
        self._check()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _store(self, index: int, moment: Moment) -> dict[str, Any]:
        frame = moment.frame
        line: dict[str, Any] = {"number": frame.number, "stamp": frame.stamp, "received": frame.received}
        line["episode"] = moment.episode
        if moment.anchors:
            line["anchors"] = {name: [float(value) for value in point] for name, point in moment.anchors.items()}
        told = camera_to_dict(frame.camera)
        if told != camera_to_dict(self._camera):
            line["camera"] = told
        if frame.rgb is not None:
            line["rgb"] = store(self.path, "rgb", index, frame.rgb)
        if frame.depth is not None and self._depth:
            line["depth"] = store(self.path, "depth", index, frame.depth)
        return line

    def _settle(self) -> None:
        """Append the lines of all that is done, in order."""
        with self._lock:
            while self._waiting and self._waiting[0].done():
                future = self._waiting.popleft()
                self._slots.release()
                # After an error nothing is appended: a line behind half a line would be lost with it.
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
            while rest:  # a full disk first takes a part, then complains
                rest = rest[self._lines.write(rest) :]
        except OSError as error:
            raise OSError(f"cannot write {self.path / FRAMES_FILE}: {error.strerror or error}") from error

    def _check(self) -> None:
        if self._error is not None:
            raise OSError(f"{self._error}; {self.frames} whole frames are kept in {self.path}.") from self._error


def check_new_folder(path: Path) -> None:
    """See that a recording can be written there, before a source is opened.

    Raises:
        FileExistsError: It is a folder that is not empty.
        OSError: It cannot be made or written to.
    """
    there = path.exists()
    if any(make_folder(path).iterdir()):
        raise FileExistsError(f"{path}: the folder is not empty; a recording needs one of its own.")
    if not there:  # it was only a trial: whatever goes wrong next leaves nothing behind
        path.rmdir()


def software() -> dict[str, str]:
    """Versions of what made a file."""
    versions = {"shape_obs": __version__, "python": platform.python_version()}
    for name, module in (("numpy", "numpy"), ("opencv-python-headless", "cv2"), ("pyrealsense2", "pyrealsense2")):
        if module in sys.modules:
            try:
                versions[name] = metadata.version(name)
            except metadata.PackageNotFoundError:  # another build of it
                versions[name] = str(getattr(sys.modules[module], "__version__", "unknown"))
    return versions


def _head(source: RGBDSource, depth: bool) -> dict[str, Any]:
    camera: CameraModel | None = source.camera
    return {
        "format": FORMAT,
        "version": VERSION,
        "source": {"kind": source.kind, "name": source.name},
        "serial": getattr(source, "serial", None),
        "depth": depth,
        **camera_to_dict(camera),
        "convention": "p_base = T p_camera, metres; depth/*.png in millimetres, *.npy in metres",
        "created": now(),
        "software": software(),
    }


Depth = Literal["auto", "yes", "no"]


@dataclass
class Recorded:
    """What became of a recording.

    Attributes:
        path: The folder or file.
        frames: Written.
        missed: By the source's own count: lost on the way, or because nobody read in time.
        dropped: Frames that were read but found the encoders or the disk too slow.
        seconds: From the first stamp to the last; 0 without stamps.
        stopped: Why it ended: ``"done"`` (a limit, or the source's end), ``"interrupted"`` (Ctrl-C), or the message of
            an error.
    """

    path: Path
    frames: int = 0
    missed: int = 0
    dropped: int = 0
    seconds: float = 0.0
    stopped: str = "done"

    def __post_init__(self) -> None:
        self._last: Frame | None = None

    def saw(self, frame: Frame) -> None:
        """Count a frame that was read; a source that begins to count anew missed none."""
        before, self._last = self._last, frame
        if before is None:
            return
        if before.number is not None and frame.number is not None:
            self.missed += max(frame.number - before.number - 1, 0)
        if before.stamp is not None and frame.stamp is not None:
            self.seconds += frame.stamp - before.stamp

    def to_dict(self) -> dict[str, Any]:
        """JSON-able values."""
        return {**{field.name: getattr(self, field.name) for field in fields(self)}, "path": str(self.path)}


def record(
    source: RGBDSource,
    path: str | Path,
    *,
    frames: int | None = None,
    seconds: float | None = None,
    depth: Depth = "auto",
    workers: int = 2,
    on_frame: Callable[[], Any] | None = None,
) -> Recorded:
    """Record a source until a limit, its end, or Ctrl-C. A camera that is lost ends it too: what is there is kept.

    Args:
        source: Is connected where it is not.
        path: A folder that does not exist or is empty.
        frames: How many at most.
        seconds: By the stamps.
        depth: ``"auto"`` records what there is, ``"yes"`` insists on it, ``"no"`` leaves it out.
        workers: Threads that encode images.
        on_frame: Called after each frame, for a progress bar.

    Raises:
        ValueError: A limit that is none, or no depth where it was insisted on.
        FileExistsError: The folder is not empty.
        OSError: A file cannot be written, as on a full disk; the message tells how many whole frames are kept.
        SourceError: The source cannot be opened, or not even its first frame came.
    """
    check_new_folder(Path(path))
    source.connect()
    if depth == "yes" and not source.has_depth:
        raise ValueError(f"{source.name} has no depth to record; a {source.kind} source gives colour alone.")
    moments = read_moments(source, frames, seconds)
    # Before the folder is made: a source that gives nothing leaves nothing behind.
    first = next(moments, None)
    if first is None:
        raise EndOfSource(f"{source.name} has no frame.")
    told = Recorded(Path(path))
    with RecordingWriter(path, source, depth=source.has_depth and depth != "no", workers=workers) as writer:
        try:
            for moment in chain([first], moments):
                told.saw(moment.frame)
                told.dropped += not writer.add(moment, wait=not source.live)
                if on_frame is not None:
                    on_frame()
        except KeyboardInterrupt:
            told.stopped = "interrupted"
        except SourceError as error:
            told.stopped = str(error)
        writer.close(missed=told.missed, dropped=told.dropped, stopped=told.stopped)
    told.frames = writer.frames
    return told
