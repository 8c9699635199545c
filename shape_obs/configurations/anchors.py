"""Anchors: where point 0 belongs, from a name, a pixel or a place in the base frame to what a body is numbered by."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel
from shape_obs.configurations.base import Configuration
from shape_obs.spec import did_you_mean
from shape_obs.tracking.scene import Anchors
from shape_obs.utils.lengths import MOST

Array = npt.NDArray[np.float64]


def anchor_pixel(spec: Configuration, anchors: Anchors, camera: CameraModel | None) -> Array | None:
    """Return the ``(2,)`` pixel of a configuration's anchor; None without one.

    Raises:
        ValueError: An unknown name, no finite place, or one in the base frame that the camera cannot be asked for.
    """
    point, text = _point(spec, anchors)
    if point is None or len(point) == 2:
        return point
    camera = _placed(camera, text, "an anchor in pixels (u, v)")
    pixel = camera.project_from_base(point)
    if not np.all(np.isfinite(pixel)):
        raise ValueError(f"{text} does not lie in front of the camera.")
    return pixel


def anchor_point(spec: Configuration, anchors: Anchors, camera: CameraModel | None) -> Array | None:
    """Return the ``(3,)`` point of a configuration's anchor in the frame of a cloud, metres; None without one.

    With a camera the cloud is in its frame, and anchors in the base frame are moved there; without one anchors are in
    the cloud's own frame.

    Raises:
        ValueError: An unknown name, no finite place, a pixel, or a camera whose place is unknown.
    """
    point, text = _point(spec, anchors)
    if point is not None and len(point) == 2:
        raise ValueError(f"{text} is a pixel, and a cloud has none: give (x, y, z).")
    if point is None or camera is None:
        return point
    return _placed(camera, text, "no camera and an anchor in the cloud's frame").from_base(point)


def _point(spec: Configuration, anchors: Anchors) -> tuple[Array | None, str]:
    """Return the anchor as a finite ``(2,)`` or ``(3,)`` array, None without one; and what to call it in messages."""
    anchor: Any = spec.anchor
    if isinstance(anchor, str):
        known = anchors or {}
        if anchor not in known:
            raise ValueError(f"shape {spec.name!r}: anchor {anchor!r} was not given{did_you_mean(anchor, known)}")
        anchor = known[anchor]
    if anchor is None:
        return None, ""
    point = np.asarray(anchor, dtype=np.float64)
    if point.shape not in ((2,), (3,)) or not np.all(np.isfinite(point)):
        raise ValueError(f"shape {spec.name!r}: anchor must be a finite (u, v) or (x, y, z), got {anchor!r}.")
    if len(point) == 3 and np.abs(point).max() > MOST:  # in the same words each time: Python shows equal warnings once
        text = f"shape {spec.name!r}: anchor {spec.anchor!r} lies more than {MOST:g} m from the base"
        warnings.warn(f"{text}: is it in millimetres? Give metres.", stacklevel=4)
    return point, f"shape {spec.name!r}: anchor {anchor!r}"


def _placed(camera: CameraModel | None, text: str, instead: str) -> CameraModel:
    """Return a camera whose place in the base frame is known."""
    if camera is None or camera.transform_camera_to_base is None:
        raise ValueError(
            f"{text} in the base frame needs the camera's place there: give "
            f"camera=CameraModel(intrinsics, transform_camera_to_base=T), or {instead}."
        )
    return camera
