"""The smallest study for tests of ablations: the simulator's points, near goals, tiny networks."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from fuzzing.killed_studies import STUDY as STUDY

from shape_obs.ablation.executors import Outcome, Task, work
from shape_obs.ablation.scores import read_scores


def numbers(root: Path) -> dict[str, list[tuple]]:
    """Return all scores of the finished runs of a study by run, without times."""
    return {
        f"{path.parts[-3]}/{path.parts[-2]}": [
            (row.steps, row.disturbance, *row.score._replace(ms=0.0))
            for row in read_scores(path.with_name("scores.csv"))
        ]
        for path in sorted(root.glob("*/seed*/run.json"))
    }


def here(tasks: Sequence[Task], poll: Callable[[], object]) -> Iterator[Outcome]:
    """Execute one run after the other in this process."""
    return map(work, tasks)


@contextmanager
def killing(run: Path) -> Iterator[list[int]]:
    """Kill the process of a run once, in its first step; yield a list that receives its id."""
    killed: list[int] = []
    over = threading.Event()

    def watch() -> None:
        while not over.is_set() and not killed:
            worker = worker_of(run)
            if worker is not None:
                os.kill(worker, signal.SIGKILL)
                killed.append(worker)
            time.sleep(0.005)

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield killed
    finally:
        over.set()
        thread.join()


def worker_of(run: Path) -> int | None:
    """Return the id of the process that does a run; None until it is known."""
    try:
        return int(json.loads((run / "progress.json").read_text())["pid"])
    except (OSError, ValueError):
        return None
