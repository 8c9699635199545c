"""One run of librealsense's pipeline, from start to stop, and the raw image pairs that it delivers."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.source import BadRecording, SourceError
from shape_obs_envs.sources.realsense.devices import Device
from shape_obs_envs.sources.realsense.driver import (
    Geometry,
    Identity,
    lens_of,
    librealsense,
    recorded_streams,
    shared_modes,
)
from shape_obs_envs.sources.realsense.settings import CameraOptions, DepthFilters, Filter

#: Largest gap between the images of a pair, in frame intervals. Two free-running cameras are at most half an interval
#: apart and those of a D455 hardly at all; images that are a whole frame apart exceed this limit.
_MAX_GAP: Final = 0.75
#: librealsense reports the colour camera's exposure in this unit of a second, the depth camera's in microseconds.
_COLOUR_EXPOSURE_UNIT: Final = 1e-4
_DEPTH_EXPOSURE_UNIT: Final = 1e-6
#: Older times of arrival, in seconds, are implausible (a recording, or a clock that was set).
_LONGEST_WAIT: Final = 5.0


@dataclass(frozen=True)
class RawFrame:
    """A colour image and the depth image of the same moment, if there is one, as the sensors delivered them.

    Args:
        colour: Image of shape ``(H, W, 3)``, uint8 RGB, with the lens distortion.
        depth: Image of shape ``(H, W)``, uint16 in the camera's depth unit, seen from the depth camera; None without.
        stamp: Time of the colour image in seconds, by the camera's clock.
        received: When the pair reached this machine: ``time.monotonic()`` in seconds.
        exposed: Earliest start of its exposure: ``time.monotonic()`` in seconds.
        number: Frame counter of the colour camera.
    """

    colour: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.uint16] | None
    stamp: float
    received: float
    exposed: float
    number: int


@dataclass(frozen=True)
class Setup:
    """Requested mode and options of a camera.

    Args:
        width: Width of both images in pixels.
        height: Height of both images in pixels.
        fps: Frames per second.
        options: Exposure and other camera options.
        filters: Depth filters, run inside librealsense.
        max_gap: Largest time in seconds between the images of a pair; None for three quarters of the frame interval.
        depth: Whether to read depth; None to read it if a recording has it, and from every camera.
    """

    width: int = 640
    height: int = 480
    fps: int = 30
    options: CameraOptions = field(default_factory=CameraOptions)
    filters: Sequence[Filter] = ()
    max_gap: float | None = None
    depth: bool | None = None


class PairCheck:
    """Accept image pairs whose images are both new and of the same moment.

    When one stream stops, librealsense keeps pairing its last image with each new image of the other stream. Such a
    pair looks complete, but half of it shows the past.

    Args:
        interval: Time between frames in seconds.
        max_gap: Largest time in seconds between the images of a pair; None for three quarters of the interval.

    Attributes:
        refused: Number of consecutive pairs refused so far.
        reason: Why the last of them was refused.
    """

    def __init__(self, interval: float, max_gap: float | None = None) -> None:
        self._max_gap = _MAX_GAP * interval if max_gap is None else max_gap
        self._last: tuple[int, int | None] | None = None
        self.refused, self.reason = 0, ""

    def accepts(self, colour: int, depth: int | None, gap: float | None) -> bool:
        """Return whether a pair is accepted.

        Args:
            colour: Number of the colour frame.
            depth: Number of the depth frame; None without depth.
            gap: Time in seconds between them; None if their clocks cannot be compared.
        """
        reason = self._objection(colour, depth, gap)
        if reason is not None:
            self.refused, self.reason = self.refused + 1, reason
            return False
        self._last, self.refused = (colour, depth), 0
        return True

    def _objection(self, colour: int, depth: int | None, gap: float | None) -> str | None:
        if self._last is not None and colour == self._last[0]:
            return "the colour image was an old one"
        if self._last is not None and depth is not None and depth == self._last[1]:
            return "the depth image was an old one"
        if gap is not None and gap > self._max_gap:
            return f"colour and depth were more than {1000 * self._max_gap:.0f} ms apart"
        return None


class Session:
    """A running pipeline. It works alike for live cameras, software cameras and recordings.

    Args:
        device: The camera or recording; it is looked up again for each session.
        setup: Requested mode and options. A recording has its own.
        record_to: File to which librealsense records, or None.

    Attributes:
        depth: Whether the pairs have a depth image.
        identity: Name and serial number of the camera.
        lens: Intrinsics of the raw colour image.
        geometry: Its lenses; None without depth.
        check: Refuses pairs whose images do not belong together.

    Raises:
        SourceError: As ``Device.find``; or the camera does not have the mode, refuses an option, or is in use.
    """

    def __init__(self, device: Device, setup: Setup, record_to: Path | None = None) -> None:
        rs = librealsense()
        handle = device.find()
        self.identity, self._live, self._latency = Identity.of(handle), device.live, device.latency
        self._filter = DepthFilters(setup.filters)
        # A new config each time: a config remembers the device with which it was resolved.
        config, self._pipeline = rs.config(), rs.pipeline(rs.context())
        mode = (setup.width, setup.height) if device.live else ()
        streams = {rs.stream.color: rs.format.rgb8, rs.stream.depth: rs.format.z16}
        self.depth = setup.depth is not False
        if not device.live:
            recorded = recorded_streams(handle)
            self.depth = self.depth and (setup.depth is True or "depth" in recorded)
            if missing := {"color", *(["depth"] if self.depth else [])} - set(recorded):
                raise BadRecording(
                    f"{device.name}: expected a recording with {' and '.join(sorted(missing))}, it has "
                    f"{', '.join(recorded) or 'no streams'}."
                )
        if not self.depth:
            del streams[rs.stream.depth]
        for stream, pixels in streams.items():
            config.enable_stream(stream, *((*mode, pixels, setup.fps) if mode else ()))
        if record_to is not None:
            config.enable_record_to_file(str(record_to))
        try:
            if device.live:
                setup.options.apply(handle)
            profile, self._take = device.start(self._pipeline, config, handle)
        except RuntimeError as error:
            raise self._start_error(error, handle, setup, device) from error
        self._recorder = None if record_to is None else profile.get_device().as_recorder()
        self.interval = 1 / profile.get_stream(rs.stream.color).fps()
        self.check = PairCheck(self.interval, setup.max_gap)
        try:
            self.lens = lens_of(profile, rs.stream.color)
            self.geometry = Geometry.of(profile) if self.depth else None
        except SourceError:
            self.stop()
            raise

    def pull(self, timeout: float) -> RawFrame | None:
        """Return the next pair, or None after ``timeout`` seconds.

        The images are copies: librealsense stops streaming while too many of its own frames are held.

        Raises:
            EndOfSource: The recording has ended.
        """
        deadline = time.monotonic() + timeout
        while True:
            frames = self._take(max(deadline - time.monotonic(), 0.001))
            if frames is None:
                return None
            pair = self._pair(frames)
            if pair is not None:
                return pair
            if time.monotonic() > deadline:
                return None

    def stop(self) -> None:
        """Stop the pipeline and finish writing its recording."""
        with contextlib.suppress(RuntimeError):  # the device may be gone, and the pipeline with it
            if self._recorder is not None:
                self._recorder.pause()  # returns when everything is written; the pipeline's stop does not wait
            self._pipeline.stop()
        del self._take, self._pipeline, self._recorder  # they hold the device and the file

    def _pair(self, frames: Any) -> RawFrame | None:
        now = time.monotonic()
        colour, depth = frames.get_color_frame(), frames.get_depth_frame() if self.depth else None
        if not colour or (self.depth and not depth):
            return None
        number = int(colour.get_frame_number())
        if depth is None:
            accepted = self.check.accepts(number, None, None)
        else:
            accepted = self.check.accepts(number, int(depth.get_frame_number()), _gap(colour, depth))
        if not accepted:
            return None
        received = _arrival(colour, now) if self._live else now
        return RawFrame(
            colour=_colour_image(colour),
            depth=None if depth is None else np.array(np.asanyarray(self._filter(depth).get_data()), np.uint16),
            stamp=colour.get_timestamp() / 1000,
            received=received,
            exposed=_exposure_start(colour, depth, received, self.interval, self._latency),
            number=number,
        )

    def _start_error(self, error: RuntimeError, handle: Any, setup: Setup, device: Device) -> SourceError:
        who, reason = self.identity, str(error)
        if not device.live:
            return BadRecording(f"{device.name}: its streams cannot be played. ({reason})")
        if "resolve" in reason:
            advice = " It is on USB 2, where many modes are missing: use a USB 3 port and cable." if who.slow else ""
            modes = ", ".join(f"{width} x {height} at {fps}" for width, height, fps in shared_modes(handle))
            message = (
                f"{who} has no {setup.width} x {setup.height} at {setup.fps} frames per second for "
                f"{'colour' if setup.depth is False else 'colour and depth'}; "
                f"it has {modes or 'none for both'}.{advice}"
            )
        elif any(word in reason.lower() for word in ("busy", "is streaming", "power state", "claim", "already")):
            message = f"{who} is in use, by another program or another source in this one: close that. ({reason})"
        else:
            message = f"{who} does not start: unplug it and plug it in again. ({reason})"
        return SourceError(message, serial=who.serial, usb=who.usb)


def _colour_image(frame: Any) -> npt.NDArray[np.uint8]:
    """Copy a colour frame to an RGB image of shape ``(H, W, 3)``."""
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


def _gap(colour: Any, depth: Any) -> float | None:
    """Return the time in seconds between two frames; None if their clocks cannot be compared."""
    if colour.get_frame_timestamp_domain() != depth.get_frame_timestamp_domain():
        return None
    return abs(colour.get_timestamp() - depth.get_timestamp()) / 1000


def _arrival(frame: Any, now: float) -> float:
    """Return when a frame reached librealsense: ``time.monotonic()`` in seconds, at most ``now``.

    A thread that waited for the processor fetches a frame late; librealsense stores its arrival by the wall clock.
    """
    kind = librealsense().frame_metadata_value.time_of_arrival
    if not frame.supports_frame_metadata(kind):
        return now
    waited = time.time() - frame.get_frame_metadata(kind) / 1000
    return now - waited if 0 <= waited < _LONGEST_WAIT else now


def _exposure_start(colour: Any, depth: Any, received: float, interval: float, latency: float | None) -> float:
    """Return the earliest start of a pair's exposure: ``time.monotonic()`` in seconds.

    With librealsense's global time a frame's stamp is the end of its exposure by this machine's clock, and its metadata
    contain the exposure time. Without it the transport time is unknown, and ``latency`` is assumed.

    Args:
        colour: The colour frame.
        depth: The depth frame; None without depth.
        received: Arrival of the pair, ``time.monotonic()``.
        interval: Time between frames in seconds.
        latency: Largest time in seconds from the start of the exposure to the arrival; None for two intervals.
    """
    rs = librealsense()
    frames = [(colour, _COLOUR_EXPOSURE_UNIT), *([] if depth is None else [(depth, _DEPTH_EXPOSURE_UNIT)])]
    if any(frame.get_frame_timestamp_domain() != rs.timestamp_domain.global_time for frame, _ in frames):
        return received - (2 * interval if latency is None else latency)
    to_monotonic = time.monotonic() - time.time()
    began = [frame.get_timestamp() / 1000 + to_monotonic - _exposure(frame, unit, interval) for frame, unit in frames]
    return min(*began, received)


def _exposure(frame: Any, unit: float, interval: float) -> float:
    """Return the exposure time in seconds; if unknown the whole interval, since no exposure is longer."""
    kind = librealsense().frame_metadata_value.actual_exposure
    if not frame.supports_frame_metadata(kind):
        return interval
    return min(frame.get_frame_metadata(kind) * unit, interval)
