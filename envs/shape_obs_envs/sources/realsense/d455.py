"""What one D455 is like: its lenses in each mode, how its cameras stand to each other, and what can be set."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from shape_obs.camera import Intrinsics
from shape_obs_envs.sources.realsense.geometry import Geometry

#: Both sensors have 1280 x 800 pixels. Colour as a real unit tells it; its coefficients are another unit's
#: (https://github.com/realsenseai/librealsense/issues/9551). Depth is rectified inside the camera.
_COLOUR: Final = Intrinsics(
    1280,
    800,
    636.5,
    635.9,
    644.4,
    407.8,
    "inverse_brown_conrady",
    (-0.0565362684428692, 0.068201869726181, 0.0003659751964733, 0.000692575704306364, -0.0218431670218706),
)
_DEPTH: Final = Intrinsics(1280, 800, 643.8, 643.8, 639.2, 400.7)
#: From the depth camera to the colour camera: 59 mm to the left, turned by some tenths of a degree.
_TURN: Final = (0.0021, -0.0034, 0.0012)  # radians about x, y, z
_SHIFT: Final = (-0.059, 0.0001, 0.0004)  # metres

NAME: Final = "Intel RealSense D455"
INFO: Final = {
    "name": NAME,
    "firmware_version": "5.16.0.1",
    "recommended_firmware_version": "5.16.0.1",
    "product_id": "0B5C",
    "product_line": "D400",
}
#: sensor -> option -> (least, most, step, default), as `rs-enumerate-devices -o` prints them
OPTIONS: Final = {
    "depth": {
        "enable_auto_exposure": (0, 1, 1, 1),
        "exposure": (1, 200_000, 1, 33_000),
        "gain": (16, 248, 1, 16),
        "visual_preset": (0, 5, 1, 0),
        "laser_power": (0, 360, 30, 150),
        "emitter_enabled": (0, 2, 1, 1),
        "global_time_enabled": (0, 1, 1, 1),
    },
    "colour": {
        "enable_auto_exposure": (0, 1, 1, 1),
        "exposure": (1, 10_000, 1, 156),
        "gain": (0, 128, 1, 64),
        "enable_auto_white_balance": (0, 1, 1, 1),
        "white_balance": (2800, 6500, 10, 4600),
        "auto_exposure_priority": (0, 1, 1, 1),
        "global_time_enabled": (0, 1, 1, 1),
    },
}
BASELINE: Final = 95.0  # millimetres, between the two imagers of depth


def d455_geometry(width: int, height: int, depth_unit: float) -> Geometry:
    """The geometry of a D455 in a mode: its sensors scaled to cover the image, and cropped about the middle.

    At 640 x 480 that is a scale of 0.6, and 64 columns off at either side.
    """
    return Geometry(
        _in_mode(_COLOUR, width, height),
        _in_mode(_DEPTH, width, height),
        np.asarray(cv2.Rodrigues(np.asarray(_TURN))[0], np.float64),
        np.asarray(_SHIFT, np.float64),
        depth_unit,
    )


def _in_mode(sensor: Intrinsics, width: int, height: int) -> Intrinsics:
    scale = max(width / sensor.width, height / sensor.height)
    left, top = (scale * sensor.width - width) / 2, (scale * sensor.height - height) / 2
    return Intrinsics(
        width,
        height,
        scale * sensor.fx,
        scale * sensor.fy,
        scale * sensor.cx - left,
        scale * sensor.cy - top,
        sensor.model,
        sensor.coeffs,
    )
