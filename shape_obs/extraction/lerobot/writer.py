"""Write the files of a LeRobot dataset, version 3: rows and videos in chunks, and what describes them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.extraction.extraction import Extraction
from shape_obs.extraction.lerobot.statistics import Statistics, column_statistics, merge_statistics
from shape_obs.extraction.lerobot.videos import write_video
from shape_obs.extraction.task import Task
from shape_obs.recording import RobotInfo, ShapeTable
from shape_obs.recording.parquet import need_pyarrow
from shape_obs.spec import to_plain
from shape_obs.tracking.clock import LONGEST_PAUSE
from shape_obs.utils.files import write_text

Column = npt.NDArray[Any]

STATE: Final = "observation.state"
SHAPES: Final = "observation.environment_state"
ACTION: Final = "action"
REWARD: Final = "next.reward"
DONE: Final = "next.done"
TRUNCATED: Final = "next.truncated"
OK: Final = "shape.ok"
MEASURED: Final = "shape.measured"
#: Columns that are in every LeRobot dataset.
INDICES: Final[Mapping[str, str]] = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}

_VERSION: Final = "v3.0"
_CAMERA: Final = "observation.images.camera"
#: Largest number of files in a folder, and megabytes of a data file, as LeRobot chooses them.
_CHUNK: Final = 1000
_DATA_MB: Final = 100
_VIDEO_MB: Final = 200
_FILE: Final = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_DATA: Final = f"data/{_FILE}.parquet"
_VIDEO: Final = f"videos/{{video_key}}/{_FILE}.mp4"
_EPISODES: Final = "meta/episodes/chunk-000/file-000.parquet"


@dataclass(frozen=True, eq=False)
class Episode:
    """The rows of an episode.

    Attributes:
        columns: Arrays ``(T, D)``, or ``(T,)`` for single values, by the name of the LeRobot feature.
        names: Names of the values of each column.
        frames: ``(T,)`` indices of the frames in the recorded episode.
        gap: Seconds between frames; NaN if unknown.
        seconds: From the first frame to the last, by their stamps.
        steps: Number of frames after the first one whose stamps show the time since the last.
        left_out: Number of frames inside the episode that no step followed, as their successors were dropped.
        robot: Name of the robot; None if there is none.
    """

    columns: Mapping[str, Column]
    names: Mapping[str, tuple[str, ...]]
    frames: npt.NDArray[np.int64]
    gap: float
    seconds: float
    steps: int
    left_out: int
    robot: str | None

    def features(self) -> dict[str, dict[str, Any]]:
        """Return the entries of ``features`` in ``meta/info.json``, which all episodes of a dataset share."""
        return {
            name: {
                "dtype": str(column.dtype),
                "shape": list(column.shape[1:] or (1,)),
                "names": list(self.names[name]),
            }
            for name, column in self.columns.items()
        }


def read_episode(table: ShapeTable) -> Episode:
    """Return the rows of an extracted episode.

    With actions, a row is a frame that a step followed: the last frame of an episode has none and is left out. Where
    the robot was made to stand still, the action is one that keeps it there.

    Args:
        table: A part of the dataset that ``extract`` writes.

    Raises:
        ValueError: The episode has no features, or the state of the robot is missing in some frames.
    """
    metadata = table.metadata
    if not metadata.get("features"):
        raise ValueError("the shapes were extracted without features, which a LeRobot dataset is made of.")
    robot = metadata.get("robot") and RobotInfo.from_dict(metadata["robot"])
    stepped = ~np.isnan(table["reward"])
    rows = np.flatnonzero(stepped) if stepped.any() else np.arange(len(table))
    columns: dict[str, Column] = {}
    names: dict[str, tuple[str, ...]] = {}
    blocks = list(metadata["features"])
    values = {block: table[block].reshape(len(table), -1) for block in blocks}
    columns[SHAPES] = np.concatenate(list(values.values()), axis=1)
    names[SHAPES] = tuple(
        name for block in blocks for name in _names(block, values[block].shape[1], metadata["shapes"])
    )
    columns[STATE], names[STATE] = _with_robot(columns[SHAPES], names[SHAPES], table["state"], robot)
    if stepped.any():
        columns[ACTION] = _actions(table, robot)
        names[ACTION] = robot.action if robot else _numbered("action", columns[ACTION].shape[1])
        columns[REWARD], names[REWARD] = table["reward"].astype(np.float32), ("reward",)
        columns[DONE], names[DONE] = table["terminated"] | table["truncated"], ("done",)
        columns[TRUNCATED], names[TRUNCATED] = table["truncated"], ("truncated",)
    shapes = tuple(metadata["shapes"])
    columns[OK], names[OK] = np.stack([table[f"{name}/ok"] for name in shapes], axis=1), shapes
    columns[MEASURED] = np.concatenate([table[f"{block}/measured"] for block in blocks], axis=1)
    names[MEASURED] = names[SHAPES]
    gaps = np.diff(table["stamp"])
    gaps = gaps[(gaps > 0) & (gaps <= LONGEST_PAUSE)]  # others are of a clock that failed or was set
    return Episode(
        {name: _flat(column[rows]) for name, column in columns.items()},
        names,
        table["frame"][rows].astype(np.int64),
        float(np.median(gaps)) if len(gaps) else np.nan,
        float(gaps.sum()),
        len(gaps),
        int(rows[-1] - rows[0] + 1 - len(rows)),
        robot and robot.name,
    )


def _with_robot(
    shapes: Column, names: tuple[str, ...], state: Column, robot: RobotInfo | None
) -> tuple[Column, tuple[str, ...]]:
    """Return the shapes followed by the state of the robot, if it is known, as float32."""
    if state.shape[1] == 0:
        return shapes, names
    if not np.isfinite(state).all():
        raise ValueError("the state of the robot is missing, or not finite, in some frames.")
    labels = robot.state if robot else _numbered("state", state.shape[1])
    whole = np.concatenate([shapes, state.astype(np.float32)], axis=1)
    return whole, (*names, *(f"robot/{label}" for label in labels))


def _actions(table: ShapeTable, robot: RobotInfo | None) -> Column:
    """Return the actions ``(F, A)`` float32; where none was sent, those that keep the robot where it is."""
    actions = table["action"].copy()
    still = np.isnan(actions).all(axis=1) & ~np.isnan(table["reward"])
    if still.any():
        spec = robot and robot.action_spec
        if not spec or not actions.shape[1]:
            raise ValueError("no action was sent in some steps, and the recording has no action_spec of the robot.")
        position = table["state"][still, : len(spec)]
        actions[still] = spec.leading(position, position, 1.0) / spec.scale
    return actions.astype(np.float32)


def _names(block: str, size: int, shapes: Mapping[str, int]) -> tuple[str, ...]:
    """Return the names of the values of a feature, such as ``rope/points3d/0/x``."""
    shape, _, kind = block.partition("/features/")
    points = shapes[shape]
    axes = {2: "uv", 3: "xyz"}.get(size // points)
    if kind.startswith("points") and axes and size == points * len(axes):
        return tuple(f"{shape}/{kind}/{i}/{axis}" for i in range(points) for axis in axes)
    return _numbered(f"{shape}/{kind}", size)


def _numbered(name: str, size: int) -> tuple[str, ...]:
    return (name,) if size == 1 else tuple(f"{name}/{i}" for i in range(size))


def _flat(column: Column) -> Column:
    """Return ``(T,)`` for single values, as LeRobot stores them, with NumPy's names of types."""
    return column[:, 0] if column.ndim == 2 and column.shape[1] == 1 else column


@dataclass(frozen=True)
class LeRobotSummary:
    """What was written.

    Args:
        episodes: Number of episodes.
        frames: Number of rows.
        fps: Frames per second.
        features: Shape of each feature, by name.
        task: What is done in them, in words.
    """

    episodes: int
    frames: int
    fps: float
    features: Mapping[str, tuple[int, ...]]
    task: str


class LeRobotWriter:
    """Write the files of a new dataset, one episode after the other.

    Args:
        folder: The folder, which does not exist yet.
        features: Entries of ``features`` in ``meta/info.json``, without those of videos and indices.
        fps: Frames per second.

    Raises:
        ImportError: The extra ``parquet`` is missing.
    """

    def __init__(self, folder: Path, features: Mapping[str, Any], fps: float) -> None:
        self._folder, self._features, self._fps = folder, dict(features), fps
        self._arrow, self._parquet = need_pyarrow()
        self._file: Any = None
        self._number, self._bytes, self._rows = -1, 0, 0
        self._episodes: list[dict[str, Any]] = []
        self._statistics: list[dict[str, Statistics]] = []

    def add(self, episode: Episode, task: str, recorded: tuple[Extraction, Task] | None) -> None:
        """Write the rows of an episode and, if its recording is given, its video.

        Args:
            episode: The rows.
            task: What is done in it, in words.
            recorded: The extraction and its task; None for no video.

        Raises:
            ValueError: The images have another size than those of the episodes before.
            OSError: A file cannot be read or written.
        """
        number, count = len(self._episodes), len(episode.frames)
        indices = {
            "timestamp": np.arange(count) / self._fps,
            "frame_index": np.arange(count),
            "episode_index": np.full(count, number),
            "index": np.arange(self._rows, self._rows + count),
            "task_index": np.zeros(count),
        }
        columns = {**episode.columns, **{name: column.astype(INDICES[name]) for name, column in indices.items()}}
        table = self._arrow.table({name: self._array(column) for name, column in columns.items()})
        if self._file is None or self._bytes + table.nbytes > _DATA_MB * 2**20:
            self._file = self._next_file(table.schema)
        self._file.write_table(table)
        self._bytes += table.nbytes
        statistics = {name: column_statistics(column) for name, column in columns.items()}
        entry: dict[str, Any] = {
            "episode_index": number,
            "tasks": [task],
            "length": count,
            "data/chunk_index": self._number // _CHUNK,
            "data/file_index": self._number % _CHUNK,
            "dataset_from_index": self._rows,
            "dataset_to_index": self._rows + count,
        }
        if recorded is not None:
            place = {"chunk_index": number // _CHUNK, "file_index": number % _CHUNK}
            job, where = recorded
            path = self._folder / _VIDEO.format(video_key=_CAMERA, **place)
            video, statistics[_CAMERA] = write_video(path, job.open, where, episode.frames, self._fps)
            if self._features.setdefault(_CAMERA, video) != video:
                raise ValueError(f"{where.source}: its images have another size; a LeRobot dataset has only one.")
            place |= {"from_timestamp": 0.0, "to_timestamp": count / self._fps}
            entry |= {f"videos/{_CAMERA}/{name}": value for name, value in place.items()}
        self._rows += count
        self._episodes.append(entry)
        self._statistics.append(statistics)

    def close(self, task: str, robot: str | None) -> LeRobotSummary:
        """Write what describes the rows, and return a summary.

        Args:
            task: What is done in all episodes, in words.
            robot: Name of the robot; None if it is unknown.

        Raises:
            OSError: A file cannot be written.
        """
        self._file.close()
        features = {
            **self._features,
            **{name: {"dtype": dtype, "shape": [1], "names": None} for name, dtype in INDICES.items()},
        }
        self._write_episodes()
        self._write_tasks([task])
        self._write_json("meta/stats.json", self._merged())
        info = {
            "codebase_version": _VERSION,
            "robot_type": robot,
            "total_episodes": len(self._episodes),
            "total_frames": self._rows,
            "total_tasks": 1,
            "chunks_size": _CHUNK,
            "data_files_size_in_mb": _DATA_MB,
            "video_files_size_in_mb": _VIDEO_MB,
            "fps": self._fps,
            "splits": {"train": f"0:{len(self._episodes)}"},
            "data_path": _DATA,
            "video_path": _VIDEO if _CAMERA in features else None,
            "features": features,
        }
        self._write_json("meta/info.json", info)
        shapes = {name: tuple(feature["shape"]) for name, feature in self._features.items()}
        return LeRobotSummary(len(self._episodes), self._rows, self._fps, shapes, task)

    def _next_file(self, schema: Any) -> Any:
        if self._file is not None:
            self._file.close()
        self._number, self._bytes = self._number + 1, 0
        path = self._folder / _DATA.format(chunk_index=self._number // _CHUNK, file_index=self._number % _CHUNK)
        path.parent.mkdir(parents=True, exist_ok=True)
        return self._parquet.ParquetWriter(path, schema)

    def _array(self, column: Any) -> Any:
        flat = self._arrow.array(np.ascontiguousarray(column).ravel())
        return flat if column.ndim == 1 else self._arrow.FixedSizeListArray.from_arrays(flat, column.shape[1])

    def _merged(self) -> dict[str, Statistics]:
        return {name: merge_statistics([each[name] for each in self._statistics]) for name in self._statistics[0]}

    def _write_episodes(self) -> None:
        rows = [
            {
                **entry,
                **{
                    f"stats/{name}/{kind}": values.tolist()
                    for name, found in statistics.items()
                    for kind, values in found.items()
                },
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
            }
            for entry, statistics in zip(self._episodes, self._statistics, strict=True)
        ]
        path = self._folder / _EPISODES
        path.parent.mkdir(parents=True, exist_ok=True)
        self._parquet.write_table(self._arrow.Table.from_pylist(rows), path)

    def _write_tasks(self, tasks: Sequence[str]) -> None:
        """Write the tasks as pandas stores a table with the tasks as its index, which LeRobot reads."""
        index = "__index_level_0__"
        columns = [("task_index", "task_index", "int64", "int64"), (None, index, "unicode", "object")]
        described = {
            "index_columns": [index],
            "column_indexes": [],
            "columns": [
                {"name": name, "field_name": field, "pandas_type": kind, "numpy_type": dtype, "metadata": None}
                for name, field, kind, dtype in columns
            ],
            "pandas_version": "2.0.0",
        }
        table = self._arrow.table({"task_index": np.arange(len(tasks)), index: list(tasks)})
        self._parquet.write_table(
            table.replace_schema_metadata({"pandas": json.dumps(described)}), self._folder / "meta/tasks.parquet"
        )

    def _write_json(self, name: str, content: Any) -> None:
        write_text(self._folder / name, json.dumps(to_plain(content), indent=4) + "\n")
