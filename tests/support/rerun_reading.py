"""Read what a `.rrd` file holds with rerun's own reader, whose interface depends on its version."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

# Names of the same column: since 0.24, and before.
OLD = {
    "Points2D:positions": "Position2D",
    "Points3D:positions": "Position3D",
    "Points2D:colors": "Color",
    "Points2D:labels": "Text",
    "Scalars:scalars": "Scalar",
    "SeriesLines:names": "Name",
    "TextLog:text": "Text",
    "EncodedImage:blob": "Blob",
    "DepthImage:buffer": "ImageBuffer",
    "SegmentationImage:buffer": "ImageBuffer",
    "LineStrips2D:strips": "LineStrip2D",
    "LineStrips3D:strips": "LineStrip3D",
    "Pinhole:image_from_camera": "PinholeProjection",
    "Transform3D:translation": "Translation3D",
}


def read_rrd(path: Path, entity: str, column: str, index: str = "frame") -> dict[Any, Any]:
    """Return the values of a component of an entity by frame, or by another timeline; static ones under None."""
    if (reader := _reader()) is None:
        return _read_view(path, entity, column, index)
    found = {}
    for chunk in reader(path).stream():
        if chunk.entity_path == entity:
            batch = chunk.to_record_batch()
            if column in batch.schema.names:
                keys = batch.column(index).to_pylist() if index in batch.schema.names else len(batch) * [None]
                found |= dict(zip(keys, batch.column(column).to_pylist(), strict=True))
    return dict(sorted(found.items(), key=lambda item: (item[0] is not None, item[0]))) if found else {}


def entities(path: Path) -> set[str]:
    """Return the paths of all entities of the recording."""
    if (reader := _reader()) is None:
        return {column.entity_path for column in _load(path).schema().component_columns()}
    return {chunk.entity_path for chunk in reader(path).stream()} - {"/__properties"}


def points(values: Any) -> np.ndarray:
    """Return a list of points as an array; `(0, 2)` for none."""
    return np.array(values, np.float32) if values else np.zeros((0, 2), np.float32)


def _reader() -> Any:
    """Return the class that reads files by chunks; None in versions that have only views."""
    for module in ("rerun.chunk", "rerun.experimental"):
        if find_spec(module) is not None and hasattr(import_module(module), "RrdReader"):
            return import_module(module).RrdReader
    return None


def _load(path: Path) -> Any:
    return import_module("rerun.dataframe").load_recording(path)


def _read_view(path: Path, entity: str, column: str, index: str) -> dict[Any, Any]:
    recording = _load(path)
    static = {
        f"{each.entity_path}:{each.component}"
        if hasattr(each, "component")
        else f"{each.entity_path}:{each.component_name}"
        for each in recording.schema().component_columns()
        if each.is_static
    }
    view, names = recording.view(index=index, contents=entity), {f"{entity}:{column}", f"{entity}:{OLD[column]}"}
    table = (view.select_static() if names & static else view.select()).read_all()
    name = next(iter(names & set(table.column_names)), None)
    if name is None:
        return {}
    keys = table[index].to_pylist() if index in table.column_names else len(table) * [None]
    return {key: value for key, value in zip(keys, table[name].to_pylist(), strict=True) if value is not None}
