"""Kill ``shape-obs ablate`` at random instants: finished runs stay, and what is resumed equals an undisturbed study."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import yaml
from ablation_study import STUDY

_COMMAND: Final = (sys.executable, "-c", "from shape_obs.cli import main; main()", "ablate")
_PATIENCE: Final = 300.0  # seconds; far more than the study takes
_POLL: Final = 0.002  # seconds
_LOG: Final = logging.getLogger(__name__)


class Killed(NamedTuple):
    """What became of studies that were killed and resumed.

    Attributes:
        kills: How often a study was killed.
        lost: Files of finished runs that a kill or a resumption lost or changed.
        finished: How many studies got finished.
        different: Those of them that failed or differ from an undisturbed one.
    """

    kills: int
    lost: int
    finished: int
    different: int


def killed_studies(folder: Path, kills: int, seed: int = 0) -> Killed:
    """Kill a study again and again, resume it, and compare it with one that was left alone.

    Every other kill comes at a random time. The others come right after a random one of the files that the study makes
    appeared, temporary ones too: the instants in which something could be half-written. A study that gets finished is
    compared, and the next one begins.

    Args:
        folder: An empty folder for the studies.
        kills: How many kills.
        seed: Of the instants.
    """
    file, draw = folder / "study.yaml", np.random.default_rng(seed)
    file.write_text(yaml.safe_dump(dict(STUDY)), encoding="utf-8")
    begin = time.monotonic()
    _run(file, folder / "undisturbed", lambda: False)
    seconds, wanted = time.monotonic() - begin, _results(folder / "undisturbed")
    files = len(_files(folder / "undisturbed"))
    done, lost, different, compared = 0, 0, 0, 0
    while done < kills:
        root, kept, code = folder / f"killed{compared}", dict[Path, bytes](), -signal.SIGKILL
        while code == -signal.SIGKILL:
            if done == kills:
                stop: Callable[[], bool] = lambda: False  # noqa: E731 - to its end
            elif done % 2:
                stop = _after_files(root, int(draw.integers(1, 2 * files)))
            else:
                end = time.monotonic() + float(draw.uniform(0.0, seconds))
                stop = lambda end=end: time.monotonic() > end  # noqa: E731
            code = _run(file, root, stop)
            now = {path: path.read_bytes() for run in root.glob("*/seed*/run.json") for path in run.parent.iterdir()}
            lost += sum(now.get(path) != data for path, data in kept.items())
            kept = now
            done += code == -signal.SIGKILL
        different += code != 0 or _results(root) != wanted
        compared += 1
    return Killed(done, lost, compared, different)


def _run(file: Path, root: Path, stop: Callable[[], bool]) -> int:
    """Run the study until it ends, or until ``stop`` is true or it took far too long; return its exit code."""
    log = root.with_suffix(".log")
    with log.open("w", encoding="utf-8") as errors:
        command = [*_COMMAND, str(file), "--out", str(root)]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors, start_new_session=True)
        begin = time.monotonic()
        while process.poll() is None and not stop():
            if time.monotonic() - begin > _PATIENCE:
                process.terminate()
                break
            time.sleep(_POLL)
        else:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)  # its workers too
        code = process.wait()
    if code not in (0, -signal.SIGKILL):
        _LOG.warning("%s failed: %s", root, log.read_text(encoding="utf-8")[-2000:])
    return code


def _after_files(root: Path, count: int) -> Callable[[], bool]:
    """Wait until that many files were seen to appear, also those that vanish again."""
    before, seen = _files(root), set[Path]()

    def stop() -> bool:
        seen.update(_files(root) - before)
        return len(seen) >= count

    return stop


def _files(root: Path) -> set[Path]:
    return {Path(path, name) for path, _, names in os.walk(root) for name in names}


def _results(root: Path) -> dict[str, list[str]]:
    """Return the lines of the study's tables without the times that its steps took."""
    scores = (root / "results.csv").read_text(encoding="utf-8").splitlines()
    table = (root / "table.md").read_text(encoding="utf-8").split("**Milliseconds of a step")
    without = table[0].splitlines() + table[1].split("**Against", 1)[-1].splitlines()
    return {"results.csv": [line.rpartition(",")[0] for line in scores], "table.md": without}
