"""Constructor arguments as JSON values, so that ``gym.make(env.spec)`` rebuilds the wrapped env."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np

from shape_obs import spec
from shape_obs.camera import CameraModel, Intrinsics, as_camera_model
from shape_obs.config import DetectorConfig
from shape_obs.spec import SpecError, did_you_mean

OWN: Final = ("features", "camera", "keep", "rgb_key", "depth_key", "workspace")


def plain(value: Any) -> Any:
    """Specs, cameras, arrays and iterables -> dicts, lists and scalars."""
    if isinstance(value, CameraModel):
        transform = value.transform_camera_to_base
        return {"intrinsics": value.intrinsics.to_dict(), "transform_camera_to_base": spec.plain(transform)}
    return spec.plain(value)


def check_names(arguments: Iterable[str]) -> None:
    """Refuse what is neither an argument of the wrapper nor of the detector.

    Raises:
        SpecError: The nearest known name is told.
    """
    known = [*(field.name for field in dataclasses.fields(DetectorConfig)), *OWN]
    for name in arguments:
        if name not in known:
            raise SpecError(f"ShapeObservation: unknown argument {name!r}{did_you_mean(name, known)}")


def read_camera(value: CameraModel | Intrinsics | Mapping[str, Any] | None) -> CameraModel | None:
    """A camera from what ``plain`` made of it: a camera model's mapping, or bare intrinsics'."""
    if not isinstance(value, Mapping):
        return as_camera_model(value)
    if "intrinsics" not in value:
        return CameraModel(Intrinsics.from_dict(value))
    transform = value.get("transform_camera_to_base")
    return CameraModel(Intrinsics.from_dict(value["intrinsics"]), None if transform is None else np.asarray(transform))
