"""RawFrame: one pair of images as the sensors gave them, copied out of librealsense."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.source import SourceError
from shape_obs_envs.sources.realsense.driver import librealsense

#: librealsense counts the colour camera's exposure in these units, and the depth camera's in microseconds.
_COLOUR_EXPOSURE_UNIT: Final = 1e-4
_DEPTH_EXPOSURE_UNIT: Final = 1e-6
#: A time of arrival that lies farther back than this is no such time (a recording, a clock that was set).
_LONGEST_WAY: Final = 5.0


@dataclass(frozen=True)
class RawFrame:
    """A colour and a depth image of the same moment.

    Args:
        colour: (H,W,3) uint8 RGB, with the lens' distortion.
        depth: (H,W) uint16 in the camera's depth unit, seen from the depth camera.
        stamp: Of the colour image, by the camera's clock, seconds.
        received: When the pair reached this machine: ``time.monotonic()``, seconds.
        exposed: When its exposure began, at the earliest: ``time.monotonic()``, seconds.
        number: The colour camera's count of its frames.
    """

    colour: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.uint16]
    stamp: float
    received: float
    exposed: float
    number: int


def colour_image(frame: Any) -> npt.NDArray[np.uint8]:
    """A copy of a colour frame as RGB: (H,W,3) uint8.

    Raises:
        SourceError: A pixel format that is no colour.
    """
    formats, pixels = librealsense().format, np.asanyarray(frame.get_data())
    given = frame.get_profile().format()
    if given == formats.rgb8:
        return np.array(pixels, np.uint8)
    codes = {formats.bgr8: cv2.COLOR_BGR2RGB, formats.rgba8: cv2.COLOR_RGBA2RGB, formats.bgra8: cv2.COLOR_BGRA2RGB}
    if given in codes:
        return np.asarray(cv2.cvtColor(pixels, codes[given]), np.uint8)
    if given == formats.yuyv:
        size = frame.get_height(), frame.get_width()
        return np.asarray(cv2.cvtColor(pixels.view(np.uint8).reshape(*size, 2), cv2.COLOR_YUV2RGB_YUYV), np.uint8)
    raise SourceError(f"The colour stream's format is {given}; expected rgb8, bgr8, rgba8, bgra8 or yuyv.")


def depth_image(frame: Any) -> npt.NDArray[np.uint16]:
    """A copy of a depth frame: (H,W) uint16 in the camera's depth unit."""
    return np.array(np.asanyarray(frame.get_data()), np.uint16)


def arrival(frame: Any, now: float) -> float:
    """When a frame reached librealsense: ``time.monotonic()``, seconds, at most ``now``.

    A thread that waited for the processor takes a frame out late; librealsense noted when it came, by the wall clock.
    """
    kind = librealsense().frame_metadata_value.time_of_arrival
    if not frame.supports_frame_metadata(kind):
        return now
    waited = time.time() - frame.get_frame_metadata(kind) / 1000
    return now - waited if 0 <= waited < _LONGEST_WAY else now


def exposure_began(colour: Any, depth: Any, received: float, interval: float, latency: float | None) -> float:
    """When the exposure of a pair began, at the earliest: ``time.monotonic()``, seconds.

    With librealsense's global time a frame's stamp is the end of its exposure by this machine's clock, and its
    metadata tell how long that was. Without it nobody knows how long the frame was under way, and ``latency`` is taken.

    Args:
        colour: The colour frame.
        depth: The depth frame.
        received: When the pair came, ``time.monotonic()``.
        interval: Seconds between frames.
        latency: Seconds from the beginning of the exposure to the arrival, at most; None for two intervals.
    """
    rs = librealsense()
    frames = ((colour, _COLOUR_EXPOSURE_UNIT), (depth, _DEPTH_EXPOSURE_UNIT))
    if any(frame.get_frame_timestamp_domain() != rs.timestamp_domain.global_time for frame, _ in frames):
        return received - (2 * interval if latency is None else latency)
    to_monotonic = time.monotonic() - time.time()
    began = [frame.get_timestamp() / 1000 + to_monotonic - _exposure(frame, unit, interval) for frame, unit in frames]
    return min(*began, received)


def _exposure(frame: Any, unit: float, interval: float) -> float:
    """Seconds of exposure; the whole interval where the frame does not tell, since no exposure is longer."""
    kind = librealsense().frame_metadata_value.actual_exposure
    if not frame.supports_frame_metadata(kind):
        return interval
    return min(frame.get_frame_metadata(kind) * unit, interval)
