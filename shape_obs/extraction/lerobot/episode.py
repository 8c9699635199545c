"""Turn an extracted episode into the rows of a LeRobot dataset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.recording import RobotInfo, ShapeTable

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


@dataclass(frozen=True, eq=False)
class Episode:
    """The rows of an episode.

    Attributes:
        columns: Arrays ``(T, D)``, or ``(T,)`` for single values, by the name of the LeRobot feature.
        names: Names of the values of each column.
        frames: ``(T,)`` indices of the frames in the recorded episode.
        gap: Seconds between frames; NaN if unknown.
        left_out: Number of frames inside the episode that no step followed, as their successors were dropped.
        robot: Name of the robot; None if there is none.
    """

    columns: Mapping[str, Column]
    names: Mapping[str, tuple[str, ...]]
    frames: npt.NDArray[np.int64]
    gap: float
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
    return Episode(
        {name: _flat(column[rows]) for name, column in columns.items()},
        names,
        table["frame"][rows].astype(np.int64),
        float(np.median(gaps)) if len(gaps) else np.nan,
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
