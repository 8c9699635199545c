"""How often each colour occurs on the object and elsewhere, and the points and the cloud in space."""

from __future__ import annotations

from typing import Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.frame import depth_in_metres
from shape_obs.image.segmentation import HUES
from shape_obs.tuner.result import Result

#: Channels of a histogram, with the number of their levels.
CHANNELS: Final = {"Hue": HUES, "Saturation": 256, "Brightness": 256}
_BINS: Final = 45
_MOST: Final = 6000  # points of a cloud
_OWN: Final = 2000  # points of the object more


class Histogram(NamedTuple):
    """How often the values of a channel occur.

    Args:
        centres: ``(45,)`` values at the middle of each bin.
        inside: ``(45,)`` percent of the object's pixels.
        outside: ``(45,)`` percent of all other pixels.
    """

    centres: npt.NDArray[np.float64]
    inside: npt.NDArray[np.float64]
    outside: npt.NDArray[np.float64]


def histogram(result: Result, channel: str) -> Histogram:
    """Return the histogram of a channel on the object and elsewhere in a frame.

    Args:
        result: What was found.
        channel: A key of ``CHANNELS``.
    """
    hsv = np.asarray(cv2.cvtColor(result.picture()[::2, ::2], cv2.COLOR_RGB2HSV), np.uint8)
    values = hsv[..., list(CHANNELS).index(channel)]
    inside = result.mask[::2, ::2] > 0
    edges = np.linspace(0, CHANNELS[channel], _BINS + 1)
    return Histogram((edges[:-1] + edges[1:]) / 2, _percent(values[inside], edges), _percent(values[~inside], edges))


def _percent(values: npt.NDArray[np.uint8], edges: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return 100 * np.histogram(values, edges)[0] / max(values.size, 1)


class Cloud(NamedTuple):
    """The cloud of a frame.

    Args:
        points: ``(M, 3)`` metres in the camera's optical frame.
        colours: ``(M, 3)`` RGB, 0...1; the object's are tinted.
        inside: ``(M,)`` bool: on the object.
        size: Metres from one of the other points to the next.
    """

    points: npt.NDArray[np.float64]
    colours: npt.NDArray[np.float64]
    inside: npt.NDArray[np.bool_]
    size: float


def cloud_of(result: Result) -> Cloud | None:
    """Return some thousand points of the frame in space; None without depth or camera."""
    frame = result.moment.frame
    if frame.depth is None or frame.camera is None:
        return None
    height, width = frame.depth.shape
    step = max(round((height * width / _MOST) ** 0.5), 1)
    v, u = np.mgrid[step // 2 : height : step, step // 2 : width : step].reshape(2, -1)
    own_v, own_u = np.nonzero(result.mask)
    own = slice(None, None, len(own_v) // _OWN + 1)
    u, v = np.concatenate([u, own_u[own]]), np.concatenate([v, own_v[own]])
    z = depth_in_metres(frame.depth[v, u])
    known = np.isfinite(z)
    u, v, z = u[known], v[known], z[known]
    points = frame.camera.intrinsics.deproject(np.stack([u, v], axis=1).astype(np.float64), z)
    colours = result.picture()[v, u] / 255.0
    inside = result.mask[v, u] > 0
    colours[inside] = 0.4 * colours[inside] + 0.6 * np.array([1.0, 0.25, 0.7])
    near = np.isfinite(points).all(axis=1)
    size = step * float(np.median(z)) / frame.camera.intrinsics.fx if len(z) else 0.0
    return Cloud(points[near], colours[near], inside[near], size)
