"""Anchors: where point 0 belongs, from a name, a pixel or a place in the base frame to what a body is numbered by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel
from shape_obs.configurations import Configuration
from shape_obs.spec import did_you_mean

Array = npt.NDArray[np.float64]
Anchors = Mapping[str, Sequence[float]] | None


def anchor_pixel(spec: Configuration, anchors: Anchors, camera: CameraModel | None) -> Array | None:
    """Return the ``(2,)`` pixel of a configuration's anchor; None without one.

    Raises:
        ValueError: An unknown name, no finite place, or one in the base frame that the camera cannot be asked for.
    """
    if spec.anchor is None:
        return None
    point = _given(spec, anchors)
    if point is None or len(point) == 2:
        return point
    if camera is None or camera.transform_camera_to_base is None:
        raise ValueError(
            f"shape {spec.name!r}: anchor {_resolved(spec, anchors)!r} in the base frame needs the camera's place there: "
            "give camera=CameraModel(intrinsics, transform_camera_to_base=T), or an anchor in pixels (u, v)."
        )
    pixel = camera.project_from_base(point)
    if not np.all(np.isfinite(pixel)):
        raise ValueError(f"shape {spec.name!r}: anchor {_resolved(spec, anchors)!r} does not lie in front of the camera.")
    return pixel


def anchor_point(spec: Configuration, anchors: Anchors, camera: CameraModel | None) -> Array | None:
    """Return the ``(3,)`` point of a configuration's anchor in the frame of a cloud, metres; None without one.

    With a camera the cloud is in its frame, and anchors in the base frame are moved there; without one anchors are in
    the cloud's own frame.

    Raises:
        ValueError: An unknown name, no finite place, a pixel, or a camera that does not know its place.
    """
    point = _given(spec, anchors)
    if point is None:
        return None
    if len(point) == 2:
        raise ValueError(
            f"shape {spec.name!r}: anchor {_resolved(spec, anchors)!r} is a pixel, and a cloud has none: give (x, y, z)."
        )
    if camera is None:
        return point
    if camera.transform_camera_to_base is None:
        raise ValueError(
            f"shape {spec.name!r}: anchor {_resolved(spec, anchors)!r} in the base frame needs the camera's place there: "
            "give camera=CameraModel(intrinsics, transform_camera_to_base=T), or no camera and an anchor in the "
            "cloud's frame."
        )
    return camera.from_base(point)


def _given(spec: Configuration, anchors: Anchors) -> Array | None:
    """Return the anchor as a finite ``(2,)`` or ``(3,)`` array."""
    anchor = _resolved(spec, anchors)
    if anchor is None:
        return None
    point = np.asarray(anchor, dtype=np.float64)
    if point.shape not in ((2,), (3,)) or not np.all(np.isfinite(point)):
        raise ValueError(f"shape {spec.name!r}: anchor must be a finite (u, v) or (x, y, z), got {anchor!r}.")
    return point


def _resolved(spec: Configuration, anchors: Anchors) -> Any:
    """Return the anchor as it was given, its name resolved."""
    anchor: Any = spec.anchor
    if not isinstance(anchor, str):
        return anchor
    known = anchors or {}
    if anchor not in known:
        raise ValueError(f"shape {spec.name!r}: anchor {anchor!r} was not given{did_you_mean(anchor, known)}")
    return known[anchor]
