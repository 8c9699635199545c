"""Geometry: the lenses of a running pipeline, and how its two cameras stand to each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import Distortion, Intrinsics
from shape_obs.source import SourceError
from shape_obs_envs.sources.realsense.driver import librealsense

#: A recording keeps the pose with six digits, turned round and back. Cut to what survives that, a camera and its
#: recording are registered alike, to the last pixel. It is 0.5 microradians and 5 micrometres.
_ROTATION_DIGITS: Final = 6
_TRANSLATION_DIGITS: Final = 5


@dataclass(frozen=True)
class Geometry:
    """What the raw images of a pair mean.

    Args:
        colour: Of the raw colour image.
        depth: Of the raw depth image.
        rotation: (3,3), ``p_colour = rotation p_depth + translation``.
        translation: (3,) metres.
        depth_unit: Metres of 1 in the raw depth image.
    """

    colour: Intrinsics
    depth: Intrinsics
    rotation: npt.NDArray[np.float64]
    translation: npt.NDArray[np.float64]
    depth_unit: float

    @classmethod
    def of(cls, profile: Any) -> Geometry:
        """The geometry of a pipeline that runs.

        Args:
            profile: The ``pipeline_profile`` that its start gave, with a colour and a depth stream.

        Raises:
            SourceError: A lens model that nobody has described here, or no depth sensor.
        """
        rs = librealsense()
        colour, depth = (
            profile.get_stream(stream).as_video_stream_profile() for stream in (rs.stream.color, rs.stream.depth)
        )
        pose = depth.get_extrinsics_to(colour)
        return cls(
            colour=intrinsics_of(colour.get_intrinsics()),
            depth=intrinsics_of(depth.get_intrinsics()),
            rotation=np.round(np.reshape(pose.rotation, (3, 3)), _ROTATION_DIGITS).T,  # librealsense counts by columns
            translation=np.round(pose.translation, _TRANSLATION_DIGITS),
            depth_unit=_depth_unit(profile.get_device()),
        )


def intrinsics_of(lens: Any) -> Intrinsics:
    """``rs.intrinsics`` -> `Intrinsics`.

    Raises:
        SourceError: A lens model that nobody has described here.
    """
    coefficients = tuple(float(value) for value in lens.coeffs)
    return Intrinsics(
        int(lens.width),
        int(lens.height),
        float(lens.fx),
        float(lens.fy),
        float(lens.ppx),
        float(lens.ppy),
        model=_model(lens.model, any(coefficients)),
        coeffs=coefficients,
    )


def _model(model: Any, bent: bool) -> Distortion:
    distortion = librealsense().distortion
    if not bent or model == distortion.none:
        return "pinhole"
    if model == distortion.brown_conrady:
        return "brown_conrady"
    if model in (distortion.inverse_brown_conrady, distortion.modified_brown_conrady):
        return "inverse_brown_conrady"  # librealsense projects with both in the same way
    raise SourceError(f"The camera's lens model is {model}; expected one of the Brown-Conrady models.")


def _depth_unit(device: Any) -> float:
    option = librealsense().option.depth_units
    for sensor in device.query_sensors():
        if sensor.supports(option):  # as_depth_sensor() would do, but not while librealsense records
            return float(f"{sensor.get_option(option):.6g}")  # a float32 inside: 0.001 comes as 0.0010000000475
    raise SourceError("The camera has no depth sensor.")
