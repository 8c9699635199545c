"""Write extracted episodes as a LeRobot dataset."""

from __future__ import annotations

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
from shape_obs.utils.files import checksum, make_folder, write_text

_FOLDERS: Final = ("data", "videos", "meta")
#: In the folder of the extraction: the checksum of the dataset's ``meta/info.json``.
_MANIFEST: Final = "_lerobot.json"
_INFO: Final = "meta/info.json"
#: Frames per second of recordings without stamps.
_FPS: Final = 30.0
_UNLIKE: Final = 0.1  # of the duration of an episode, by which its rows may differ without a word


def write_lerobot(
    job: Extraction,
    tasks: Sequence[Task],
    out: Path,
    *,
    task: str | None = None,
    fps: float | None = None,
    videos: bool = False,
    overwrite: bool = False,
) -> LeRobotSummary:
    """Write the episodes of an extraction as a LeRobot dataset, completely or not at all.

    One that was written from this extraction before, and was not changed since, is replaced; its ``task`` and ``fps``
    are kept unless others are given. Timestamps are multiples of ``1 / fps``, as LeRobot expects them.

    Args:
        job: The extraction, whose dataset in ``job.out`` is complete.
        tasks: The episodes, in order; those that the extraction's dataset lacks are left out.
        out: The folder, in which ``data``, ``meta`` and ``videos`` are replaced.
        task: What is done in the episodes, in words, for policies that read language; default: that of an
            earlier run, else "move the" and the names of the shapes.
        fps: Frames per second; default: those given to an earlier run, else the median rate of the stamps, as a whole
            number if it is within 1 % of one.
        videos: Whether to encode the camera's images, as H.264.
        overwrite: Whether to replace any other ``data``, ``meta`` and ``videos``.

    Raises:
        FileExistsError: There are others, and ``overwrite`` is False.
        ValueError: There is no episode; episodes differ in features, actions or states; or ``fps`` is out of range.
        ImportError: The extra ``parquet``, or for videos ``video``, is missing.
        OSError: A file cannot be read or written.

    Warns:
        UserWarning: Frames inside episodes are left out, since a frame after them was dropped; the duration of episodes
            is another one by their stamps than by ``fps``; or episodes or videos that were there are left out.
    """
    if fps is not None and not 0 < fps < np.inf:
        raise ValueError(f"fps: expected more than 0, got {fps}.")
    manifest = job.out / _MANIFEST
    earlier = read_json(manifest, "manifest") if manifest.exists() else {}
    if task is None:
        task = str(earlier.get("task") or f"move the {' and the '.join(shape.name for shape in job.detector().shapes)}")
    fps = chosen = fps or earlier.get("fps")
    if videos:
        need_encoder()
    elif (out / "videos").is_dir():
        _warn("the videos of the existing dataset are removed: give --videos (videos=True) to have them again.")
    if not overwrite:
        check_lerobot_folder(out, job.out)
    present = [each for each in tasks if (job.out / each.part).exists()]
    others = len({path.name for path in job.out.glob("*.parquet")} - {each.part for each in present})
    if others:
        _warn(f"{others} episodes in {job.out} are left out: they are of recordings that were not named this time.")
    features, rate, robot, seconds = _survey(job, present)
    fps = fps or _nominal(rate)
    for each, (steps, by_stamps) in seconds.items():
        if abs(steps / fps - by_stamps) > _UNLIKE * by_stamps:
            _warn(
                f"{each.source}, episode {each.index}, lasts {steps / fps:.3g} s at {fps:.6g} frames a second, but "
                f"{by_stamps:.3g} s by its stamps, and perhaps others: a LeRobot dataset has one rate, see --fps."
            )
            break
    for stale in make_folder(out).glob(".lerobot.*"):  # left by a run that was killed
        shutil.rmtree(stale)
    folder = out / f".lerobot.{secrets.token_hex(8)}"
    try:
        writer = LeRobotWriter(folder, features, int(fps) if fps == int(fps) else fps)
        for each in present:
            episode = _read(job, each)
            writer.add(episode, task, (job, each) if videos else None)
        summary = writer.close(task, robot)
        for name in reversed(_FOLDERS):  # without meta the rest is no dataset
            shutil.rmtree(out / name, ignore_errors=True)
        made = {_INFO: checksum(folder / _INFO), "task": task, "fps": chosen}
        write_text(manifest, json.dumps(made) + "\n")
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
        manifest.exists() and (not info.exists() or read_json(manifest, "manifest").get(_INFO) == checksum(info))
    ):
        return
    raise FileExistsError(
        f"{out / there[0]} was not written by this command, or was changed since: give --overwrite to replace "
        f"{', '.join(there)}, or choose another folder."
    )


def _nominal(rate: float) -> float:
    """Return the frames per second that a camera has whose stamps show this rate: 29.97 and 30 differ by 0.1 %."""
    whole = round(rate)
    for nominal, nearly in ((whole / 1.001, 1e-4), (float(whole), 0.01)):
        if abs(rate - nominal) < nearly * rate:
            return nominal
    return rate


def _warn(text: str) -> None:
    warnings.warn(text, UserWarning, stacklevel=3)


def _read(job: Extraction, task: Task) -> Episode:
    try:
        return read_episode(ShapeTable.load(job.out / task.part))
    except ValueError as error:
        raise ValueError(f"{task.source}, episode {task.index}: {error}") from error


def _survey(
    job: Extraction, tasks: Sequence[Task]
) -> tuple[dict[str, Any], float, str | None, dict[Task, tuple[int, float]]]:
    """Return the features that all share, the frames per second, the robot's name, and (steps, seconds) of each."""
    features: dict[str, Any] = {}
    gaps, robots, left_out, seconds = [], set[str | None](), 0, {}
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
        if episode.seconds > 0:
            seconds[task] = episode.steps, episode.seconds
    if not features:
        raise ValueError("no episode was extracted, so there is no LeRobot dataset to write.")
    if left_out:
        _warn(f"{left_out} frames are left out: the frame after them was dropped, so it is unknown what followed them.")
    known = [gap for gap in gaps if gap > 0]
    rate = 1 / float(np.median(known)) if known else _FPS
    return features, rate, robots.pop() if len(robots) == 1 else None, seconds
