"""RecordingWriter: frames into a folder, as fast as they come, so that whatever happens what is written is whole."""

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
