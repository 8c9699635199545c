"""A run as a task that any process can do: it is given a study, and gives back what belongs into the run's folder."""

from __future__ import annotations

import json
import os
import platform
import tempfile
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any, Final

from shape_obs.ablation.run import Trained, run
from shape_obs.ablation.score import success
from shape_obs.ablation.scores_file import SCORES, scores_csv
from shape_obs.ablation.study import Study
from shape_obs.utils.threads import one_thread

PROGRESS: Final = "progress.json"
POLICY: Final = "trained.policy"
_PACKAGES: Final = ("shape-obs", "stable-baselines3", "torch", "gymnasium", "mujoco", "numpy")


@dataclass(frozen=True)
class Task:
    """One run.

    Attributes:
        study: What is compared.
        arm: Name of one of its arms.
        seed: Of the training.
        folder: Of the run; where it can be seen, the steps done are told there.
    """

    study: Study
    arm: str
    seed: int
    folder: Path

    @property
    def name(self) -> str:
        """``"points3d/seed0"``."""
        return f"{self.arm}/seed{self.seed}"


@dataclass(frozen=True)
class Outcome:
    """What became of a run.

    Attributes:
        task: The run.
        files: Contents by name, for its folder; empty where it failed.
        about: What is told of it beside: times and versions.
        error: What was wrong; empty for nothing.
    """

    task: Task
    files: Mapping[str, bytes] = field(default_factory=dict)
    about: Mapping[str, Any] = field(default_factory=dict)
    error: str = ""


def work(task: Task) -> Outcome:
    """Do a run in this process, on one thread; whatever it raises is told in the outcome."""
    begin = time.perf_counter()
    try:
        with one_thread():
            trained = run(task.study, task.arm, task.seed, _teller(task))
            try:
                files = {SCORES: scores_csv(trained.rows).encode(), **_policy(trained, task)}
            finally:
                trained.env.close()
    except Exception:  # noqa: BLE001  a run that fails must not take the others along; its traceback is kept
        return Outcome(task, error=traceback.format_exc())
    about = {
        "ms_per_step": round(trained.ms_per_step, 3),
        "wall_s": round(time.perf_counter() - begin, 1),
        "machine": f"{platform.machine()} {platform.system()}",
        "versions": versions(),
    }
    return Outcome(task, files, about)


def versions() -> dict[str, str]:
    """Of what numbers may depend on."""
    return {"python": platform.python_version(), **{name: metadata.version(name) for name in _PACKAGES}}


def _teller(task: Task) -> Callable[[int], None]:
    """Tells the steps done, at most once a second, and ends the process when nobody is left to take the result."""
    parent, last = os.getppid(), 0.0

    def tell(steps: int) -> None:
        nonlocal last
        if os.getppid() != parent:
            os._exit(1)
        now = time.monotonic()
        if now - last > 1 and task.folder.is_dir():
            last = now
            (task.folder / PROGRESS).write_text(json.dumps({"steps": steps, "pid": os.getpid()}), encoding="ascii")

    return tell


def _policy(trained: Trained, task: Task) -> dict[str, bytes]:
    """The policy as a bundle."""
    from shape_obs.deploy.policy_bundle import save_bundle

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, POLICY)
        save_bundle(trained.model, trained.env, path, summary=_summary(trained, task))
        return {POLICY: path.read_bytes()}


def _summary(trained: Trained, task: Task) -> dict[str, Any]:
    """What the bundle tells of its training."""
    last = [row.score for row in trained.rows if not row.disturbance and row.steps == trained.model.num_timesteps]
    return {
        "arm": task.arm,
        "seed": task.seed,
        "steps": trained.model.num_timesteps,
        "success": {
            name: success([score for score in last if score.difficulty == name])
            for name in task.study.evaluation.difficulties
        },
        "made_with": task.study.made_with(task.arm),
    }
