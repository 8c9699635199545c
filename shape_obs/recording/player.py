"""replay: a source through a detector."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from shape_obs.detector import ShapeDetector
from shape_obs.features import read_features
from shape_obs.recording.moment import Moment, read_moments
from shape_obs.segmentation import DepthRange
from shape_obs.shape import Detection
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
