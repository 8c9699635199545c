"""Measure the whole table chunk by chunk, here or in several processes; an interrupted run continues."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs import __version__
from shape_obs.utils.threads import one_thread
from tests.benchmarks import Clock, run_tasks
from tests.benchmarks.interleaved_timing import package_version
from tests.benchmarks.table.frames import CONFIGURATIONS, OF, Name, Scene, Tracing, missing, scenes, traced
from tests.benchmarks.table.methods import METHODS, Method, measured
from tests.benchmarks.tables import Parts, Row

EXACT: Final = 50  # frames of each configuration whose silhouette counts all pixels
_CHUNKS: Final = 20  # for each configuration, of 5 to 50 frames
_PACKAGES: Final = ("numpy", "scipy", "scikit-learn", "opencv-python-headless", "numba", "mujoco")
_WARM: Final[set[tuple[str, str]]] = set()  # what this process has run once, imports and compilation included


@dataclass(frozen=True)
class Plan:
    """The frames, configurations and methods to measure.

    Args:
        frames: Number of frames of each configuration.
        seed: Seed of all frames.
        renderer: The simulator's renderer: ``"auto"``, ``"gl"`` or ``"rays"``.
        names: Configurations.
        methods: Clusterers.
        tracings: Thinning and contour tracing.
        clock: The clock.
    """

    frames: int
    seed: int = 0
    renderer: str = "auto"
    names: tuple[Name, ...] = tuple(CONFIGURATIONS)
    methods: tuple[Method, ...] = tuple(METHODS)
    tracings: tuple[Tracing, ...] = tuple(OF)
    clock: Clock = "wall"

    @property
    def chunks(self) -> list[range]:
        """The frames of each chunk."""
        length = int(np.clip(self.frames // _CHUNKS, 5, 50))
        return [range(first, min(first + length, self.frames)) for first in range(0, self.frames, length)]

    @property
    def exact(self) -> npt.NDArray[np.int_]:
        """The frames whose silhouette counts all pixels."""
        return np.linspace(0, self.frames - 1, min(EXACT, self.frames)).astype(int)

    def settings(self) -> dict[str, Any]:
        """Return everything that determines the figures and may not change when a run continues."""
        own = {
            "shape_obs": __version__,
            **{name: getattr(self, name) for name in ("frames", "seed", "renderer", "clock")},
        }
        return own | {name: package_version(name) or "none" for name in _PACKAGES}

    def of(self, name: Name) -> list[Method | Tracing]:
        """Return the methods and tracings of a configuration."""
        return [*self.methods, *(tracing for tracing in self.tracings if OF[tracing] == name and not missing(tracing))]


Chunks = list[list[Row]]
Done = dict[tuple[str, str], Chunks]  # configuration and method -> the rows of each chunk


def done(plan: Plan, folder: Path) -> Done:
    """Return what a folder holds of every configuration and method; chunks that are not done are left out.

    Raises:
        ValueError: The folder holds a run with other settings.
    """
    parts, whole = Parts(folder, plan.settings()), Plan(plan.frames, plan.seed, plan.renderer, clock=plan.clock)
    kept = {
        (name, what): [parts.read(_part(name, what, chunk)) for chunk in range(len(plan.chunks))]
        for name in whole.names
        for what in whole.of(name)
    }
    return {key: [rows for rows in chunks if rows is not None] for key, chunks in kept.items()}


def run(plan: Plan, folder: Path, *, jobs: int = 1, redo: bool = False, tick: Callable[[int, int], Any]) -> Done:
    """Measure everything that the folder does not hold yet.

    Args:
        plan: What to measure.
        folder: The folder of the results.
        jobs: Number of processes.
        redo: Measure what the plan names again.
        tick: Called with the number of finished chunks and of all chunks, also at the start.

    Returns:
        All results in the folder.

    Raises:
        ValueError: The folder holds a run with other settings.
    """
    parts = Parts(folder, plan.settings())
    done(plan, folder)
    everything = list(product(range(len(plan.chunks)), plan.names))
    if redo:
        for chunk, name in everything:
            for what in plan.of(name):
                parts.path(_part(name, what, chunk)).unlink(missing_ok=True)
    tasks = []
    for chunk, name in everything:
        left = [what for what in plan.of(name) if not parts.path(_part(name, what, chunk)).exists()]
        if left:
            tasks.append((plan, folder, name, chunk, left))
    finished = len(everything) - len(tasks)
    tick(finished, len(everything))
    for _ in run_tasks(_work, tasks, jobs if len(tasks) > 1 else 1):
        finished += 1
        tick(finished, len(everything))
    return done(plan, folder)


def _part(name: Name, what: Method | Tracing, chunk: int) -> str:
    return f"{name}/{what}/{chunk:04d}"


def _work(plan: Plan, folder: Path, name: Name, chunk: int, left: list[Method | Tracing]) -> None:
    """Measure one chunk of one configuration: the frames are drawn once, and the methods run on them in turn."""
    import sklearn.cluster
    import sklearn.mixture  # noqa: F401  # loaded before the threads are limited

    parts, numbers = Parts(folder, plan.settings()), plan.chunks[chunk]
    with one_thread():
        made = list(zip(numbers, scenes(name, chunk, len(numbers), plan.seed, plan.renderer), strict=True))
        for what in left:
            if (name, what) not in _WARM:
                _WARM.add((name, what))
                list(_rows(name, what, made[:1], plan))
            parts.write(_part(name, what, chunk), _rows(name, what, made, plan))


def _rows(name: Name, what: Any, chunk: list[tuple[int, Scene]], plan: Plan) -> Iterator[Row]:
    if what in METHODS:
        return measured(name, what, chunk, plan.exact, plan.clock)
    return traced(what, chunk, plan.clock)
