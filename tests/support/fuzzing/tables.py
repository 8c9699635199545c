"""Flip single bits in files of tables: none may load as other values than were saved."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Final

import numpy as np

from fuzzing.mutations import flip
from fuzzing.outcomes import Outcome, Outcomes
from shape_obs.recording import ShapeTable

_FRAMES: Final = 12
_POINTS: Final = 6


def flipped_tables(folder: Path, suffix: str, flips: int, seed: int) -> Counter[Outcome]:
    """Save a table in a format, flip one bit of its files at a time, load it, and count the outcomes.

    The flips of CSV are spread over the table and the file of its metadata.
    """
    table, path, draw = a_table(), folder / f"table{suffix}", np.random.default_rng(seed)
    table.save(path)
    files = sorted(folder.glob(f"{path.name}*"))
    contents = [file.read_bytes() for file in files]
    outcomes = Outcomes(ValueError, OSError)
    for _ in range(flips):
        which = int(draw.choice(len(files), p=np.array([*map(len, contents)]) / sum(map(len, contents))))
        bit = int(draw.integers(8 * len(contents[which])))
        files[which].write_bytes(flip(contents[which], bit))
        name = f"{files[which].name}, bit {bit}"
        outcomes.try_out(name, lambda: ShapeTable.load(path), lambda loaded: same(loaded, table))
        files[which].write_bytes(contents[which])
    return outcomes.counts


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
    return all(
        one[name].shape == column.shape and np.array_equal(one[name], column, equal_nan=column.dtype.kind == "f")
        for name, column in other.columns.items()
    )
