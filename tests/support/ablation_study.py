"""The smallest study for tests of ablations: the simulator's points, near goals, tiny networks."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from shape_obs.ablation.executors import Outcome, Task, work
from shape_obs.ablation.scores import read_scores

#: As small as a study can be: the simulator's points, near goals, tiny networks. It takes about twenty seconds.
STUDY: Final[Mapping[str, Any]] = {
    "version": 1,
    "episode": 10,
    "difficulties": ["near"],
    "seeds": [0, 1],
    "steps": 60,
    "hyperparameters": {"batch_size": 8, "learning_starts": 20, "buffer_size": 100},
    "her": {},
    "normalize": {},
    "evaluation": {"every": 30, "goals": 1, "final_goals": 2, "difficulties": ["near", "middle"]},
    "arms": {
        "small": {"observation": "truth", "hyperparameters": {"net_arch": [8]}},
        "smaller": {"observation": "truth", "hyperparameters": {"net_arch": [4]}},
    },
}


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
