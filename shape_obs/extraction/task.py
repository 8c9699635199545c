"""Task: one recorded episode, its part of the dataset, and what became of it."""

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

_CHUNK: Final = 1 << 20  # bytes


@dataclass(frozen=True)
class Task(Spec):
    """One recorded episode.

    Args:
        source: The recording: a recorded folder, a folder of images, or a file.
        index: Which of its episodes, counted from 0; files and folders of images have one.
        frames: (first, count) of a recorded folder's frames; None for all that there are.
    """

    source: str
    index: int = 0
    frames: tuple[int, int] | None = None

    @property
    def part(self) -> str:
        """Name of its file in the dataset."""
        return f"{stem(self.source)}-{self.index:04d}.parquet"

    def fingerprint(self) -> str:
        """SHA-256 of what was recorded, wherever it lies. A recorded folder's lines hold the checksums of its images.

        Raises:
            OSError: It cannot be read.
        """
        path, digest = Path(self.source), hashlib.sha256()
        if self.frames is not None:
            digest.update((path / CAMERA_FILE).read_bytes())
            with (path / FRAMES_FILE).open("rb") as lines:
                for line in islice(lines, self.frames[0], sum(self.frames)):
                    digest.update(line)
            return digest.hexdigest()
        folder = path.is_dir()
        for file in sorted(path.iterdir()) if folder else [path]:
            if folder:
                digest.update(file.name.encode() + b"\0")
            if file.is_file():
                with file.open("rb") as content:
                    _update(digest.update, content.read)
        return digest.hexdigest()


@dataclass(frozen=True)
class Outcome(Spec):
    """What became of a task.

    Args:
        task: Which one.
        status: ``"done"`` now, ``"kept"`` from before, or ``"failed"``: whatever it was before, it is not in
            the dataset then, unless the recording cannot be reached.
        frames: How many there are.
        ok: Name of a shape -> in how many of them it is ok.
        reason: Why it failed, in one line.
        warnings: What was said meanwhile.
    """

    task: Task
    status: Literal["done", "kept", "failed"]
    frames: int = 0
    ok: Mapping[str, int] = field(default_factory=dict)
    reason: str = ""
    warnings: tuple[str, ...] = ()


def tasks_of(source: str) -> list[Task]:
    """Return the episodes of a recording. One that cannot be read is one task, whose outcome names the reason."""
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
    """The episodes of all recordings, each recording once.

    Warnings about a recording are left to those who read its episodes.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return [task for source in dict.fromkeys(sources) for task in tasks_of(source)]


def stem(source: str) -> str:
    """With what the parts of a recording begin: readers of datasets pass over names that begin with '_' or '.'."""
    readable = re.sub(r"[^\w.-]+", "_", Path(source).name)
    return f"part-{readable}-{hashlib.sha256(Path(source).as_posix().encode()).hexdigest()[:8]}"


def _update(take: Callable[[bytes], object], read: Callable[[int], bytes]) -> None:
    while block := read(_CHUNK):
        take(block)
