"""Find the shapes and features of one recorded episode, and write them into a dataset."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from shape_obs import __version__
from shape_obs.config.config_file import config_hash, detector_arguments, schema_hash
from shape_obs.config.detector_config import ALGORITHM
from shape_obs.configurations.base import Configuration
from shape_obs.detector import ShapeDetector
from shape_obs.extraction.task import Outcome, Task
from shape_obs.features import Block, Feature, FeatureContext, FeatureVector, read_features
from shape_obs.features.coordinates import check_workspace
from shape_obs.recording import Moment, ShapeLog, ShapeTable, replay
from shape_obs.recording.replay import check_depth
from shape_obs.recording.table import Column, step_columns
from shape_obs.shape import Detection
from shape_obs.source import RGBDSource
from shape_obs.utils.files import checksum
from shape_obs.utils.threads import one_thread

_POINT_AXES: Final = {"points2d": 2, "points3d": 3}
#: Version of the columns; datasets with another one are not continued.
_LAYOUT: Final = 2


@dataclass(frozen=True)
class Extraction:
    """Define what to find in every episode, and where to write it. Instances are pickled to other processes.

    Args:
        config: Configuration as ``load_config`` returns it, including features.
        out: Folder of the dataset.
        open: Opens a recording, such as ``shape_obs_envs.sources.open_source``, with the arguments ``extrinsics`` and,
            for part of a recorded folder, ``frames=(first, count)``.
        extrinsics: File with the pose of the camera, which replaces recorded poses.
        frames: Largest number of frames of each episode.

    Raises:
        ValueError: ``made_with`` and ``work`` raise it if the configuration is invalid.
    """

    config: Mapping[str, Any]
    out: Path
    open: Callable[..., RGBDSource]
    extrinsics: Path | None = None
    frames: int | None = None

    def made_with(self) -> dict[str, Any]:
        """Return everything except the recordings on which the dataset depends, as JSON values.

        All parts of a dataset were made with equal values.
        """
        pose = None if self.extrinsics is None else checksum(self.extrinsics)
        return {
            "shape_obs": __version__,
            "algorithm": ALGORITHM,
            "layout": _LAYOUT,
            "config_hash": config_hash(self.config),
            "schema_hash": schema_hash(self.config),
            "extrinsics": pose,
            "frames": self.frames,
        }

    def detector(self) -> ShapeDetector:
        """Return a new detector, for which a lost shape is a row that is not ok, also with ``on_missing="raise"``."""
        given = detector_arguments(self.config)
        return ShapeDetector(**{**given, "on_missing": "nan"} if given.get("on_missing") == "raise" else given)


def work(job: Extraction, made_with: Mapping[str, Any], task: Task) -> Outcome:
    """Find the shapes of an episode and write them, unless the dataset already has them.

    Args:
        job: What to find.
        made_with: Result of ``job.made_with()``.
        task: The episode.

    Returns:
        The outcome. It also reports exceptions, so that one episode does not affect the others.
    """
    part = job.out / task.part
    for temporary in job.out.glob(f".{task.part}.*"):  # left by a run that was killed
        temporary.unlink(missing_ok=True)
    read = False
    try:
        made, read = {**made_with, "fingerprint": task.fingerprint()}, True
        kept = _kept(part, made, task)
        if kept is not None:
            return kept
        with one_thread(), warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", UserWarning)
            table = _table(job, made, task)
        messages = [" ".join(str(warning.message).split()) for warning in caught if warning.category is UserWarning]
        table.save(part)
    except Exception as error:  # noqa: BLE001 - one failing episode must not end the others
        if read:
            part.unlink(missing_ok=True)  # the result of an earlier state of the recording
        reason = " ".join(str(error).split())
        expected = isinstance(error, (OSError, ValueError)) and reason
        return Outcome(task, "failed", reason=reason if expected else f"{type(error).__name__}: {reason}")
    return Outcome(task, "done", len(table), table.metadata["ok"], warnings=tuple(dict.fromkeys(messages)))


def _kept(part: Path, made: Mapping[str, Any], task: Task) -> Outcome | None:
    """Return the outcome of an earlier run; None if its part is missing, damaged or out of date."""
    if not part.exists():
        return None
    try:
        known = ShapeTable.load(part).metadata  # verifies its checksum
        return Outcome(task, "kept", known["frames"], known["ok"]) if known.get("made_with") == made else None
    except (KeyError, ValueError, OSError):
        return None


def _table(job: Extraction, made: Mapping[str, Any], task: Task) -> ShapeTable:
    detector, features = job.detector(), read_features(job.config.get("features") or ())
    part = {} if task.frames is None else {"frames": task.frames}
    source = job.open(task.source, extrinsics=job.extrinsics, **part)
    collected = FeatureLog(features, detector.shapes, job.config.get("workspace"), detector.config.max_age)
    with source:
        check_depth(source, detector, job.config)
        log = ShapeLog(detector, job.config, source)
        for moment, detection in replay(source, detector, job.frames):
            log.add(moment, detection)
            collected.add(moment, detection)
    shapes = log.table()
    columns = {"source": np.full(len(shapes), task.source), **_complete(shapes.columns, log.metadata["shapes"])}
    # Without time and software versions, so that equal recordings give equal files.
    metadata = {name: value for name, value in log.metadata.items() if name not in ("created", "software")}
    metadata |= {"source": {"kind": source.kind, "name": task.source}, "frames": len(shapes), "made_with": dict(made)}
    metadata |= {"ok": {name: int(shapes[f"{name}/ok"].sum()) for name in log.metadata["shapes"]}}
    metadata |= {"features": collected.describe()}
    return ShapeTable({**columns, **collected.columns()}, metadata)


def _complete(columns: Mapping[str, Column], sizes: Mapping[str, int]) -> dict[str, Column]:
    """Return the columns that every part has, even if its recording lacks some; without receive times."""
    count = len(columns["frame"])
    found = {name: column for name, column in columns.items() if name != "received"}
    for name, column in step_columns(count * [0], count * [None], count * [None]).items():
        found.setdefault(name, column)
    for name, size in sizes.items():
        for kind, axes in _POINT_AXES.items():
            found.setdefault(f"{name}/{kind}", np.full((count, size, axes), np.nan, np.float32))
    first = [name for name in found if "/" not in name]
    return {name: found[name] for name in [*first, *sorted(set(found) - set(first))]}


class FeatureLog:
    """Collect the features of each frame, equal to the observation of ``ShapeObservation``.

    Args:
        features: Features of each shape.
        shapes: Configurations as the detector resolved them.
        workspace: Low and high corner in metres in the base frame, which bound points in the base frame.
        max_age: Seconds at which ``age`` saturates.
    """

    def __init__(
        self, features: Sequence[Feature], shapes: Sequence[Configuration], workspace: Any, max_age: float
    ) -> None:
        self._features, self._shapes = tuple(features), tuple(shapes)
        self._workspace, self._max_age = workspace, max_age
        check_workspace(workspace)
        self._vector: FeatureVector | None = None
        self._values: list[Column] = []
        self._measured: list[Column] = []

    def add(self, moment: Moment, detection: Detection) -> dict[str, dict[str, float]]:
        """Add the features of a frame, and return them by feature and component, see ``FeatureVector.named``.

        Raises:
            ValueError: A feature needs something that the frame lacks, such as depth or extrinsics.
        """
        # Imported here, since it imports gymnasium.
        from shape_obs.wrappers.env_protocol import base_point

        if not self._features:
            return {}
        height, width = moment.frame.size or (1, 1)
        context = FeatureContext(
            width, height, moment.frame.camera, self._workspace, self._max_age, anchors=moment.anchors
        )
        if self._vector is None:
            self._vector = FeatureVector(self._features, self._shapes, context)
        contexts = [replace(context, anchor=base_point(shape, moment.anchors)) for shape in self._shapes]
        self._values.append(self._vector.compute(detection.shapes, contexts))
        self._measured.append(self._vector.measured(detection.shapes))
        return self._vector.named(self._values[-1])

    def columns(self) -> dict[str, Column]:
        """Return ``<shape>/features/<kind>`` ``(F, D)`` float32 and, for each, ``.../measured`` ``(F, D)`` bool."""
        if self._vector is None:
            return {}
        values, measured = np.stack(self._values), np.stack(self._measured)
        columns = {}
        for name, block in _named(self._vector.blocks):
            columns[name] = values[:, block.place]
            columns[f"{name}/measured"] = measured[:, block.place]
        return columns

    def describe(self) -> dict[str, Any]:
        """Return for each column ``feature``, its spec, and ``units`` of each value, as JSON values."""
        blocks = () if self._vector is None else self._vector.blocks
        return {
            name: {"feature": block.feature.to_dict(), "units": list(block.units)} for name, block in _named(blocks)
        }


def _named(blocks: Iterable[Block]) -> Iterable[tuple[str, Block]]:
    """Yield the blocks with the names of their columns; further features of a kind are numbered."""
    seen: Counter[str] = Counter()
    for block in blocks:
        name = f"{block.shape}/features/{block.feature.kind}"
        seen[name] += 1
        yield name if seen[name] == 1 else f"{name}_{seen[name]}", block
