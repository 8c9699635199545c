"""The arguments of ``ShapeObservation``: as JSON values that rebuild it, and checked."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from shape_obs.camera import CameraModel
from shape_obs.config.detector_config import DetectorConfig
from shape_obs.configurations.base import Configuration
from shape_obs.image.mask_function import MaskFunction
from shape_obs.spec import SpecError, did_you_mean, to_plain

#: The arguments that are not passed on to the detector.
OWN: Final = ("features", "camera", "keep", "rgb_key", "depth_key", "workspace")


def to_recorded(value: Any) -> Any:
    """Return a constructor argument as JSON values, so that ``gym.make(env.spec)`` rebuilds the wrapped env.

    Specs, cameras, arrays and iterables become dicts, lists and scalars; a function becomes its import path.

    Raises:
        SpecError: A function has no import path.
    """
    if isinstance(value, CameraModel):
        transform = value.transform_camera_to_base
        return {"intrinsics": value.intrinsics.to_dict(), "transform_camera_to_base": to_plain(transform)}
    return to_plain(_with_paths(value))


def _with_paths(value: Any) -> Any:
    """Return a value with each function in it, at any depth, replaced by its import path."""
    if isinstance(value, Mapping):
        return {name: _with_paths(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_with_paths(item) for item in value]
    return MaskFunction(value).to_dict()["function"] if callable(value) and not isinstance(value, type) else value


def check_names(arguments: Iterable[str]) -> None:
    """Reject arguments that neither the wrapper nor the detector has.

    Raises:
        SpecError: The message suggests the nearest known name.
    """
    known = [*(field.name for field in dataclasses.fields(DetectorConfig)), *OWN]
    for name in arguments:
        if name not in known and name != "backend":  # an old name, which ``DetectorConfig`` ignores with a warning
            raise SpecError(f"ShapeObservation: unknown argument {name!r}{did_you_mean(name, known)}")


def check_shapes(shapes: Sequence[Configuration]) -> None:
    """Reject shapes that an observation cannot hold or find.

    Args:
        shapes: The configurations, the detector's defaults filled in, before slots are made of a ``count``.

    Raises:
        ValueError: One has no fixed number of slots, or no segmentation.
    """
    for shape in shapes:
        if shape.count == "all":
            raise ValueError(
                f"shape {shape.name!r}: count='all' has no fixed number of slots, as an observation needs; give a "
                "number, or use ShapeDetector."
            )
        if shape.segmentation is None:
            raise ValueError(
                f"ShapeObservation: shape {shape.name!r} has no segmentation, so no frame would be understood. Pass "
                "segmentation=HSVRange(low=..., high=...), a function (rgb, depth) -> mask, or what `shape-obs detect "
                "IMAGE --pick u,v` writes (**load_config('shape.yaml')); or let the env publish one in "
                "shape_obs_defaults."
            )
