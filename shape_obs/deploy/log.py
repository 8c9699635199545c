"""RunLog: a run on disk, step by step, written by a thread so that no disk delays the robot."""

from __future__ import annotations

import json
import logging
import os
import platform
import queue
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final

from shape_obs import __version__
from shape_obs.files import write_whole
from shape_obs.spec import plain

if TYPE_CHECKING:
    from typing_extensions import Self

STEPS: Final = "steps.jsonl"
HEADER: Final = "run.json"
REPORT: Final = "report.json"
#: Steps that may wait for the disk: five minutes at 30 Hz.
_WAITING: Final = 9000
_LOG: Final = logging.getLogger(__name__)


class RunLog:
    """Write a folder with ``run.json`` (what ran), ``steps.jsonl`` (a line for each step) and ``report.json``.

    A context manager. Within, a thread writes what it is given; each line is handed to the operating system as soon as
    it is written. On exit it waits until all is written.

    Args:
        folder: Made where it is missing.
        header: What ran: configuration, schema hash, source, robot, controller, limits.

    Raises:
        FileExistsError: The folder holds a run already.
        OSError: It cannot be written to.
    """

    def __init__(self, folder: str | os.PathLike[str], header: Mapping[str, Any]) -> None:
        self.folder = Path(folder)
        if (self.folder / STEPS).exists():
            raise FileExistsError(f"{self.folder} holds a run already: name another folder for the log.")
        self.folder.mkdir(parents=True, exist_ok=True)
        started = {"shape_obs": __version__, "python": platform.python_version(), "started": time.time()}
        self._write(HEADER, {**started, **header})
        self._tasks: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._failure: Exception | None = None

    def step(self, record: Mapping[str, Any]) -> None:
        """Add a step, without waiting for the disk. The record must not be changed afterwards.

        Raises:
            OSError: An earlier step could not be written, or the disk is behind by 9000 steps.
        """
        self._raise_failure()
        if self._tasks.qsize() >= _WAITING:
            raise OSError(f"{self.folder / STEPS}: the disk is {_WAITING} steps behind: log to a faster one.")
        self._tasks.put(lambda: self._write_step(record))

    def report(self, report: Mapping[str, Any]) -> None:
        """Write how the run went, after its steps, without waiting for the disk."""
        self._tasks.put(lambda: self._write(REPORT, report))

    def _write_step(self, record: Mapping[str, Any]) -> None:
        # Shapes become JSON here: in the loop that would delay the robot.
        shapes = [shape.to_dict() for shape in record.get("shapes", ())]
        self._steps.write(json.dumps(plain({**record, "shapes": shapes}), separators=(",", ":")) + "\n")
        self._steps.flush()

    def _write(self, name: str, content: Mapping[str, Any]) -> None:
        text = json.dumps(plain(content), indent=2) + "\n"
        write_whole(self.folder / name, lambda path: path.write_text(text, encoding="utf-8"))

    def _work(self) -> None:
        while (task := self._tasks.get()) is not None:
            self._try(task)

    def _try(self, task: Callable[[], None]) -> None:
        try:
            task()
        except Exception as error:  # noqa: BLE001 - raised by the next step, or on exit
            self._failure = self._failure or error

    def _raise_failure(self) -> None:
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def __enter__(self) -> Self:
        self._steps = (self.folder / STEPS).open("x", encoding="utf-8")
        self._thread = threading.Thread(target=self._work, name="run log", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._tasks.put(None)
        self._thread.join()
        self._steps.close()
        if error is None:
            self._raise_failure()
        elif self._failure is not None:
            _LOG.error("The log is not whole: %s", self._failure)
