"""ShapeTable: shapes of many frames as columns, in CSV, NPZ or Parquet."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.files import make_folder, write_whole

Column = npt.NDArray[Any]
_METADATA: Final = "metadata"
_AXES: Final = {"points2d": "uv", "points3d": "xyz"}
_TYPES: Final[Mapping[str, type[Any]]] = {
    "frame": np.int64,
    "number": np.int64,
    "episode": np.int64,
    "ok": np.bool_,
    "visible": np.bool_,
    "valid": np.bool_,
    "reason": np.str_,
    "source": np.str_,
    "points2d": np.float32,
    "points3d": np.float32,
}


@dataclass(frozen=True, eq=False)
class ShapeTable:
    """A row for each frame. ``table["rope/points2d"]`` is a column.

    Args:
        columns: Arrays of equal length F. ``frame`` counts from 0; ``number`` is the source's own count (-1: none);
            ``episode``; ``stamp`` and ``received``, seconds (NaN: unknown). For each shape, by its name: ``<name>/ok``
            (F,) bool, ``<name>/age`` (F,) seconds, ``<name>/quality`` (F,) 0...1, ``<name>/reason`` (F,) str,
            ``<name>/points2d`` (F,N,2) float32 pixels, ``<name>/points3d`` (F,N,3) float32 metres in the camera's frame
            (only with depth), ``<name>/visible`` and ``<name>/valid`` (F,N) bool. Points are NaN where ``ok`` is False.
        metadata: JSON-able: what made the table.
    """

    columns: Mapping[str, Column]
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Column:
        return self.columns[name]

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def save(self, path: str | Path) -> None:
        """Write the table, whole or not at all.

        Args:
            path: ``.npz``; ``.parquet``, where points are flat lists (``.reshape(-1, N, 2)``) and the metadata stand in
                the schema's under ``shape_obs``; or ``.csv``, with the metadata beside it in ``.csv.meta.json``.

        Raises:
            ValueError: Another suffix.
            ImportError: Parquet without the extra ``parquet``.
            OSError: It cannot be written.
        """
        path = Path(path)
        check_table_path(path)
        write_whole(path, lambda beside: _FORMATS[path.suffix][0](beside, self))
        if path.suffix == ".csv":
            beside = json.dumps(self.metadata, indent=1) + "\n"
            write_whole(_sidecar(path), lambda target: _write_text(target, beside))

    @classmethod
    def load(cls, path: str | Path) -> ShapeTable:
        """Read a table that ``save`` wrote; errors as those of ``save``, and ValueError for a file that is none."""
        path = Path(path)
        if not path.exists():
            raise FileNotFoundError(f"{path}: no such file.")
        check_table_path(path)
        try:
            table = _FORMATS[path.suffix][1](path)
            if "frame" not in table.columns:
                raise ValueError("it has no column 'frame'")
        except (KeyError, ValueError, IndexError) as error:
            raise ValueError(f"{path}: not a table of shapes: {error}") from error
        return table


def check_table_path(path: Path) -> None:
    """See that a table can be written there, before hours of work.

    Raises:
        ValueError: Another suffix than ``.csv``, ``.npz`` or ``.parquet``.
        ImportError: Parquet without the extra ``parquet``.
        OSError: The folder cannot be made.
    """
    if path.suffix not in _FORMATS:
        raise ValueError(f"{path}: expected a file named {', '.join('*' + suffix for suffix in _FORMATS)}.")
    if path.suffix == ".parquet":
        _pyarrow()
    make_folder(path.parent)


# ---- NPZ


def _save_npz(path: Path, table: ShapeTable) -> None:
    with path.open("wb") as file:
        columns: dict[str, Any] = {_METADATA: np.array(json.dumps(table.metadata)), **table.columns}
        np.savez_compressed(file, **columns)


def _load_npz(path: Path) -> ShapeTable:
    with np.load(path, allow_pickle=False) as content:
        metadata = json.loads(str(content[_METADATA]))
        return ShapeTable({name: content[name] for name in content.files if name != _METADATA}, metadata)


# ---- Parquet


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise ImportError(f"Parquet needs pyarrow: pip install 'shape-obs[parquet]' ({error})") from error
    return pyarrow, pyarrow.parquet


def _save_parquet(path: Path, table: ShapeTable) -> None:
    arrow, parquet = _pyarrow()
    arrays = {}
    for name, column in table.columns.items():
        flat = arrow.array(np.ascontiguousarray(column).ravel())
        width = int(np.prod(column.shape[1:]))
        arrays[name] = flat if column.ndim == 1 else arrow.FixedSizeListArray.from_arrays(flat, width)
    content = arrow.table(arrays).replace_schema_metadata({"shape_obs": json.dumps(table.metadata)})
    parquet.write_table(content, path)


def _load_parquet(path: Path) -> ShapeTable:
    arrow, parquet = _pyarrow()
    try:
        content = parquet.read_table(path)
    except arrow.ArrowException as error:
        raise ValueError(str(error)) from error
    columns = {}
    for name in content.column_names:
        column = content[name].combine_chunks()
        kind = name.split("/")[-1]
        if arrow.types.is_fixed_size_list(column.type):
            flat = column.flatten().to_numpy(zero_copy_only=False)
            axes = len(_AXES.get(kind, " "))
            shape = (len(content), column.type.list_size // axes, axes)
            columns[name] = flat.reshape(shape if kind in _AXES else shape[:2])
        else:
            columns[name] = column.to_numpy(zero_copy_only=False).astype(_TYPES.get(kind, np.float64))
    return ShapeTable(columns, json.loads((content.schema.metadata or {})[b"shape_obs"]))


# ---- CSV


def _save_csv(path: Path, table: ShapeTable) -> None:
    heads: list[str] = []
    values: list[list[Any]] = []
    for name, column in table.columns.items():
        axes = _AXES.get(name.split("/")[-1])
        for index in np.ndindex(*column.shape[1:]):
            place = [str(i) for i in index]
            if axes:
                place[-1] = axes[index[-1]]
            heads.append("/".join([name, *place]))
            part = column[(slice(None), *index)]
            # The shortest text that gives the same float32 back, not that of the float64 it would become.
            values.append([str(value) for value in part] if part.dtype.kind == "f" else part.tolist())
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(heads)
        writer.writerows(zip(*values, strict=True))


def _load_csv(path: Path) -> ShapeTable:
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
        columns[name] = column if kind in (*_AXES, "visible", "valid") else column[:, 0]
    sidecar = _sidecar(path)
    return ShapeTable(columns, json.loads(sidecar.read_text(encoding="utf-8")) if sidecar.exists() else {})


def _sidecar(path: Path) -> Path:
    return path.with_name(path.name + ".meta.json")


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


_Format = tuple[Callable[[Path, ShapeTable], None], Callable[[Path], ShapeTable]]
_FORMATS: Final[Mapping[str, _Format]] = {
    ".csv": (_save_csv, _load_csv),
    ".npz": (_save_npz, _load_npz),
    ".parquet": (_save_parquet, _load_parquet),
}
