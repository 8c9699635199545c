"""Open a rerun recording stream to a file, to a viewer on this machine, or to one elsewhere."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlparse

from shape_obs.drawing.rerun_log import import_rerun
from shape_obs.utils.files import begin_file, finish_file, make_folder

if TYPE_CHECKING:
    from typing_extensions import Self

#: The target that opens a viewer on this machine.
VIEWER: Final = "viewer"
SUFFIX: Final = ".rrd"
_PORT: Final = 9876  # rerun's own
_LAST: Final = 5.0  # seconds in which a viewer must take what is left
_PATIENCE: Final = 15.0  # seconds until a viewer that was started must accept connections


class RerunStream:
    """A rerun recording stream as a context manager.

    A file is written completely or not at all: after an error an existing file is unchanged. After Ctrl-C or SIGTERM it
    holds what was logged up to then. A viewer keeps what it has received. A viewer that is closed ends nothing: what is
    logged afterwards is discarded.

    Args:
        target: ``FILE.rrd``, ``"viewer"`` to open a window on this machine, or the address of a running viewer,
            ``rerun+http://HOST:9876/proxy``.

    Attributes:
        recording: The ``rerun.RecordingStream``.
        path: The file; None for a viewer.

    Raises:
        ImportError: rerun is not installed; the extra ``rerun`` installs it.
        ValueError: The target is neither a file named ``*.rrd`` nor an address.
        OSError: The file cannot be written, or there is no viewer.
    """

    def __init__(self, target: str | Path) -> None:
        self._rr = rr = import_rerun()
        text = str(target)
        self.path = Path(text) if text.endswith(SUFFIX) else None
        if self.path is None and text != VIEWER and "://" not in text:
            raise ValueError(f"rerun: expected FILE{SUFFIX} or an address such as {address('HOST')}, got {text!r}.")
        self._temporary = Path()
        self.recording: Any = rr.RecordingStream("shape_obs")
        if self.path is not None:
            make_folder(self.path.parent)
            self._temporary = begin_file(self.path)
            self.recording.save(str(self._temporary))
        elif text == VIEWER:
            _open_viewer()
            self.recording.connect_grpc(address("127.0.0.1"))
        else:
            place = urlparse(text)
            # Without a viewer rerun would wait for one in the first call that has much to send.
            _wait_for(place.hostname or "", place.port or _PORT, 2.0, f"no rerun viewer at {text}")
            self.recording.connect_grpc(text)

    def close(self) -> None:
        """Send what is left, and finish the file; a viewer that hangs is left alone after some seconds."""
        if self.path is None:
            sender = threading.Thread(target=self.recording.disconnect, name="rerun", daemon=True)
            sender.start()
            sender.join(_LAST)
            if sender.is_alive():
                self._rr.unregister_shutdown()  # which would wait for the viewer at the end of the process
            return
        self.recording.disconnect()
        if self._temporary.exists():
            finish_file(self._temporary, self.path)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.path is None or not isinstance(error, Exception):
            self.close()
        else:
            self.recording.disconnect()
            self._temporary.unlink(missing_ok=True)


def address(host: str, port: int = _PORT) -> str:
    """Return the address of the viewer on a host."""
    return f"rerun+http://{host}:{port}/proxy"


def _open_viewer() -> None:
    """Open a viewer unless there is one.

    Its own ``spawn`` would give it the standard output of this process, so that a pipe stays open as long as it runs.

    Raises:
        OSError: It does not start.
    """
    if _listens("127.0.0.1", _PORT):
        return
    silent: Any = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    command = [sys.executable, "-m", "rerun", "--port", str(_PORT), "--memory-limit", "75%"]
    subprocess.Popen(command, start_new_session=True, **silent)
    _wait_for("127.0.0.1", _PORT, _PATIENCE, f"the rerun viewer did not start; write a file: FILE{SUFFIX}")


def _wait_for(host: str, port: int, patience: float, message: str) -> None:
    """Wait until a port accepts connections.

    Raises:
        OSError: It does not.
    """
    end = time.monotonic() + patience
    while not _listens(host, port):
        if time.monotonic() > end:
            raise OSError(f"{message}.")
        time.sleep(0.1)


def _listens(host: str, port: int) -> bool:
    try:
        with socket.create_connection((host, port), timeout=1.0):
            return True
    except OSError:
        return False
