"""Write extracted episodes as a LeRobot dataset."""

from __future__ import annotations

import hashlib
import json
import secrets
import shutil
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from shape_obs.extraction.extraction import Extraction
from shape_obs.extraction.lerobot.videos import need_encoder
from shape_obs.extraction.lerobot.writer import Episode, LeRobotSummary, LeRobotWriter, read_episode
from shape_obs.extraction.task import Task
from shape_obs.recording import ShapeTable
from shape_obs.utils.documents import read_json
from shape_obs.utils.files import make_folder, write_text

_FOLDERS: Final = ("data", "videos", "meta")
#: In the folder of the extraction: the checksum of the dataset's ``meta/info.json``.
_MANIFEST: Final = "_lerobot.json"
_INFO: Final = "meta/info.json"
#: Frames per second of recordings without stamps.
_FPS: Final = 30.0


def write_lerobot(
    job: Extraction,
    tasks: Sequence[Task],
    out: Path,
    *,
    task: str = "",
    fps: float | None = None,
    videos: bool = False,
    overwrite: bool = False,
) -> LeRobotSummary:
    """Write the episodes of an extraction as a LeRobot dataset, completely or not at all.

    One that was written from this extraction before, and was not changed since, is replaced.
    Timestamps are multiples of ``1 / fps``, as LeRobot expects them.

    Args:
        job: The extraction, whose dataset in ``job.out`` is complete.
        tasks: The episodes, in order; those that the extraction's dataset lacks are left out.
        out: The folder, in which ``data``, ``meta`` and ``videos`` are replaced.
        task: What is done in the episodes, in words, for policies that read language.
        fps: Frames per second; None for the median rate of the stamps.
        videos: Whether to encode the camera's images, as H.264.
        overwrite: Whether to replace any other ``data``, ``meta`` and ``videos``.

    Raises:
        FileExistsError: There are others, and ``overwrite`` is False.
        ValueError: There is no episode; episodes differ in features, actions or states; or ``fps`` is out of range.
        ImportError: The extra ``parquet``, or for videos ``video``, is missing.
        OSError: A file cannot be read or written.

    Warns:
        UserWarning: Frames inside episodes are left out, since a frame after them was dropped.
    """
    if fps is not None and not 0 < fps < np.inf:
        raise ValueError(f"fps: expected more than 0, got {fps}.")
    if videos:
        need_encoder()
    if not overwrite:
        check_lerobot_folder(out, job.out)
    present = [each for each in tasks if (job.out / each.part).exists()]
    features, rate, robot = _survey(job, present)
    rate = rate if fps is None else fps
    for stale in make_folder(out).glob(".lerobot.*"):  # left by a run that was killed
        shutil.rmtree(stale)
    folder = out / f".lerobot.{secrets.token_hex(8)}"
    try:
        writer = LeRobotWriter(folder, features, round(rate) if abs(rate - round(rate)) < 0.01 * rate else rate)
        for each in present:
            episode = _read(job, each)
            writer.add(episode, task, (job, each) if videos else None)
        summary = writer.close(task, robot)
        for name in reversed(_FOLDERS):  # without meta the rest is no dataset
            shutil.rmtree(out / name, ignore_errors=True)
        write_text(job.out / _MANIFEST, json.dumps({_INFO: _digest(folder / _INFO)}) + "\n")
        for name in _FOLDERS:
            if (folder / name).exists():
                (folder / name).replace(out / name)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return summary


def check_lerobot_folder(out: Path, extraction: Path) -> None:
    """Check that what a LeRobot dataset replaces was written from the same extraction, and was not changed since.

    Raises:
        FileExistsError: It was not.
    """
    there = [name for name in _FOLDERS if (out / name).exists()]
    manifest, info = extraction / _MANIFEST, out / _INFO
    if not there or (
        manifest.exists() and (not info.exists() or read_json(manifest, "manifest").get(_INFO) == _digest(info))
    ):
        return
    raise FileExistsError(
        f"{out / there[0]} was not written by this command, or was changed since: give --overwrite to replace "
        f"{', '.join(there)}, or choose another folder."
    )


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _read(job: Extraction, task: Task) -> Episode:
    try:
        return read_episode(ShapeTable.load(job.out / task.part))
    except ValueError as error:
        raise ValueError(f"{task.source}, episode {task.index}: {error}") from error


def _survey(job: Extraction, tasks: Sequence[Task]) -> tuple[dict[str, Any], float, str | None]:
    """Return the features that all episodes share, the frames per second, and the name of the robot."""
    features: dict[str, Any] = {}
    gaps, robots, left_out = [], set[str | None](), 0
    for task in tasks:
        episode = _read(job, task)
        mine = episode.features()
        if features and mine != features:
            different = sorted(name for name in {*mine, *features} if mine.get(name) != features.get(name))
            raise ValueError(
                f"{task.source}, episode {task.index}: its {', '.join(different)} differ from those of the episodes "
                "before, but a LeRobot dataset has the same in all: extract these recordings into another folder."
            )
        features = mine
        gaps.append(episode.gap)
        robots.add(episode.robot)
        left_out += episode.left_out
    if not features:
        raise ValueError("no episode was extracted, so there is no LeRobot dataset to write.")
    if left_out:
        warnings.warn(
            f"{left_out} frames are left out: the frame after them was dropped, so it is unknown what followed them.",
            UserWarning,
            stacklevel=3,
        )
    known = [gap for gap in gaps if gap > 0]
    return features, 1 / float(np.median(known)) if known else _FPS, robots.pop() if len(robots) == 1 else None
