"""Store the shapes of many frames as columns, in CSV, NPZ or Parquet."""

from __future__ import annotations

import csv
import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.recording.format import Transition
from shape_obs.recording.parquet import need_pyarrow, read_parquet, write_parquet
from shape_obs.utils.arrays import decode_npz
from shape_obs.utils.documents import parse_json, read_json
from shape_obs.utils.errors import did_you_mean
from shape_obs.utils.files import make_folder, write_text, write_whole

Column = npt.NDArray[Any]

#: Columns of vectors, whose width differs between robots; their names are in the metadata under ``robot``.
VECTORS: Final = ("action", "state", "policy")
#: Columns that tables of recordings without a robot do not have.
STEP_COLUMNS: Final = ("step", "action", "reward", "terminated", "truncated", "state")

_METADATA: Final = "metadata"
_CHECKSUM: Final = "checksum"
_ALGORITHM: Final = "sha256:"
_AXES: Final = {"points2d": "uv", "points3d": "xyz"}
_PER_POINT: Final = ("visible", "valid", "sigma")
#: Columns that tables of earlier versions do not have.
_LATER: Final = ("warning", "track_id", "new", "length", "sigma")
_TYPES: Final[Mapping[str, type[Any]]] = {
    "frame": np.int64,
    "number": np.int64,
    "episode": np.int64,
    "ok": np.bool_,
    "visible": np.bool_,
    "valid": np.bool_,
    "new": np.bool_,
    "terminated": np.bool_,
    "truncated": np.bool_,
    "step": np.int64,
    "track_id": np.int64,
    "sigma": np.float32,
    "reason": np.str_,
    "warning": np.str_,
    "source": np.str_,
    "points2d": np.float32,
    "points3d": np.float32,
}


def step_columns(
    episodes: Sequence[int],
    transitions: Sequence[Transition | None],
    states: Sequence[tuple[float, ...] | None],
) -> dict[str, Column]:
    """Return the columns ``step``, ``action``, ``reward``, ``terminated``, ``truncated`` and ``state``.

    A recording keeps with each frame the step that led to it. A row of a table holds the step that followed its frame,
    as datasets for learning do: the action that was chosen for the frame, and what came of it. The last frame of an
    episode, and a frame whose successor is missing, have none.

    Args:
        episodes: Number of the episode of each of the F frames, in their order.
        transitions: The step that led to each frame.
        states: The state in each frame.

    Returns:
        ``step`` ``(F,)`` int64, -1 if unknown; ``action`` ``(F, A)`` and ``state`` ``(F, S)``, NaN where there is none;
        ``reward`` ``(F,)``, NaN if no step followed; ``terminated`` and ``truncated`` ``(F,)`` bool. A and S are 0 if
        no frame has an action or a state.

    Raises:
        ValueError: The number of values of actions or states changes.
    """
    count = len(episodes)
    columns: dict[str, Column] = {
        "step": np.array([-1 if each is None else each.step for each in transitions], np.int64),
        "action": np.full((count, _width("action", [each and each.action for each in transitions])), np.nan),
        "reward": np.full(count, np.nan),
        "terminated": np.zeros(count, np.bool_),
        "truncated": np.zeros(count, np.bool_),
        "state": np.full((count, _width("state", states)), np.nan),
    }
    for i, state in enumerate(states):
        if state is not None:
            columns["state"][i] = state
    for i in range(count - 1):
        now, then = transitions[i], transitions[i + 1]
        if now is None or then is None or episodes[i] != episodes[i + 1]:
            continue
        if then.step != now.step + 1:
            continue  # a frame between the two was dropped
        columns["reward"][i] = np.nan if then.reward is None else then.reward
        columns["terminated"][i], columns["truncated"][i] = then.terminated, then.truncated
        if then.action is not None:
            columns["action"][i] = then.action
    return columns


def absent(columns: Mapping[str, Column]) -> dict[str, npt.NDArray[np.bool_]]:
    """Return for each column of ``step_columns`` in a table which rows ``(F,)`` hold nothing."""
    if "step" not in columns:
        return {}
    unknown = np.isnan(columns["reward"])
    empty = {name: np.asarray(np.isnan(columns[name]).all(axis=1)) for name in VECTORS if name in columns}
    return {"step": columns["step"] < 0, **dict.fromkeys(("reward", "terminated", "truncated"), unknown), **empty}


def _width(name: str, vectors: Sequence[tuple[float, ...] | None]) -> int:
    widths = {len(vector) for vector in vectors if vector is not None}
    if len(widths) > 1:
        raise ValueError(f"{name}: expected equally many values in every frame, got {sorted(widths)}.")
    return max(widths, default=0)


@dataclass(frozen=True, eq=False)
class ShapeTable:
    """A table of shapes with one row per frame; ``table["rope/points2d"]`` is a column.

    Args:
        columns: Arrays of equal length F. ``frame`` counts from 0; ``number`` is the frame number of the source (-1 for
            none); ``episode``; ``stamp`` and ``received`` in seconds (NaN if unknown); ``warning`` about the stamp. For
            each shape: ``<name>/ok`` ``(F,)`` bool, ``<name>/age`` ``(F,)`` in seconds, ``<name>/quality`` ``(F,)``
            from 0 to 1, ``<name>/reason`` ``(F,)`` str, ``<name>/track_id`` ``(F,)`` int, ``<name>/new`` ``(F,)`` bool,
            ``<name>/length`` ``(F,)`` in metres (NaN if unknown), ``<name>/sigma`` ``(F, N)`` float32 in metres, or
            pixels without depth, ``<name>/points2d`` ``(F, N, 2)`` float32 in pixels, ``<name>/points3d``
            ``(F, N, 3)`` float32 in metres in the camera frame (only with depth), ``<name>/visible`` and
            ``<name>/valid`` ``(F, N)`` bool. Points are NaN where ``ok`` is False. Tables of earlier versions have no
            ``warning``, ``track_id``, ``new``, ``length`` and ``sigma``. If the recording has a robot or environment:
            ``step`` ``(F,)`` int, the number of steps since the episode began; of the step that followed the frame
            ``action`` ``(F, A)``, ``reward`` ``(F,)``, ``terminated`` and ``truncated`` ``(F,)`` bool, NaN and False
            where none did; and ``state`` ``(F, S)`` of the robot. Of a replay with a trained policy: ``policy``
            ``(F, A)``, its action for the frame.
        metadata: JSON values that describe how the table was made.
    """

    columns: Mapping[str, Column]
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Column:
        if name not in self.columns:
            hint = ""
            if name in STEP_COLUMNS:
                hint = " Only recordings of a robot or an environment have it, and none of earlier versions."
            elif name.rpartition("/")[2] in _LATER:
                hint = " Tables of earlier versions do not have it: replay the recording again."
            raise KeyError(f"no column {name!r}{did_you_mean(name, self.columns)}{hint}")
        return self.columns[name]

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def save(self, path: str | Path) -> None:
        """Write the table, completely or not at all.

        Args:
            path: File with the suffix ``.npz``; ``.parquet``, with points as flat lists (``.reshape(-1, N, 2)``), null
                where no step followed, and the metadata in the schema under the key ``shape_obs``; or ``.csv``, with
                the metadata in a second file, ``.csv.meta.json``.

        Raises:
            ValueError: The suffix is another one.
            ImportError: The suffix is ``.parquet``, and the extra ``parquet`` is missing.
            OSError: The file cannot be written.
        """
        path = Path(path)
        check_table_path(path)
        write_whole(path, lambda temporary: _FORMATS[path.suffix][0](temporary, self))
        if path.suffix == ".csv":
            _save_metadata(path, self.metadata)

    @classmethod
    def load(cls, path: str | Path) -> ShapeTable:
        """Read a table that ``save`` wrote.

        Checksums are verified: SHA-256 of the whole file for Parquet, and of the file with its metadata for CSV; CRC-32
        of each column for NPZ. Files of other programs and of early versions have none and are read as they are.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: The file is damaged, or not a table of shapes.
            ImportError: The suffix is ``.parquet``, and the extra ``parquet`` is missing.
        """
        path = Path(path)
        if not path.exists():
            raise FileNotFoundError(f"{path}: no such file.")
        check_table_path(path)
        try:
            table = _FORMATS[path.suffix][1](path)
            if "frame" not in table.columns:
                raise ValueError("it has no column 'frame'")
        except (KeyError, ValueError, IndexError, TypeError, OverflowError, csv.Error) as error:
            raise ValueError(f"{path}: not a table of shapes, or a damaged one: {error}") from error
        return table


def check_table_path(path: Path) -> None:
    """Check that a table can be written to a path, before hours of work.

    Raises:
        ValueError: The suffix is not ``.csv``, ``.npz`` or ``.parquet``.
        ImportError: The suffix is ``.parquet``, and the extra ``parquet`` is missing.
        OSError: The folder cannot be made.
    """
    if path.suffix not in _FORMATS:
        raise ValueError(f"{path}: expected a file named {', '.join('*' + suffix for suffix in _FORMATS)}.")
    if path.suffix == ".parquet":
        need_pyarrow()
    make_folder(path.parent)


# ---- NPZ


def _save_npz(path: Path, table: ShapeTable) -> None:
    with path.open("wb") as file:
        columns: dict[str, Any] = {_METADATA: np.array(json.dumps(table.metadata)), **table.columns}
        np.savez_compressed(file, **columns)


def _load_npz(path: Path) -> ShapeTable:
    columns = decode_npz(path.read_bytes(), "content")
    return ShapeTable(columns, parse_json(str(columns.pop(_METADATA)), _METADATA))


# ---- Parquet


def _save_parquet(path: Path, table: ShapeTable) -> None:
    write_parquet(path, table.columns, table.metadata, absent(table.columns))


def _load_parquet(path: Path) -> ShapeTable:
    columns, metadata = read_parquet(path)
    for name, column in columns.items():
        kind = name.split("/")[-1]
        if column.ndim == 1:
            columns[name] = column.astype(_TYPES.get(kind, np.float64))
        elif kind in _AXES:
            columns[name] = column.reshape(len(column), -1, len(_AXES[kind]))
    return ShapeTable(columns, metadata)


# ---- CSV


def _save_csv(path: Path, table: ShapeTable) -> None:
    heads: list[str] = []
    values: list[list[Any]] = []
    for name, column in table.columns.items():
        axes = _AXES.get(name.split("/")[-1])
        for index in np.ndindex(*column.shape[1:]):
            suffix = [str(i) for i in index]
            if axes:
                suffix[-1] = axes[index[-1]]
            heads.append("/".join([name, *suffix]))
            part = column[(slice(None), *index)]
            # str() of a float32 is the shortest text that restores it; tolist() would convert it to float64.
            values.append([str(value) for value in part] if part.dtype.kind == "f" else part.tolist())
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(heads)
        writer.writerows(zip(*values, strict=True))


def _load_csv(path: Path) -> ShapeTable:
    metadata = _checked_metadata(path)
    with path.open(newline="", encoding="utf-8") as file:
        heads, *rows = csv.reader(file)
    parts: dict[str, list[list[str]]] = {}
    for i, head in enumerate(heads):
        name = re.sub(r"/\d+(/[uvxyz])?$", "", head)
        parts.setdefault(name, []).append([row[i] for row in rows])
    columns = {}
    for name, texts in parts.items():
        kind = name.split("/")[-1]
        wanted = _TYPES.get(kind, np.float64)
        column = np.array(texts).T == "True" if wanted is np.bool_ else np.array(texts).T.astype(wanted)
        if kind in _AXES:
            column = column.reshape(len(rows), -1, len(_AXES[kind]))
        columns[name] = column if kind in (*_AXES, *_PER_POINT) or name in VECTORS else column[:, 0]
    return ShapeTable(columns, metadata)


def _save_metadata(path: Path, metadata: Mapping[str, Any]) -> None:
    """Write the metadata of a CSV file into a second file, with a checksum of both."""
    content = {**metadata, _CHECKSUM: _checksum(path, metadata)}
    write_text(_sidecar(path), json.dumps(content, indent=1) + "\n")


def _checked_metadata(path: Path) -> dict[str, Any]:
    """Return the metadata of a CSV file; empty if there are none, as for files of other programs."""
    sidecar = _sidecar(path)
    if not sidecar.exists():
        return {}
    metadata = read_json(sidecar, "metadata")
    if not isinstance(metadata, dict):
        raise ValueError(f"{sidecar}: expected a mapping, got {type(metadata).__name__}")
    # The key itself may be damaged. It was written last, and its value can be recognised.
    key = _CHECKSUM if _CHECKSUM in metadata else next(reversed(metadata), "")
    if key != _CHECKSUM and not str(metadata.get(key)).startswith(_ALGORITHM):
        return metadata
    recorded = metadata.pop(key)
    if key != _CHECKSUM or recorded != _checksum(path, metadata):
        raise ValueError(
            f"it differs from the checksum in {sidecar.name}, so one of the two is damaged; if you changed the table "
            f"on purpose, remove {_CHECKSUM!r} there"
        )
    return metadata


def _checksum(path: Path, metadata: Mapping[str, Any]) -> str:
    digest = hashlib.sha256(json.dumps(metadata, sort_keys=True).encode())
    digest.update(path.read_bytes())
    return _ALGORITHM + digest.hexdigest()


def _sidecar(path: Path) -> Path:
    return path.with_name(path.name + ".meta.json")


_Format = tuple[Callable[[Path, ShapeTable], None], Callable[[Path], ShapeTable]]
_FORMATS: Final[Mapping[str, _Format]] = {
    ".csv": (_save_csv, _load_csv),
    ".npz": (_save_npz, _load_npz),
    ".parquet": (_save_parquet, _load_parquet),
}
