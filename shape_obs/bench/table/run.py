"""Measure the whole table chunk by chunk, here or in several processes; an interrupted run continues."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numpy as np
import numpy.typing as npt

from shape_obs import __version__
from shape_obs.bench import Clock, run_tasks
from shape_obs.bench.interleaved_timing import package_version
from shape_obs.bench.table.frames import CONFIGURATIONS, OF, Name, Scene, Trace, Tracing, missing, scenes, traced
from shape_obs.bench.table.methods import METHODS, Method, Row, measured
from shape_obs.bench.tables import as_csv
from shape_obs.utils.documents import read_json
from shape_obs.utils.files import write_text
from shape_obs.utils.threads import one_thread

T = TypeVar("T")
EXACT: Final = 50  # frames of each configuration whose silhouette counts all pixels
_CHUNKS: Final = 20  # for each configuration, of 5 to 50 frames
_FORMAT: Final = 1  # of the files; runs with another format cannot be continued
_PACKAGES: Final = ("numpy", "scipy", "scikit-learn", "opencv-python-headless", "numba", "mujoco")
_WARM: Final[set[tuple[str, str]]] = set()  # what this process has run once, imports and compilation included


class Parts:
    """A folder with one small CSV file for each configuration, method and chunk of frames.

    Args:
        folder: The folder; it is made if necessary.
        settings: The settings of the run. A folder with other settings is refused.

    Raises:
        ValueError: The folder holds a run with other settings.
    """

    def __init__(self, folder: Path, settings: Mapping[str, Any]) -> None:
        self._folder, note = folder / "parts", folder / "settings.json"
        if note.exists():
            before = read_json(note, "settings")
            if not isinstance(before, dict):
                raise ValueError(
                    f"{note}: expected the settings of a run, got {type(before).__name__}: remove {folder}."
                )
            for name in [*settings, *before]:
                old, new = before.get(name), settings.get(name)
                if old != new:
                    raise ValueError(
                        f"{folder} holds a run with {name} = {old}, this one has {new}: choose another folder, or "
                        "remove that one."
                    )
        self._folder.mkdir(parents=True, exist_ok=True)
        write_text(note, json.dumps(dict(settings), indent=2) + "\n")

    def has(self, configuration: str, method: str, chunk: int) -> bool:
        """Return whether a chunk is done."""
        return self._path(configuration, method, chunk).exists()

    def forget(self, configuration: str, method: str) -> None:
        """Delete all results of a method."""
        shutil.rmtree(self._path(configuration, method, 0).parent, ignore_errors=True)

    def write(self, configuration: str, method: str, chunk: int, rows: Iterable[Any]) -> None:
        """Write a chunk's rows, instances of a dataclass, atomically."""
        path = self._path(configuration, method, chunk)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, as_csv([asdict(row) for row in rows]))

    def read(self, configuration: str, method: str, chunk: int, kind: type[T]) -> list[T]:
        """Return the rows of a chunk that is done.

        Raises:
            ValueError: Its file is damaged.
        """
        types, path = (
            {field.name: field.type for field in fields(cast(Any, kind))},
            self._path(configuration, method, chunk),
        )
        try:
            with path.open(newline="", encoding="utf-8") as file:
                return [
                    kind(**{name: _parsed(text, types[name]) for name, text in row.items()})
                    for row in csv.DictReader(file)
                ]
        except (KeyError, TypeError, ValueError, csv.Error) as error:
            raise ValueError(
                f"{path}: not the rows of a chunk ({error!r}): remove it to measure them again."
            ) from error

    def _path(self, configuration: str, method: str, chunk: int) -> Path:
        return self._folder / configuration / method / f"{chunk:04d}.csv"


def _parsed(text: str, annotation: Any) -> Any:
    """Return a value of the field's type; annotations are strings here."""
    return {"bool": lambda: text == "1", "int": lambda: int(text), "float": lambda: float(text)}[str(annotation)]()


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
        own = {"format": _FORMAT, "shape_obs": __version__}
        return {
            **own,
            "frames": self.frames,
            "seed": self.seed,
            "renderer": self.renderer,
            "clock": self.clock,
            **{name: package_version(name) or "none" for name in _PACKAGES},
        }

    def of(self, name: Name) -> list[Method | Tracing]:
        """Return the methods and tracings of a configuration."""
        return [*self.methods, *(tracing for tracing in self.tracings if OF[tracing] == name and not missing(tracing))]


def run(plan: Plan, folder: Path, *, jobs: int = 1, redo: bool = False, tick: Callable[[int, int], Any]) -> Parts:
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
    if redo:
        for name in plan.names:
            for what in plan.of(name):
                parts.forget(name, what)
    tasks = []
    for chunk in range(len(plan.chunks)):
        for name in plan.names:
            left = [what for what in plan.of(name) if not parts.has(name, what, chunk)]
            if left:
                tasks.append((plan, folder, name, chunk, left))
    total = len(plan.chunks) * len(plan.names)
    done = total - len(tasks)
    tick(done, total)
    for _ in run_tasks(_work, tasks, jobs if len(tasks) > 1 else 1):
        done += 1
        tick(done, total)
    return parts


def _work(plan: Plan, folder: Path, name: Name, chunk: int, left: list[Method | Tracing]) -> None:
    """Measure one chunk of one configuration: the frames are drawn once, and the methods run on them in turn."""
    import sklearn.cluster
    import sklearn.mixture  # noqa: F401  # loaded before the threads are limited

    parts, numbers = Parts(folder, plan.settings()), plan.chunks[chunk]
    with one_thread():
        made = list(zip(numbers, scenes(name, chunk, len(numbers), plan.seed, plan.renderer), strict=True))
        for what in left:
            _warm_up(name, what, made[0], plan)
            parts.write(name, what, chunk, _rows(name, what, made, plan))


def _rows(name: Name, what: Any, chunk: list[tuple[int, Scene]], plan: Plan) -> Iterator[Row] | Iterator[Trace]:
    if what in METHODS:
        return measured(name, what, chunk, plan.exact, plan.clock)
    return traced(what, chunk, plan.clock)


def _warm_up(name: Name, what: Method | Tracing, first: tuple[int, Scene], plan: Plan) -> None:
    """Run once without timing, the first time in a process."""
    if (name, what) not in _WARM:
        _WARM.add((name, what))
        list(_rows(name, what, [first], plan))
