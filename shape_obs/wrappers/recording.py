"""Constructor arguments as JSON values, so that ``gym.make(env.spec)`` rebuilds the wrapped env."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from shape_obs.camera import CameraModel, Intrinsics, as_camera_model
from shape_obs.spec import Spec


def plain(value: Any) -> Any:
    """Specs, cameras, arrays and tuples -> dicts, lists and scalars."""
    if isinstance(value, Spec):
        return value.to_dict()
    if isinstance(value, CameraModel):
        return {
            "intrinsics": plain(value.intrinsics),
            "transform_camera_to_base": plain(value.transform_camera_to_base),
        }
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, Iterable) and not isinstance(value, str):
        return [plain(item) for item in value]
    return value


def read_camera(value: CameraModel | Intrinsics | Mapping[str, Any] | None) -> CameraModel | None:
    """A camera from what ``plain`` made of it: a camera model's mapping, or bare intrinsics'."""
    if not isinstance(value, Mapping):
        return as_camera_model(value)
    if "intrinsics" not in value:
        return CameraModel(Intrinsics.from_dict(value))
    transform = value.get("transform_camera_to_base")
    return CameraModel(Intrinsics.from_dict(value["intrinsics"]), None if transform is None else np.asarray(transform))
