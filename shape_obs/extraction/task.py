"""Describe the work of an extraction: one task per recorded episode, and its outcome."""

from __future__ import annotations

import hashlib
import re
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import groupby, islice
from pathlib import Path
from typing import Final, Literal

from shape_obs.recording import Recording
from shape_obs.recording.format import CAMERA_FILE, FRAMES_FILE
from shape_obs.source import BadRecording
from shape_obs.spec import Spec
from shape_obs.utils.files import listing

_CHUNK: Final = 1 << 20  # bytes


@dataclass(frozen=True)
class Task(Spec):
    """A recorded episode.

    Args:
        source: The recording: a recorded folder, a folder of images, or a file.
        index: Index of the episode in it, from 0; files and folders of images have one episode.
        frames: First frame and number of frames in a recorded folder; None for all frames.
    """

    source: str
    index: int = 0
    frames: tuple[int, int] | None = None

    @property
    def part(self) -> str:
        """Name of the episode's file in the dataset."""
        return f"{stem(self.source)}-{self.index:04d}.parquet"

    def fingerprint(self) -> str:
        """Return a SHA-256 hash of the recorded content, which does not depend on its path.

        For recorded folders, only ``camera.json`` and the lines of the frames are read, which hold the checksums of the
        images.

        Raises:
            OSError: The recording cannot be read.
        """
        path, digest = Path(self.source), hashlib.sha256()
        if self.frames is not None:
            digest.update((path / CAMERA_FILE).read_bytes())
            with (path / FRAMES_FILE).open("rb") as lines:
                for line in islice(lines, self.frames[0], sum(self.frames)):
                    digest.update(line)
            return digest.hexdigest()
        folder = path.is_dir()
        for file in listing(path) if folder else [path]:
            if folder:
                digest.update(file.name.encode() + b"\0")
            if file.is_file():
                with file.open("rb") as content:
                    _update(digest.update, content.read)
        return digest.hexdigest()


@dataclass(frozen=True)
class Outcome(Spec):
    """The outcome of a task.

    Args:
        task: The task.
        status: ``"done"`` in this run, ``"kept"`` from an earlier run, or ``"failed"``. The dataset has no part of a
            failed episode, unless its recording cannot be reached.
        frames: Number of frames.
        ok: Number of frames in which each shape is ok, by its name.
        reason: Reason of a failure, in one line.
        warnings: Messages of warnings.
    """

    task: Task
    status: Literal["done", "kept", "failed"]
    frames: int = 0
    ok: Mapping[str, int] = field(default_factory=dict)
    reason: str = ""
    warnings: tuple[str, ...] = ()


def tasks_of(source: str) -> list[Task]:
    """Return the episodes of a recording. A recording that cannot be read is one task, which will fail."""
    path = Path(source)
    if not (path.is_dir() and ((path / CAMERA_FILE).exists() or (path / FRAMES_FILE).exists())):
        return [Task(source)]
    try:
        episodes = Recording(path).episodes
    except BadRecording:
        return [Task(source)]
    found, first = [], 0
    for index, (_, run) in enumerate(groupby(episodes)):
        length = len(list(run))
        found.append(Task(source, index, (first, length)))
        first += length
    return found


def all_tasks(sources: Iterable[str]) -> list[Task]:
    """Return the episodes of all recordings, each recording once.

    Warnings about a recording are not issued here but when its episodes are read.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return [task for source in dict.fromkeys(sources) for task in tasks_of(source)]


def stem(source: str) -> str:
    """Return the start of the names of a recording's parts; readers of datasets ignore names that begin with '_'."""
    readable = re.sub(r"[^\w.-]+", "_", Path(source).name)
    return f"part-{readable}-{hashlib.sha256(Path(source).as_posix().encode()).hexdigest()[:8]}"


def _update(take: Callable[[bytes], object], read: Callable[[int], bytes]) -> None:
    while block := read(_CHUNK):
        take(block)
