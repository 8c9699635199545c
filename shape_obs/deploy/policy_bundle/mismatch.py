"""Where an environment is another one than a policy was trained in, place by place."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import zip_longest
from typing import Any, Final

from shape_obs.config import DetectorConfig, detector_arguments
from shape_obs.deploy.policy_bundle.record import Surroundings
from shape_obs.deploy.policy_bundle.spaces import layout_differences
from shape_obs.features import Feature, read_features
from shape_obs.robot import ActionSpec

Difference = tuple[str, Any, Any]
_ACTION: Final = ("names", "units", "scale", "mode", "frame")


def differences(trained: Surroundings, here: Surroundings, *, same_rate: bool = True) -> list[Difference]:
    """What a policy would read or do otherwise: (place, trained, here).

    Colours, regions, workspaces and the camera's place may differ: those are each site's own.

    Args:
        trained: What the policy was trained in.
        here: What it is to run in.
        same_rate: Whether steps must take as long.
    """
    found = [*_of_schema(trained.config, here.config), *_of_camera(trained, here)]
    found += layout_differences(trained.observation_space, here.observation_space, "observation")
    found += _of_actions(trained.action_spec, here.action_spec)
    if same_rate and abs(trained.dt - here.dt) > 1e-3 * trained.dt:
        found.append(("dt [s]", round(trained.dt, 6), round(here.dt, 6)))
    return found


def told(found: list[Difference]) -> str:
    """All of them in one line."""
    return "; ".join(f"{place}: {one!r} in training, {other!r} here" for place, one, other in found)


def _of_schema(trained: Mapping[str, Any] | None, here: Mapping[str, Any] | None) -> Iterator[Difference]:
    """What of the ``shape`` sections differs."""
    if trained is None or here is None:
        if trained is not here:
            yield "ShapeObservation", trained is not None, here is not None
        return
    yield from _walk(_schema(trained), _schema(here), "")


def _schema(config: Mapping[str, Any]) -> dict[str, Any]:
    """What ``schema_hash`` is made of."""
    detector = DetectorConfig.from_dict(detector_arguments(config))
    shapes = [shape.to_dict() for shape in detector.resolved()]
    return {
        "shapes": [{name: value for name, value in shape.items() if name != "segmentation"} for shape in shapes],
        "features": [feature.identity() for feature in _features(config)],
        "clustering": detector.clustering.to_dict(),
    }


def _of_camera(trained: Surroundings, here: Surroundings) -> Iterator[Difference]:
    """What a camera must have for features in pixels: images of the same size."""
    features = [] if trained.config is None else _features(trained.config)
    if any(feature.unit == "px" for feature in features) and trained.image != here.image:
        yield "image size [px]", trained.image, here.image


def _of_actions(trained: ActionSpec | None, here: ActionSpec | None) -> Iterator[Difference]:
    if trained is None or here is None:
        if trained is not here:
            yield "known action_spec", trained is not None, here is not None
        return
    one, other = trained.to_dict(), here.to_dict()
    for name in _ACTION:
        if one[name] != other[name]:
            yield f"action {name}", one[name], other[name]


def _features(config: Mapping[str, Any]) -> list[Feature]:
    return read_features(config["features"])


def _walk(trained: Any, here: Any, where: str) -> Iterator[Difference]:
    """Leaves of JSON values that differ."""
    if isinstance(trained, Mapping) and isinstance(here, Mapping):
        if trained.get("kind") != here.get("kind"):
            yield f"{where} kind", trained.get("kind"), here.get("kind")
            return
        for name in {**trained, **here}:
            yield from _walk(trained.get(name), here.get(name), f"{where}.{name}" if where else name)
    elif isinstance(trained, list) and isinstance(here, list):
        if len(trained) != len(here) and not all(isinstance(item, Mapping) for item in trained + here):
            yield where, trained, here
            return
        for i, (one, other) in enumerate(zip_longest(trained, here)):
            yield from _walk(one, other, f"{where}[{i}]")
    elif trained != here:
        yield where, trained, here
