"""Damaged and hostile files of every kind that the package reads."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from fuzzing.documents import damaged_documents
from fuzzing.recordings import damaged_recordings
from fuzzing.tables import flipped_tables


def damaged_files(
    folder: Path,
    flips: int = 2000,
    recordings: int = 3000,
    documents: int = 500,
    seed: int = 0,
    tick: Callable[[], object] = lambda: None,
) -> list[dict[str, Any]]:
    """Damage tables, recordings and documents, and read them.

    Args:
        folder: An empty folder for the files.
        flips: Flipped bits in a table of each format.
        recordings: Changes of recorded folders.
        documents: Changes of each kind of document: config, goal, study, calibration files, fitted features.
        seed: Of all changes.
        tick: Called after each.

    Returns:
        Rows of what was asked and what was seen.
    """
    parts = [folder / name for name in ("tables", "recordings", "documents")]
    for part in parts:
        part.mkdir()
    return [
        *flipped_tables(parts[0], flips, seed, tick=tick),
        *damaged_recordings(parts[1], recordings, seed, tick=tick),
        *damaged_documents(parts[2], documents, seed, tick=tick),
    ]
