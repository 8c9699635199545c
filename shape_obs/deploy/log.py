"""RunLog: a run on disk, step by step, so that nothing is lost when it ends badly."""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Mapping
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


class RunLog:
    """A folder with ``run.json`` (what ran), ``steps.jsonl`` (a line a step, written at once) and ``report.json``.

    A context manager: the file of steps is open within.

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

    def step(self, record: Mapping[str, Any]) -> None:
        """Add a step; it is handed to the operating system at once."""
        self._steps.write(json.dumps(plain(record), separators=(",", ":")) + "\n")
        self._steps.flush()

    def report(self, report: Mapping[str, Any]) -> None:
        """Write how it went."""
        self._write(REPORT, report)

    def _write(self, name: str, content: Mapping[str, Any]) -> None:
        text = json.dumps(plain(content), indent=2) + "\n"
        write_whole(self.folder / name, lambda beside: beside.write_text(text, encoding="utf-8"))

    def __enter__(self) -> Self:
        self._steps = (self.folder / STEPS).open("x", encoding="utf-8")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._steps.close()
