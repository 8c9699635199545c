"""Log a run to disk, in a thread so that the disk never delays the robot, and report on it in constant memory."""

from __future__ import annotations

import json
import math
import os
import platform
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from shape_obs import __version__
from shape_obs.config.detector_config import ALGORITHM
from shape_obs.spec import to_plain
from shape_obs.utils.documents import read_json
from shape_obs.utils.errors import run_last
from shape_obs.utils.files import write_whole

if TYPE_CHECKING:
    from typing_extensions import Self
STEPS: Final = "steps.jsonl"
HEADER: Final = "run.json"
REPORT: Final = "report.json"
#: Largest number of steps that wait for the disk: five minutes at 30 Hz.
_WAITING: Final = 9000
#: Bins grow by 1 % each, from a microsecond to an hour; in milliseconds.
_LEAST: Final = 1e-3
_GROWTH: Final = math.log(1.01)
_BINS: Final = int(math.log(3.6e6 / _LEAST) / _GROWTH) + 2


class RunLog:
    """Write a folder with ``run.json`` (what ran), ``steps.jsonl`` (one line per step) and ``report.json``.

    Use it as a context manager. Inside, a thread writes the steps and flushes each line. On exit it waits until
    everything is written.

    Args:
        folder: Folder; it is made if necessary.
        header: What runs: configuration, schema hash, source, robot, controller, limits.

    Raises:
        FileExistsError: The folder already holds a run.
        OSError: The folder cannot be written to.
    """

    def __init__(self, folder: str | os.PathLike[str], header: Mapping[str, Any]) -> None:
        self.folder = Path(folder)
        check_new_log(self.folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        started = {
            "shape_obs": __version__,
            "algorithm": ALGORITHM,
            "python": platform.python_version(),
            "started": time.time(),
        }
        self._write(HEADER, {**started, **header})
        self._tasks: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._failure: Exception | None = None

    def step(self, record: Mapping[str, Any]) -> None:
        """Add a step without waiting for the disk. The record must not be changed afterwards.

        Raises:
            OSError: An earlier step could not be written, or 9000 steps are waiting for the disk.
        """
        self._raise_failure()
        if self._tasks.qsize() >= _WAITING:
            raise OSError(f"{self.folder / STEPS}: the disk is {_WAITING} steps behind: log to a faster disk.")
        self._tasks.put(lambda: self._write_step(record))

    def report(self, report: Mapping[str, Any]) -> None:
        """Add the report, after all steps, without waiting for the disk."""
        self._tasks.put(lambda: self._write(REPORT, report))

    def _write_step(self, record: Mapping[str, Any]) -> None:
        # Shapes are converted to JSON here, since in the loop that would delay the robot.
        shapes = [shape.to_dict() for shape in record.get("shapes", ())]
        self._steps.write(json.dumps(to_plain({**record, "shapes": shapes}), separators=(",", ":")) + "\n")
        self._steps.flush()

    def _write(self, name: str, content: Mapping[str, Any]) -> None:
        text = json.dumps(to_plain(content), indent=2) + "\n"
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
        run_last(error, self._steps.close, self._raise_failure)


def check_new_log(folder: Path) -> None:
    """Check that a log can be written to a folder; the header of a run that did not begin may be there.

    Raises:
        FileExistsError: The folder holds a run, or a file of the same name.
    """
    header = folder / HEADER
    begun = (folder / STEPS).exists() or (folder / REPORT).exists()
    if begun or (header.exists() and "algorithm" not in read_json(header, "log")):
        raise FileExistsError(f"{folder} holds a run already: choose another folder for the log.")


class Section(NamedTuple):
    """Median, 95th percentile and maximum of the milliseconds of a part of the loop."""

    median: float
    p95: float
    most: float


class Quantiles:
    """Estimate quantiles of milliseconds in constant memory, accurate to 0.5 %.

    Values are counted in bins that grow by 1 %; values below a microsecond count as 0.
    """

    def __init__(self) -> None:
        self._counts = np.zeros(_BINS, np.int64)
        self._most = 0.0

    def add(self, value: float) -> None:
        """Add a value in milliseconds."""
        bin_ = 0 if value < _LEAST else min(1 + int(math.log(value / _LEAST) / _GROWTH), _BINS - 1)
        self._counts[bin_] += 1
        self._most = max(self._most, value)

    def section(self) -> Section:
        """Return the quantiles of all values; there must be at least one."""
        return Section(self._quantile(0.5), self._quantile(0.95), round(self._most, 3))

    def _quantile(self, fraction: float) -> float:
        reached = np.cumsum(self._counts)
        bin_ = int(np.searchsorted(reached, fraction * reached[-1]))
        if bin_ == 0:
            return 0.0
        return round(min(_LEAST * math.exp((bin_ - 0.5) * _GROWTH), self._most), 3)


@dataclass(frozen=True)
class Report:
    """A summary of a run.

    Args:
        steps: Number of steps.
        seconds: Duration of the run.
        overruns: Number of steps that missed their deadline.
        acted: Number of steps with an action.
        held: Number of steps without an action, since the shape was lost or late.
        expired: Number of motions that ended because no new one replaced them in time.
        guarded: Number of actions that the action limiter changed: ``clipped``, ``capped``, ``boxed``.
        reasons: Number of held steps by reason.
        ended: Reason of the end.
        failed: Whether the reason is an error: an exception, a failure of camera or robot, a lost shape, or the
            watchdog.
        success: Whether the goal was reached in the last frame; None without a goal.
        sections: Milliseconds per part of the loop, accurate to 0.5 %. ``source`` is rectification and alignment,
            ``detect`` the detector, ``between`` features and checks, ``act`` the controller, ``send`` the action
            limiter and the robot; ``own`` is their sum, from raw images to the action sent; ``age`` is the age of the
            images before that.
    """

    steps: int
    seconds: float
    overruns: int
    acted: int
    held: int
    expired: int
    guarded: dict[str, int]
    reasons: dict[str, int]
    ended: str
    failed: bool
    success: bool | None
    sections: dict[str, Section]

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON values."""
        sections = {name: section._asdict() for name, section in self.sections.items()}
        return {**asdict(self), "sections": sections}

    def __str__(self) -> str:
        lines = [
            f"steps           {self.steps} in {self.seconds:.1f} s ({self.steps / max(self.seconds, 1e-9):.2f} Hz), "
            f"overruns: {self.overruns}",
            f"acted           {self.acted}, held: {self.held}"
            + "".join(f"\n  held          {count} x {reason}" for reason, count in self.reasons.items()),
            "guard           " + ", ".join(f"{name} {count}" for name, count in self.guarded.items()),
            f"motions         ended early: {self.expired}",
            f"ended           {self.ended}",
        ]
        if self.success is not None:
            lines.append(f"goal            {'reached' if self.success else 'not reached'}")
        if self.sections:
            lines.append("milliseconds    median     p95     max")
            lines += [
                f"  {name:<12} {section.median:8.2f}{section.p95:8.2f}{section.most:8.2f}"
                for name, section in self.sections.items()
            ]
        return "\n".join(lines)


@dataclass
class Tally:
    """Collect the counts and times of a run in progress."""

    acted: int = 0
    held: int = 0
    guarded: Counter[str] = field(default_factory=lambda: Counter(clipped=0, capped=0, boxed=0))
    reasons: Counter[str] = field(default_factory=Counter)
    sections: dict[str, Quantiles] = field(default_factory=dict)

    def time(self, milliseconds: dict[str, float]) -> None:
        """Add the times of a step."""
        for name, value in milliseconds.items():
            self.sections.setdefault(name, Quantiles()).add(value)

    def report(self, **rest: Any) -> Report:
        """Return the report of the run."""
        return Report(
            acted=self.acted,
            held=self.held,
            guarded=dict(self.guarded),
            reasons=dict(self.reasons),
            sections={name: times.section() for name, times in self.sections.items()},
            **rest,
        )
