"""Session: one run of librealsense's pipeline, from its start to its stop."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from shape_obs.source import BadRecording, SourceError
from shape_obs_envs.sources.realsense.driver import librealsense
from shape_obs_envs.sources.realsense.filters import DepthFilters, Filter
from shape_obs_envs.sources.realsense.gate import PairGate
from shape_obs_envs.sources.realsense.geometry import Geometry
from shape_obs_envs.sources.realsense.identity import Identity
from shape_obs_envs.sources.realsense.modes import shared_modes
from shape_obs_envs.sources.realsense.options import CameraOptions
from shape_obs_envs.sources.realsense.origins import Origin
from shape_obs_envs.sources.realsense.raw import RawFrame, arrival, colour_image, depth_image, exposure_began


@dataclass(frozen=True)
class Setup:
    """What is asked of a camera.

    Args:
        width: Of both images, pixels.
        height: Of both images, pixels.
        fps: Frames per second.
        options: Exposure and the like.
        filters: Of depth, inside librealsense.
        max_gap: Seconds between the images of a pair; None for three quarters of the frame interval.
    """

    width: int = 640
    height: int = 480
    fps: int = 30
    options: CameraOptions = field(default_factory=CameraOptions)
    filters: Sequence[Filter] = ()
    max_gap: float | None = None


class Session:
    """A pipeline that runs. Live, software or recorded: only its origin knows.

    Args:
        origin: Where the device comes from; it is looked for anew.
        setup: What is asked of it. A recording has a mode and options of its own.
        record_to: Where librealsense writes all that comes, or None.

    Attributes:
        identity: The camera.
        geometry: Its lenses.
        gate: What refuses pairs that do not belong together.

    Raises:
        SourceError: As `Origin.find` does; or the camera does not have the mode, refuses an option, or is in use.
    """

    def __init__(self, origin: Origin, setup: Setup, record_to: Path | None = None) -> None:
        rs = librealsense()
        device = origin.find()
        self.identity, self._live, self._latency = Identity.of(device), origin.live, origin.latency
        self._filter = DepthFilters(setup.filters)
        # A new one each time: a config remembers the device that it was resolved with.
        config, self._pipeline = rs.config(), rs.pipeline(rs.context())
        mode = (setup.width, setup.height) if origin.live else ()
        for stream, pixels in ((rs.stream.depth, rs.format.z16), (rs.stream.color, rs.format.rgb8)):
            config.enable_stream(stream, *((*mode, pixels, setup.fps) if mode else ()))
        if record_to is not None:
            config.enable_record_to_file(str(record_to))
        try:
            if origin.live:
                setup.options.apply(device)
            profile, self._take = origin.start(self._pipeline, config, device)
        except RuntimeError as error:
            raise self._start_error(error, device, setup, origin) from error
        self._recorder = None if record_to is None else profile.get_device().as_recorder()
        self.interval = 1 / profile.get_stream(rs.stream.color).fps()
        self.gate = PairGate(self.interval, setup.max_gap)
        try:
            self.geometry = Geometry.of(profile)
        except SourceError:
            self.stop()
            raise

    def pull(self, timeout: float) -> RawFrame | None:
        """The next pair, copied out of librealsense, which stops streaming when its own frames are held.

        Args:
            timeout: Seconds to wait at most.

        Raises:
            EndOfSource: A recording is over.
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
        """Stop the pipeline; a recording is written to its end."""
        with contextlib.suppress(RuntimeError):  # the device may be gone, and the pipeline with it
            if self._recorder is not None:
                self._recorder.pause()  # comes back when all is written; the pipeline's stop does not wait
            self._pipeline.stop()
        del self._take, self._pipeline, self._recorder  # what holds the device and the file

    def _pair(self, frames: Any) -> RawFrame | None:
        now = time.monotonic()
        colour, depth = frames.get_color_frame(), frames.get_depth_frame()
        if not colour or not depth:
            return None
        numbers = int(colour.get_frame_number()), int(depth.get_frame_number())
        if not self.gate.admits(*numbers, _gap(colour, depth)):
            return None
        received = arrival(colour, now) if self._live else now
        return RawFrame(
            colour=colour_image(colour),
            depth=depth_image(self._filter(depth)),
            stamp=colour.get_timestamp() / 1000,
            received=received,
            exposed=exposure_began(colour, depth, received, self.interval, self._latency),
            number=numbers[0],
        )

    def _start_error(self, error: RuntimeError, device: Any, setup: Setup, origin: Origin) -> SourceError:
        who, told = self.identity, str(error)
        if not origin.live:
            return BadRecording(f"{origin.name}: expected a recording with a colour and a depth stream. ({told})")
        if "resolve" in told:
            advice = " It hangs on USB 2, where many modes are missing: use a USB 3 port and cable." if who.slow else ""
            modes = ", ".join(f"{width} x {height} at {fps}" for width, height, fps in shared_modes(device))
            message = (
                f"{who} has no {setup.width} x {setup.height} at {setup.fps} frames per second for colour and depth; "
                f"it has {modes or 'none for both'}.{advice}"
            )
        elif any(word in told.lower() for word in ("busy", "is streaming", "power state", "claim", "already")):
            message = f"{who} is in use, by another program or another source in this one: close that. ({told})"
        else:
            message = f"{who} does not start: plug it out and in again. ({told})"
        return SourceError(message, serial=who.serial, usb=who.usb)


def _gap(colour: Any, depth: Any) -> float | None:
    if colour.get_frame_timestamp_domain() != depth.get_frame_timestamp_domain():
        return None
    return abs(colour.get_timestamp() - depth.get_timestamp()) / 1000
