"""Read the lens of a camera from a ROS ``CameraInfo`` message."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from shape_obs.camera import Intrinsics
from shape_obs.source import BadRecording
from shape_obs_envs.sources.rectification import Rectification

#: distortion model of ROS -> the numbers of coefficients that it may have
_MODELS: Final = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14), "equidistant": (4,)}
_FISHEYE: Final = "equidistant"


def read_lens(message: Any, size: tuple[int, int], rectified: bool, topic: str) -> Rectification | None:
    """Return how to rectify the images that a ``CameraInfo`` describes; None if the camera is not calibrated.

    Args:
        message: The message.
        size: ``(H, W)`` of the images.
        rectified: Whether the images are rectified already; their intrinsics are then those of P, not of K.
        topic: The topic of the message, for errors.

    Raises:
        BadRecording: It describes images of another size, a part of the image, or an unknown lens.
    """
    matrix = np.reshape(message.k, (3, 3))
    if rectified and np.any(message.p):
        matrix = np.reshape(message.p, (3, 4))[:, :3]
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0):
        return None
    if (message.height, message.width) != size:
        raise BadRecording(
            f"{topic} describes images of {message.width} x {message.height} pixels, the colour image has {size[1]} x "
            f"{size[0]}: choose the topic of this image with info=, or info=false for frames without intrinsics."
        )
    roi = message.roi
    if max(message.binning_x, message.binning_y) > 1 or roi.x_offset or roi.y_offset:
        raise BadRecording(f"{topic}: binning and regions of interest are not supported; record the whole image.")
    fx, fy, cx, cy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    pinhole = Intrinsics(size[1], size[0], fx, fy, cx, cy)
    if rectified or not np.any(message.d):
        return Rectification(pinhole, None)
    model, count = message.distortion_model, len(message.d)
    if count not in _MODELS.get(model, ()):
        raise BadRecording(
            f"{topic}: the distortion model {model!r} with {count} coefficients is not supported, expected "
            f"{', '.join(_MODELS)}: record the rectified image (image_proc), or give its topic with color=."
        )
    return Rectification.from_opencv(pinhole, np.asarray(message.d, np.float64), fisheye=model == _FISHEYE)
