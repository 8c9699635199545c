"""Write frames into a folder, as fast as they arrive, so that an interruption leaves only complete frames."""

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
from shape_obs.extrinsics import now
from shape_obs.recording.format import (
    CAMERA_FILE,
    END,
    FORMAT,
    FRAMES_FILE,
    VERSION,
    Moment,
    RobotInfo,
    camera_to_dict,
)
from shape_obs.recording.images import store
from shape_obs.source import RGBDSource
from shape_obs.utils.errors import run_last
from shape_obs.utils.files import listing, make_folder, write_text

if TYPE_CHECKING:
    from typing_extensions import Self


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
        robot: Names of the values of actions and states; None for those that the source publishes as ``robot_info``.

    Attributes:
        path: The folder.
        frames: Number of completely written frames.
        actions: Number of these frames that an action led to.

    Raises:
        FileExistsError: The folder is not empty.
        OSError: The folder cannot be made or written to.
    """

    path: Path
    frames: int
    actions: int

    def __init__(
        self,
        path: str | Path,
        source: RGBDSource,
        *,
        depth: bool = True,
        workers: int = 2,
        pending: int = 64,
        robot: RobotInfo | None = None,
    ) -> None:
        self.path = Path(path)
        check_new_folder(self.path)
        for folder in (self.path, self.path / "rgb", *([self.path / "depth"] if depth else [])):
            make_folder(folder)
        self.frames = self.actions = 0
        self._depth = depth
        self._camera = source.camera
        self._count = 0
        write_text(self.path / CAMERA_FILE, json.dumps(_head(source, depth, robot), indent=1) + "\n")
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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        run_last(error, self.close)

    def _store(self, index: int, moment: Moment) -> dict[str, Any]:
        frame = moment.frame
        line: dict[str, Any] = {"number": frame.number, "stamp": frame.stamp, "received": frame.received}
        line["episode"] = moment.episode
        if moment.anchors:
            line["anchors"] = {name: [float(value) for value in point] for name, point in moment.anchors.items()}
        camera = camera_to_dict(frame.camera)
        if camera != camera_to_dict(self._camera):
            line["camera"] = camera
        if moment.transition is not None:
            line["transition"] = moment.transition.to_dict()
        if moment.state is not None:
            line["state"] = list(moment.state)
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
                        line = future.result()
                        self._append(line)
                        self.frames += 1
                        self.actions += line.get("transition", {}).get("action") is not None
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
    if listing(make_folder(path)):
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


def _head(source: RGBDSource, depth: bool, robot: RobotInfo | None) -> dict[str, Any]:
    robot = getattr(source, "robot_info", None) if robot is None else robot
    return {
        "format": FORMAT,
        "version": VERSION,
        "source": {"kind": source.kind, "name": source.name},
        "serial": getattr(source, "serial", None),
        "depth": depth,
        **camera_to_dict(source.camera),
        "robot": None if robot is None else robot.to_dict(),
        "convention": "p_base = T p_camera, metres; depth/*.png in millimetres, *.npy in metres",
        "created": now(),
        "software": software(),
    }
