"""replay: a source through a detector.

ShapeLog: collects what a detector says, frame by frame, and makes a table of it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from shape_obs.config import config_hash, dump_config, schema_hash
from shape_obs.detector import ShapeDetector
from shape_obs.extrinsics import now
from shape_obs.features import read_features
from shape_obs.image.segmentation import DepthRange
from shape_obs.recording.format import Moment, camera_to_dict, read_moments
from shape_obs.recording.table import Column, ShapeTable
from shape_obs.recording.writer import software
from shape_obs.shape import Detection, Shape
from shape_obs.source import RGBDSource


def replay(
    source: RGBDSource, detector: ShapeDetector, frames: int | None = None
) -> Iterator[tuple[Moment, Detection]]:
    """Detect on every frame of a source. The detector starts afresh here and with each episode.

    A recorded folder gives exactly the shapes that the frames gave when they were recorded.

    Args:
        source: Is connected where it is not.
        detector: Of one's own: its track is forgotten.
        frames: How many at most.

    Raises:
        SourceError: As the source's; BadRecording for a damaged file.
        ValueError: As ``detector.detect``: an anchor that nobody told, shapes that need depth.
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
    """Refuse a source without depth, or without intrinsics, for a config that needs them.

    Args:
        source: Connected.
        detector: Made from the config.
        arguments: The config, as ``load_config`` gives it.

    Raises:
        ValueError: Something needs what the source does not have; the message tells all that does.
    """
    features = read_features(arguments.get("features") or ())
    needs = [f"feature {feature.kind!r}" for feature in features if feature.needs_depth]
    for spec in detector.shapes:
        needs += [f"lift='cloud' of shape {spec.name!r}"] if spec.lift == "cloud" else []
        needs += [f"spacing='m' of shape {spec.name!r}"] if spec.spacing == "m" else []
        needs += [f"segmentation 'depth' of shape {spec.name!r}"] if isinstance(spec.segmentation, DepthRange) else []
    missing = "depth" if not source.has_depth else "intrinsics" if source.intrinsics is None else ""
    if needs and missing:
        raise ValueError(
            f"{source.name} has no {missing}, but the config needs it: {', '.join(needs)}. "
            "Replay a recording with depth, or use features in pixels and spacing='px'."
        )


class ShapeLog:
    """Collects detections in memory: about 0.5 kB for each frame with twenty points.

    Args:
        detector: Whose detections they are.
        arguments: The config that it was made from, features included, as ``load_config`` gives it; default the
            detector's own config.
        source: Where the frames come from; connected.

    Attributes:
        metadata: JSON-able: ``config`` (YAML), ``schema_hash``, ``config_hash``, ``backend``, ``shapes`` (name ->
            number of points), ``source``, ``camera``, ``created``, ``software``.
    """

    def __init__(
        self, detector: ShapeDetector, arguments: Mapping[str, Any] | None = None, source: RGBDSource | None = None
    ) -> None:
        given = detector.config.to_dict() if arguments is None else arguments
        self.metadata: dict[str, Any] = {
            "config": dump_config(given),
            "schema_hash": schema_hash(given),
            "config_hash": config_hash(given),
            "backend": "numba" if detector.kernels.compiled else "numpy",
            "shapes": {spec.name: spec.layout.size for spec in detector.shapes},
            "source": None if source is None else {"kind": source.kind, "name": source.name},
            "camera": None if source is None else camera_to_dict(source.camera),
            "created": now(),
            "software": software(),
        }
        self._rows: defaultdict[str, list[Any]] = defaultdict(list)

    def __len__(self) -> int:
        return len(self._rows["frame"])

    def add(self, moment: Moment, detection: Detection) -> None:
        """Take a frame, whether its shapes are ok or not; points of a shape that is not ok become NaN."""
        frame, rows = moment.frame, self._rows
        rows["frame"].append(len(self))
        rows["number"].append(-1 if frame.number is None else frame.number)
        rows["episode"].append(moment.episode)
        rows["stamp"].append(detection.stamp)
        rows["received"].append(np.nan if frame.received is None else frame.received)
        for shape in detection:
            for name in ("ok", "age", "quality", "reason", "visible", "valid"):
                rows[f"{shape.name}/{name}"].append(getattr(shape, name))
            rows[f"{shape.name}/points2d"].append(_points(shape, shape.points2d))
            rows[f"{shape.name}/points3d"].append(_points(shape, shape.points3d))

    def table(self) -> ShapeTable:
        """What was collected, as columns.

        Raises:
            ValueError: Nothing was.
        """
        if not len(self):
            raise ValueError("no frame was added: there is nothing to make a table of.")
        columns = {}
        for name, values in self._rows.items():
            column = _column(name, values, self.metadata["shapes"])
            if column is not None:
                columns[name] = column
        return ShapeTable(columns, {**self.metadata, "frames": len(self)})


def _points(shape: Shape, points: Column | None) -> Column | None:
    return points if points is None or shape.ok else np.full_like(points, np.nan)


def _column(name: str, values: list[Any], sizes: Mapping[str, int]) -> Column | None:
    """An array of a column's values; None of points that no frame has."""
    shape, _, kind = name.rpartition("/")
    axes = {"points2d": 2, "points3d": 3}.get(kind)
    if axes is None:
        return np.array(values)
    if all(value is None for value in values):
        return None
    nowhere = np.full((sizes[shape], axes), np.nan, np.float32)
    return np.stack([nowhere if value is None else value for value in values])
