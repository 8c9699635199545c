"""Run a detector on a source, and collect its detections in a table."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from shape_obs.config.config_file import config_hash, dump_config, schema_hash
from shape_obs.config.detector_config import ALGORITHM
from shape_obs.detector import ShapeDetector
from shape_obs.extrinsics import now
from shape_obs.features import read_features
from shape_obs.features.feature import what_needs_depth
from shape_obs.recording.format import Moment, Transition, camera_to_dict, read_moments
from shape_obs.recording.table import Column, ShapeTable, step_columns
from shape_obs.recording.writer import software
from shape_obs.shape import Detection, Shape
from shape_obs.source import RGBDSource


def replay(
    source: RGBDSource, detector: ShapeDetector, frames: int | None = None
) -> Iterator[tuple[Moment, Detection]]:
    """Detect the shapes in every frame of a source. The detector is reset at the start and at each new episode.

    Replaying a recorded folder gives exactly the shapes of the original frames.

    Args:
        source: The source; it is connected if necessary.
        detector: The detector; its track is discarded.
        frames: Largest number of frames.

    Raises:
        SourceError: The source fails; ``BadRecording`` for a damaged file.
        ValueError: ``detector.detect`` fails: an anchor is unknown, or a shape needs depth.
    """
    episode = None
    for moment in read_moments(source, frames):
        if moment.episode != episode:
            detector.reset()
            episode = moment.episode
        frame = moment.frame
        yield (
            moment,
            detector.detect(frame.rgb, frame.depth, frame.camera, stamp=frame.stamp, anchors=moment.anchors),
        )


def check_depth(source: RGBDSource, detector: ShapeDetector, arguments: Mapping[str, Any]) -> None:
    """Refuse a source without depth or intrinsics if the configuration needs them.

    Args:
        source: A connected source.
        detector: A detector made from the configuration.
        arguments: The configuration, as ``load_config`` returns it.

    Raises:
        ValueError: The message lists everything that needs the missing depth or intrinsics.
    """
    features = read_features(arguments.get("features") or ())
    needs = what_needs_depth(detector.shapes, features)
    missing = "depth" if not source.has_depth else "intrinsics" if source.intrinsics is None else ""
    if needs and missing:
        raise ValueError(
            f"{source.name} has no {missing}, but the config needs it: {', '.join(needs)}. "
            "Replay a recording with depth, or use features in pixels and spacing='px'."
        )


class ShapeLog:
    """Collect detections in memory, about 0.5 kB per frame with twenty points.

    Args:
        detector: The detector that makes the detections.
        arguments: Configuration from which it was made, including features, as ``load_config`` returns it; default:
            the configuration of the detector.
        source: The connected source of the frames.

    Attributes:
        metadata: JSON values: ``config`` (YAML), ``schema_hash``, ``config_hash``, ``shapes`` (number of points by
            name), ``source``, ``camera``, ``robot`` (names of actions and states, if there are any), ``created``,
            ``software``, ``algorithm`` (the version of the detector's).
    """

    metadata: dict[str, Any]

    def __init__(
        self, detector: ShapeDetector, arguments: Mapping[str, Any] | None = None, source: RGBDSource | None = None
    ) -> None:
        given = detector.config.to_dict() if arguments is None else arguments
        robot = getattr(source, "robot_info", None)
        self.metadata = {
            "config": dump_config(given),
            "schema_hash": schema_hash(given),
            "config_hash": config_hash(given),
            "shapes": {spec.name: spec.layout.size for spec in detector.shapes},
            "source": None if source is None else {"kind": source.kind, "name": source.name},
            "camera": None if source is None else camera_to_dict(source.camera),
            "robot": robot and robot.to_dict(),
            "created": now(),
            "software": software(),
            "algorithm": ALGORITHM,
        }
        self._rows: defaultdict[str, list[Any]] = defaultdict(list)
        self._transitions: list[Transition | None] = []
        self._states: list[tuple[float, ...] | None] = []

    def __len__(self) -> int:
        return len(self._rows["frame"])

    def add(self, moment: Moment, detection: Detection) -> None:
        """Add a frame; points of a shape that is not ok become NaN."""
        frame, rows = moment.frame, self._rows
        self._transitions.append(moment.transition)
        self._states.append(moment.state)
        rows["frame"].append(len(self))
        rows["number"].append(-1 if frame.number is None else frame.number)
        rows["episode"].append(moment.episode)
        rows["stamp"].append(detection.stamp)
        rows["received"].append(np.nan if frame.received is None else frame.received)
        rows["warning"].append(detection.warning)
        for shape in detection:
            for name in ("ok", "age", "quality", "reason", "track_id", "new", "visible", "valid", "sigma"):
                rows[f"{shape.name}/{name}"].append(getattr(shape, name))
            rows[f"{shape.name}/length"].append(np.nan if shape.length is None else shape.length)
            rows[f"{shape.name}/points2d"].append(_points(shape, shape.points2d))
            rows[f"{shape.name}/points3d"].append(_points(shape, shape.points3d))

    def table(self) -> ShapeTable:
        """Return the collected detections as a table.

        Raises:
            ValueError: No frame was added.
        """
        if not len(self):
            raise ValueError("no frame was added, so the table would be empty.")
        columns = {}
        for name, values in self._rows.items():
            column = _column(name, values, self.metadata["shapes"])
            if column is not None:
                columns[name] = column
        if any(self._transitions) or any(self._states):
            columns |= step_columns(self._rows["episode"], self._transitions, self._states)
        return ShapeTable(columns, {**self.metadata, "frames": len(self)})


def _points(shape: Shape, points: Column | None) -> Column | None:
    return points if points is None or shape.ok else np.full_like(points, np.nan)


def _column(name: str, values: list[Any], sizes: Mapping[str, int]) -> Column | None:
    """Return the values of a column as an array; None for points that no frame has."""
    shape, _, kind = name.rpartition("/")
    axes = {"points2d": 2, "points3d": 3}.get(kind)
    if axes is None:
        return np.array(values)
    if all(value is None for value in values):
        return None
    missing = np.full((sizes[shape], axes), np.nan, np.float32)
    return np.stack([missing if value is None else value for value in values])
