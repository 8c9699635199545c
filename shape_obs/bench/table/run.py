"""What a run has measured so far, in files: an interrupted run goes on where it stopped.

The whole table: what is still to be measured, chunk by chunk, here or in several processes.
"""

from __future__ import annotations
import csv
import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final, TypeVar, cast
import numpy as np
import numpy.typing as npt
from shape_obs import __version__
from shape_obs.bench.interleaved_timing import Clock
from shape_obs.bench.table.frames import CONFIGURATIONS, OF, Name, Scene, Trace, Tracing, missing, scenes, traced
from shape_obs.bench.table.methods import METHODS, Method, Row, measured
from shape_obs.utils.documents import read_json
from shape_obs.utils.files import write_text
from shape_obs.utils.threads import one_thread

T = TypeVar("T")
EXACT: Final = 50  # frames of each configuration whose silhouette is taken of all pixels
_CHUNKS: Final = 20  # for each configuration, of 5 to 50 frames
_FORMAT: Final = 1  # of the files; another one cannot be gone on with
_PACKAGES: Final = ("numpy", "scipy", "scikit-learn", "opencv-python-headless", "numba", "mujoco")
_WARM: Final[set[tuple[str, str]]] = set()  # what has run once in this process: imports and caches are behind it


class Parts:
    """A folder with one small CSV file for each configuration, method and chunk of frames.

    Args:
        folder: Where; made if it is not there.
        settings: What all files of a run have in common. A folder that was begun with others is refused.

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
        """Whether a chunk is done."""
        return self._path(configuration, method, chunk).exists()

    def forget(self, configuration: str, method: str) -> None:
        """Throw away all that was measured of a method."""
        shutil.rmtree(self._path(configuration, method, 0).parent, ignore_errors=True)

    def write(self, configuration: str, method: str, chunk: int, rows: Iterable[Any]) -> None:
        """Write a chunk's rows, instances of a dataclass, whole or not at all."""
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


def as_csv(rows: list[dict[str, Any]]) -> str:
    """Rows of equal keys as CSV, the keys first; truth is 1 and 0."""
    lines = [",".join(rows[0])] if rows else []
    lines += [
        ",".join(str(int(value)) if isinstance(value, bool) else str(value) for value in row.values()) for row in rows
    ]
    return "\n".join(lines) + "\n"


def _parsed(text: str, annotation: Any) -> Any:
    """A value as its field is annotated: annotations are strings here."""
    return {"bool": lambda: text == "1", "int": lambda: int(text), "float": lambda: float(text)}[str(annotation)]()


@dataclass(frozen=True)
class Plan:
    """What to measure.

    Args:
        frames: Of each configuration.
        seed: Of all frames.
        renderer: The simulator's camera: ``"auto"``, ``"gl"`` or ``"rays"``.
        names: Configurations.
        methods: Clusterers.
        tracings: Thinning and contour tracing.
        clock: What counts the time.
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
        """Frames whose silhouette is taken of all pixels."""
        return np.linspace(0, self.frames - 1, min(EXACT, self.frames)).astype(int)

    def settings(self) -> dict[str, Any]:
        """What decides the figures, and may not change while a run goes on."""
        packages = {name: _version(name) for name in _PACKAGES}
        own = {"format": _FORMAT, "shape_obs": __version__}
        return {
            **own,
            "frames": self.frames,
            "seed": self.seed,
            "renderer": self.renderer,
            "clock": self.clock,
            **packages,
        }

    def of(self, name: Name) -> list[Method | Tracing]:
        """Everything that is measured on a configuration."""
        return [*self.methods, *(tracing for tracing in self.tracings if OF[tracing] == name and not missing(tracing))]


def run(plan: Plan, folder: Path, *, jobs: int = 1, redo: bool = False, tick: Callable[[int, int], Any]) -> Parts:
    """Measure what the folder does not hold yet.

    Args:
        plan: What to measure.
        folder: Where the results go.
        jobs: Processes.
        redo: Measure what the plan names anew.
        tick: Called with (chunks done, chunks in all), at the start too.

    Returns:
        All that the folder holds.

    Raises:
        ValueError: The folder holds a run with other settings.
    """
    parts = Parts(folder, plan.settings())
    if redo:
        for name in plan.names:
            for what in plan.of(name):
                parts.forget(name, what)
    open_ones = []
    for chunk in range(len(plan.chunks)):
        for name in plan.names:
            left = [what for what in plan.of(name) if not parts.has(name, what, chunk)]
            if left:
                open_ones.append((plan, folder, name, chunk, left))
    total = len(plan.chunks) * len(plan.names)
    done = total - len(open_ones)
    tick(done, total)
    for _ in _worked_off(open_ones, jobs):
        done += 1
        tick(done, total)
    return parts


def _worked_off(tasks: list[tuple[Any, ...]], jobs: int) -> Iterator[None]:
    if jobs == 1 or len(tasks) < 2:
        for task in tasks:
            yield _work(*task)
    else:
        from joblib import Parallel, delayed

        yield from Parallel(n_jobs=jobs, return_as="generator_unordered")(delayed(_work)(*task) for task in tasks)


def _work(plan: Plan, folder: Path, name: Name, chunk: int, left: list[Method | Tracing]) -> None:
    """One chunk of one configuration: the frames are made once, and every method sees all of them in turn."""
    import sklearn.cluster
    import sklearn.mixture  # noqa: F401  # what is loaded now can be held to one thread

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
    """Run once without being timed, the first time that a process does."""
    if (name, what) not in _WARM:
        _WARM.add((name, what))
        list(_rows(name, what, [first], plan))


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"
