"""Flip single bits in files of tables: none may load as other values than were saved."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from fuzzing.mutations import flip
from fuzzing.outcomes import Outcomes
from shape_obs.recording import ShapeTable
from tests.benchmarks.tables import at_most

SUFFIXES: Final = (".parquet", ".npz", ".csv")
_FRAMES: Final = 12
_POINTS: Final = 6

Tick = Callable[[], object]


def flipped_tables(
    folder: Path, flips: int, seed: int = 0, suffixes: tuple[str, ...] = SUFFIXES, tick: Tick = lambda: None
) -> list[dict[str, Any]]:
    """Save a table in each format, flip one bit of its file at a time, and load it.

    Args:
        folder: An empty folder for the files.
        flips: How many flips in each format; CSV's are spread over the table and its metadata.
        seed: Of the bits that are flipped.
        suffixes: The formats.
        tick: Called after each flip.

    Returns:
        Rows of what was asked and what was seen.
    """
    rows, table = [], a_table()
    for suffix in suffixes:
        path, draw = folder / f"table{suffix}", np.random.default_rng(seed)
        table.save(path)
        files = sorted(folder.glob(f"{path.name}*"))
        contents = [file.read_bytes() for file in files]
        outcomes = Outcomes(ValueError, OSError)
        for _ in range(flips):
            which = int(draw.choice(len(files), p=np.array([*map(len, contents)]) / sum(map(len, contents))))
            bit = int(draw.integers(8 * len(contents[which])))
            files[which].write_bytes(flip(contents[which], bit))
            name = f"{files[which].name}, bit {bit}"
            outcomes.try_out(name, lambda path=path: ShapeTable.load(path), lambda loaded: same(loaded, table))
            files[which].write_bytes(contents[which])
            tick()
        what = f"of {outcomes.total} flipped bits in *{suffix}, those that"
        rows.append(at_most(f"{what} load as other values", 0, outcomes.counts["wrong"], ""))
        rows.append(at_most(f"{what} raise an undeclared error", 0, outcomes.counts["undeclared"], ""))
    return rows


def a_table() -> ShapeTable:
    """Make a table with columns of each type."""
    draw = np.random.default_rng(1)
    seen = np.arange(_FRAMES) % 5 != 0
    points2d, points3d = (draw.normal(size=(_FRAMES, _POINTS, axes)).astype(np.float32) for axes in (2, 3))
    points3d[~seen] = np.nan
    columns = {
        "frame": np.arange(_FRAMES),
        "number": np.arange(_FRAMES) + 100,
        "episode": np.arange(_FRAMES) // 6,
        "stamp": np.arange(_FRAMES) / 30,
        "source": np.full(_FRAMES, "recordings/a"),
        "rope/ok": seen,
        "rope/age": np.where(seen, 0.0, 1 / 30),
        "rope/reason": np.where(seen, "", "the mask is empty"),
        "rope/points2d": points2d,
        "rope/points3d": points3d,
        "rope/visible": draw.random((_FRAMES, _POINTS)) > 0.1,
    }
    return ShapeTable(columns, {"config": "version: 1\nshape: {}\n", "frames": _FRAMES, "camera": {"fx": 381.25}})


def same(one: ShapeTable, other: ShapeTable) -> bool:
    """Return whether two tables hold the same columns, values and metadata."""
    if list(one.columns) != list(other.columns) or one.metadata != other.metadata:
        return False
    for name, column in other.columns.items():
        values = one[name]
        if values.shape != column.shape or not (
            np.array_equal(values, column, equal_nan=True)
            if column.dtype.kind == "f"
            else np.array_equal(values, column)
        ):
            return False
    return True
