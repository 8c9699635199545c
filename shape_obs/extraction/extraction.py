"""FeatureLog: collects features frame by frame, as columns beside those of the shapes.

Extraction: what all episodes of a dataset have in common, and the work on one of them.
"""

from __future__ import annotations

import hashlib
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from shape_obs import __version__
from shape_obs.config import config_hash, detector_arguments, schema_hash
from shape_obs.configurations import Configuration
from shape_obs.detector import ShapeDetector
from shape_obs.extraction.task import Outcome, Task
from shape_obs.features import Block, Feature, FeatureVector, read_features
from shape_obs.features import FeatureContext as View
from shape_obs.recording import Moment, ShapeLog, ShapeTable, replay
from shape_obs.recording.replay import check_depth
from shape_obs.recording.table import Column
from shape_obs.shape import Detection
from shape_obs.source import RGBDSource
from shape_obs.utils.threads import one_thread


class FeatureLog:
    """Collects the vector that ``ShapeObservation`` would have shown.

    Args:
        features: Of each shape.
        shapes: As the detector resolved them.
        workspace: (low, high) corners, metres, base frame, that bound points in the base frame.
        max_age: Seconds at which ``age`` saturates.
    """

    def __init__(
        self, features: Sequence[Feature], shapes: Sequence[Configuration], workspace: Any, max_age: float
    ) -> None:
        self._features, self._shapes = tuple(features), tuple(shapes)
        self._workspace, self._max_age = workspace, max_age
        self._vector: FeatureVector | None = None
        self._values: list[Column] = []
        self._measured: list[Column] = []

    def add(self, moment: Moment, detection: Detection) -> None:
        """Take a frame.

        Raises:
            ValueError: A feature lacks what it needs, such as depth or the camera's place.
        """
        # Inside, since it brings gymnasium.
        from shape_obs.wrappers.env_protocol import base_point

        if not self._features:
            return
        height, width = moment.frame.size or (1, 1)
        view = View(width, height, moment.frame.camera, self._workspace, self._max_age, anchors=moment.anchors)
        if self._vector is None:
            self._vector = FeatureVector(self._features, self._shapes, view)
        views = [replace(view, anchor=base_point(shape, moment.anchors)) for shape in self._shapes]
        self._values.append(self._vector.compute(detection.shapes, views))
        self._measured.append(self._vector.measured(detection.shapes))

    def columns(self) -> dict[str, Column]:
        """``<shape>/features/<kind>`` (F,D) float32 and, beside each, ``.../measured`` (F,D) bool."""
        if self._vector is None:
            return {}
        values, measured = np.stack(self._values), np.stack(self._measured)
        columns = {}
        for name, block in _named(self._vector.blocks):
            columns[name] = values[:, block.place]
            columns[f"{name}/measured"] = measured[:, block.place]
        return columns

    def described(self) -> dict[str, Any]:
        """Column -> ``feature``, the spec as a mapping, and ``units`` of each value; JSON-able."""
        blocks = () if self._vector is None else self._vector.blocks
        return {
            name: {"feature": block.feature.to_dict(), "units": list(block.units)} for name, block in _named(blocks)
        }


def _named(blocks: Iterable[Block]) -> Iterable[tuple[str, Block]]:
    """Blocks with the names of their columns; a second one of a kind is numbered."""
    seen: Counter[str] = Counter()
    for block in blocks:
        name = f"{block.shape}/features/{block.feature.kind}"
        seen[name] += 1
        yield name if seen[name] == 1 else f"{name}_{seen[name]}", block


_NOWHERE: Final = {"points2d": 2, "points3d": 3}


@dataclass(frozen=True)
class Extraction:
    """What to find in every episode, and where to write it. Is pickled to other processes.

    Args:
        config: As ``load_config`` gives it, features included.
        out: The dataset's folder.
        open: Opens a recording, such as ``shape_obs_envs.sources.open_source``, with ``extrinsics``; of a recorded
            folder the part ``frames=(first, count)``.
        extrinsics: A file that says where the camera stands; wins over recorded places.
        frames: How many at most, of each episode.

    Raises:
        ValueError: By ``made_with`` and ``work``: something of the config is not understood.
    """

    config: Mapping[str, Any]
    out: Path
    open: Callable[..., RGBDSource]
    extrinsics: Path | None = None
    frames: int | None = None

    def made_with(self) -> dict[str, Any]:
        """All that the numbers depend on but the recordings; JSON-able. Equal for all parts of a dataset.

        The backend is part of it, since NumPy and Numba agree to a thousandth of a pixel, not to the bit.
        """
        place = None if self.extrinsics is None else hashlib.sha256(self.extrinsics.read_bytes()).hexdigest()
        return {
            "shape_obs": __version__,
            "config_hash": config_hash(self.config),
            "schema_hash": schema_hash(self.config),
            "backend": "numba" if self.detector().kernels.compiled else "numpy",
            "extrinsics": place,
            "frames": self.frames,
        }

    def detector(self) -> ShapeDetector:
        """A new one. It goes on where a policy would be stopped: a lost shape is a row that is not ok."""
        given = detector_arguments(self.config)
        return ShapeDetector(**{**given, "on_missing": "nan"} if given.get("on_missing") == "raise" else given)


def work(job: Extraction, made_with: Mapping[str, Any], task: Task) -> Outcome:
    """Find the shapes of an episode and write them, unless that was done before.

    Args:
        job: What to find.
        made_with: Of the job.
        task: The episode.

    Returns:
        What became of it. Whatever goes wrong with an episode is told there, and no other one is lost with it.
    """
    part = job.out / task.part
    for temporary in job.out.glob(f".{task.part}.*"):  # of a run that was killed
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
        said = [" ".join(str(warning.message).split()) for warning in caught if warning.category is UserWarning]
        table.save(part)
    except Exception as error:  # noqa: BLE001 - whatever it was, the other episodes go on
        if read:
            part.unlink(missing_ok=True)  # of what the recording was before
        reason = " ".join(str(error).split())
        expected = isinstance(error, (OSError, ValueError)) and reason
        return Outcome(task, "failed", reason=reason if expected else f"{type(error).__name__}: {reason}")
    return Outcome(task, "done", len(table), table.metadata["ok"], warnings=tuple(dict.fromkeys(said)))


def _kept(part: Path, made: Mapping[str, Any], task: Task) -> Outcome | None:
    """Return the outcome of an earlier run; None where its part is damaged, or made of something else."""
    if not part.exists():
        return None
    try:
        known = ShapeTable.load(part).metadata  # verifies all of it
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
    columns = {"source": np.full(len(shapes), task.source), **_whole(shapes.columns, log.metadata["shapes"])}
    # Nothing of when or by which process it was made: equal recordings make equal files.
    told = {name: value for name, value in log.metadata.items() if name not in ("created", "software")}
    told |= {"source": {"kind": source.kind, "name": task.source}, "frames": len(shapes), "made_with": dict(made)}
    told |= {"ok": {name: int(shapes[f"{name}/ok"].sum()) for name in log.metadata["shapes"]}}
    told |= {"features": collected.described()}
    return ShapeTable({**columns, **collected.columns()}, told)


def _whole(columns: Mapping[str, Column], sizes: Mapping[str, int]) -> dict[str, Column]:
    """The columns that every part has, whatever its recording lacks; without times of the machine that read it."""
    found = {name: column for name, column in columns.items() if name != "received"}
    for name, size in sizes.items():
        for kind, axes in _NOWHERE.items():
            found.setdefault(f"{name}/{kind}", np.full((len(columns["frame"]), size, axes), np.nan, np.float32))
    first = [name for name in found if "/" not in name]
    return {name: found[name] for name in [*first, *sorted(set(found) - set(first))]}
