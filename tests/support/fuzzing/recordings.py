"""Damage recorded folders and tables: only declared errors come out, and no other values."""

from __future__ import annotations

import json
import shutil
import zlib
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from noise_frames import camera_of

from fuzzing.damage import Outcome, Outcomes, flip, mutate, mutate_bytes
from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.frame import Frame
from shape_obs.recording import Moment, Recording, RecordingWriter, ShapeTable
from shape_obs.recording.format import CAMERA_FILE, FRAMES_FILE
from shape_obs.source import BadRecording

_SIZE: Final = (12, 16)  # pixels, (H, W)
_FRAMES: Final = 3

Draw = np.random.Generator


def damaged_recordings(folder: Path, count: int, seed: int) -> Counter[Outcome]:
    """Change one thing in a recording at a time, with its checksums put right, read it, and count the outcomes."""
    draw, outcomes = np.random.default_rng(seed), Outcomes(BadRecording)
    whole, changed = folder / "whole", folder / "changed"
    record_some(whole)
    damages = (_document, _text, _image)
    for i in range(count):
        shutil.rmtree(changed, ignore_errors=True)
        shutil.copytree(whole, changed)
        damage = damages[i % len(damages)]
        damage(changed, draw)
        outcomes.try_out(f"{damage.__name__} {i}", lambda: _read(changed))
    return outcomes.counts


def record_some(folder: Path) -> None:
    """Record three small frames: colour, depth as millimetres, and in the last one depth as metres."""
    draw = np.random.default_rng(0)
    camera = CameraModel(Intrinsics(_SIZE[1], _SIZE[0], 20.0, 20.0, 7.5, 5.5), np.eye(4))
    frames = []
    for i in range(_FRAMES):
        rgb = draw.integers(0, 256, (*_SIZE, 3), dtype=np.uint8)
        millimetres = draw.integers(300, 900, _SIZE, dtype=np.uint16)
        depth = millimetres if i + 1 < _FRAMES else (millimetres / 1000).astype(np.float32)
        frames.append(Frame(rgb, depth, camera, i / 30, None, i))
    with RecordingWriter(folder, camera_of(frames)) as writer:
        for frame in frames:
            writer.add(Moment(frame, {"gripper": (0.1, 0.2, 0.3)}))


def _read(folder: Path) -> None:
    recording = Recording(folder)
    for i in range(len(recording)):
        _ = recording[i]


def _document(folder: Path, draw: Draw) -> None:
    """Change values of ``camera.json`` or of a line of ``frames.jsonl``."""
    if draw.integers(2):
        path = folder / CAMERA_FILE
        path.write_text(json.dumps(mutate(json.loads(path.read_text()), draw)))
    else:
        _change_line(folder, draw, lambda line: mutate(line, draw))


def _text(folder: Path, draw: Draw) -> None:
    """Change the text of ``camera.json`` or ``frames.jsonl``."""
    path = folder / (CAMERA_FILE if draw.integers(2) else FRAMES_FILE)
    path.write_bytes(mutate_bytes(path.read_bytes(), draw))


def _image(folder: Path, draw: Draw) -> None:
    """Damage an image file and put its checksum right."""

    def change(line: dict[str, Any]) -> dict[str, Any]:
        entry = line["rgb" if draw.integers(2) else "depth"]
        path = folder / entry["file"]
        data = mutate_bytes(path.read_bytes(), draw)
        path.write_bytes(data)
        entry["file_crc32"] = zlib.crc32(data)
        return line

    _change_line(folder, draw, change)


def _change_line(folder: Path, draw: Draw, change: Callable[[dict[str, Any]], Any]) -> None:
    """Change a line of ``frames.jsonl``, never its end: that would only look like an interruption."""
    path = folder / FRAMES_FILE
    lines = path.read_text().splitlines()
    at = int(draw.integers(_FRAMES))
    lines[at] = json.dumps(change(json.loads(lines[at])))
    path.write_text("\n".join(lines) + "\n")


# ---- tables: no flipped bit may load as other values than were saved


_ROWS: Final = 12
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
    seen = np.arange(_ROWS) % 5 != 0
    points2d, points3d = (draw.normal(size=(_ROWS, _POINTS, axes)).astype(np.float32) for axes in (2, 3))
    points3d[~seen] = np.nan
    columns = {
        "frame": np.arange(_ROWS),
        "number": np.arange(_ROWS) + 100,
        "episode": np.arange(_ROWS) // 6,
        "stamp": np.arange(_ROWS) / 30,
        "source": np.full(_ROWS, "recordings/a"),
        "rope/ok": seen,
        "rope/age": np.where(seen, 0.0, 1 / 30),
        "rope/reason": np.where(seen, "", "the mask is empty"),
        "rope/points2d": points2d,
        "rope/points3d": points3d,
        "rope/visible": draw.random((_ROWS, _POINTS)) > 0.1,
    }
    return ShapeTable(columns, {"config": "version: 1\nshape: {}\n", "frames": _ROWS, "camera": {"fx": 381.25}})


def same(one: ShapeTable, other: ShapeTable) -> bool:
    """Return whether two tables hold the same columns, values and metadata."""
    if list(one.columns) != list(other.columns) or one.metadata != other.metadata:
        return False
    return all(
        one[name].shape == column.shape and np.array_equal(one[name], column, equal_nan=column.dtype.kind == "f")
        for name, column in other.columns.items()
    )
