"""SoftwareD455: a D455 without hardware, inside librealsense, fed with images."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs_envs.sources.raw_images import RawImages
from shape_obs_envs.sources.realsense.d455 import BASELINE, INFO, OPTIONS, d455_geometry
from shape_obs_envs.sources.realsense.driver import librealsense

#: How fast the rate that is told follows the real one; steps of seconds are pauses.
_PACE: Final = 0.2
_PAUSE: Final = 1.0
_SHORTEST: Final = 1e-4
_SENSORS: Final = {"depth": "Stereo Module", "colour": "RGB Camera"}


class _Pair(NamedTuple):
    colour: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.uint16]
    number: int
    milliseconds: float
    clock: Any


class SoftwareD455:
    """A software device of librealsense with the lenses, the options and the manners of a D455.

    It gives raw images: colour with the lens' distortion, depth from 59 mm beside it, in the camera's depth unit.
    `push` makes them of ideal images. A `RealSenseSource` reads it as it reads a camera on USB, through the same
    pipeline, and can be started on it again and again.

    Frames are numbered as they are pushed; one that is lost leaves a gap. All methods may be called from any thread.

    Push at about ``fps``, or give stamps that advance so: librealsense keeps thrown-away frames for a second of their
    stamps, and slows down when those are thousands.

    Args:
        serial: Its serial number.
        width: Of both streams, pixels; scaled and cropped as the camera does it, 640 x 480 or a small 160 x 120.
        height: Of both streams, pixels.
        fps: Frames per second that it tells; it comes as fast as it is pushed.
        camera: Of the images that `push` is given; None for the camera that a source's frames have, so that images
            come out as they were put in, but for what resampling does to them.
        usb: Its USB type.
        depth_unit: Metres of 1 in its raw depth images.

    Attributes:
        geometry: Its lenses.
        device: The ``rs.software_device``.

    Raises:
        ValueError: A camera with distortion.
        ImportError: librealsense is missing.
    """

    def __init__(
        self,
        serial: str = "000000000455",
        *,
        width: int = 640,
        height: int = 480,
        fps: int = 30,
        camera: Intrinsics | None = None,
        usb: str = "3.2",
        depth_unit: float = 0.001,
    ) -> None:
        self._rs = rs = librealsense()
        self.serial, self.fps = serial, fps
        self.geometry = geometry = d455_geometry(width, height, depth_unit)
        self.camera = camera or replace(geometry.colour, model="pinhole", coeffs=(0.0,) * 5)
        self._raw_images = RawImages(
            self.camera, geometry.colour, geometry.depth, geometry.rotation, geometry.translation, depth_unit
        )
        self.device = device = rs.software_device()
        for key, value in {
            **INFO,
            "serial_number": serial,
            "usb_type_descriptor": usb,
            "physical_port": serial,
        }.items():
            device.register_info(getattr(rs.camera_info, key), value)
        self._sensors = {name: device.add_sensor(title) for name, title in _SENSORS.items()}
        self._add_options(depth_unit)
        self._profiles = {
            "depth": self._add_stream("depth", rs.stream.depth, rs.format.z16, 2, geometry.depth),
            "colour": self._add_stream("colour", rs.stream.color, rs.format.rgb8, 3, geometry.colour),
        }
        pose = rs.extrinsics()
        pose.rotation = geometry.rotation.T.ravel().tolist()  # librealsense counts by columns
        pose.translation = geometry.translation.tolist()
        self._profiles["depth"].register_extrinsics_to(self._profiles["colour"], pose)
        device.create_matcher(rs.matchers.default)
        self._lock = threading.Lock()
        self._number, self._plugged, self._lose, self._lag = 0, True, 0, 0
        self._interval, self._last = 1 / fps, -math.inf
        self._frozen: set[str] = set()
        self._under_way: deque[_Pair] = deque()

    @property
    def plugged(self) -> bool:
        """Whether it hangs on the bus."""
        return self._plugged

    def push(self, rgb: npt.NDArray[np.uint8], depth: npt.NDArray[Any], stamp: float | None = None) -> int:
        """Take a picture, of ideal images.

        Args:
            rgb: (H,W,3) uint8 RGB, of ``camera``.
            depth: (H,W) uint16 millimetres or floating metres, of ``camera``; 0 or not finite is invalid.
            stamp: Seconds, by a clock of the camera's own; None for now, by the time of day.

        Returns:
            The frame's number.

        Raises:
            ValueError: An image of another size or type.
        """
        return self.push_raw(*self._raw_images(rgb, depth), stamp)

    def push_raw(self, colour: npt.NDArray[np.uint8], depth: npt.NDArray[np.uint16], stamp: float | None = None) -> int:
        """Take a picture, as the sensors give it.

        Args:
            colour: (H,W,3) uint8 RGB, of ``geometry.colour``.
            depth: (H,W) uint16 in ``depth_unit``, of ``geometry.depth``.
            stamp: As for `push`.

        Returns:
            The frame's number.

        Raises:
            ValueError: An image of another size or type.
        """
        # librealsense reads as many bytes as the stream's mode has, whatever it is given.
        _check(colour, "colour", (*self.geometry.colour.size, 3), np.uint8)
        _check(depth, "depth", self.geometry.depth.size, np.uint16)
        domains = self._rs.timestamp_domain
        clock = domains.global_time if stamp is None else domains.hardware_clock
        seconds = time.time() if stamp is None else float(stamp)
        with self._lock:
            self._number += 1
            self._keep_pace(seconds)
            pair = _Pair(np.ascontiguousarray(colour), np.ascontiguousarray(depth), self._number, 1000 * seconds, clock)
            self._under_way.append(pair)
            while len(self._under_way) > self._lag:
                self._deliver(self._under_way.popleft())
            return pair.number

    def drop(self, count: int = 1) -> None:
        """Lose the next ``count`` frames on their way."""
        with self._lock:
            self._lose = count

    def delay(self, frames: int) -> None:
        """From now on each frame arrives ``frames`` pushes late; 0 for at once, what is under way at the next push."""
        with self._lock:
            self._lag = frames

    def freeze_colour(self, frozen: bool = True) -> None:
        """Stop the colour stream while depth goes on, or let it go on."""
        self._freeze("colour", frozen)

    def freeze_depth(self, frozen: bool = True) -> None:
        """Stop the depth stream while colour goes on, or let it go on."""
        self._freeze("depth", frozen)

    def unplug(self) -> None:
        """Pull the cable: nothing arrives any more, and the camera is not found."""
        with self._lock:
            self._plugged = False
            self._under_way.clear()

    def plug(self) -> None:
        """Put the cable in again."""
        with self._lock:
            self._plugged = True

    def option(self, sensor: str, name: str) -> float:
        """What an option is set to, in librealsense's units: ``option("colour", "exposure")``."""
        return self._sensors[sensor].get_option(getattr(self._rs.option, name))

    def _keep_pace(self, seconds: float) -> None:
        """Follow the real rate, as a D455 tells it: librealsense waits for the other image of a pair by it."""
        step, self._last = seconds - self._last, seconds
        if 0 < step < _PAUSE:
            self._interval += _PACE * (max(step, _SHORTEST) - self._interval)

    def _freeze(self, stream: str, frozen: bool) -> None:
        with self._lock:
            (self._frozen.add if frozen else self._frozen.discard)(stream)

    def _deliver(self, pair: _Pair) -> None:
        if self._lose or not self._plugged:
            self._lose = max(self._lose - 1, 0)
            return
        for stream, pixels, size in (("depth", pair.depth, 2), ("colour", pair.colour, 3)):
            if stream not in self._frozen:
                self._send(stream, pixels, size, pair)

    def _send(self, stream: str, pixels: npt.NDArray[Any], size: int, pair: _Pair) -> None:
        rs, sensor = self._rs, self._sensors[stream]
        metadata = rs.frame_metadata_value
        for key, value in (
            (metadata.frame_counter, pair.number),
            # Without these two, librealsense pairs a third of the images wrongly.
            (metadata.actual_fps, round(1000 / self._interval)),
            (metadata.actual_exposure, 0),
            (metadata.time_of_arrival, int(1000 * time.time())),
        ):
            sensor.set_metadata(key, value)
        frame = rs.software_video_frame()  # a new one each time: one that is used again aborts the process
        frame.pixels, frame.profile = pixels, self._profiles[stream].as_video_stream_profile()
        frame.bpp, frame.stride = size, size * pixels.shape[1]
        frame.frame_number, frame.timestamp, frame.domain = pair.number, pair.milliseconds, pair.clock
        if stream == "depth" and hasattr(frame, "depth_units"):
            frame.depth_units = self.geometry.depth_unit
        sensor.on_video_frame(frame)

    def _add_stream(self, sensor: str, stream: Any, pixels: Any, size: int, lens: Intrinsics) -> Any:
        rs = self._rs
        video, intrinsics = rs.video_stream(), rs.intrinsics()
        video.type, video.fmt, video.bpp, video.fps = stream, pixels, size, self.fps
        video.index, video.uid = 0, int(stream)
        video.width, video.height = intrinsics.width, intrinsics.height = lens.width, lens.height
        intrinsics.fx, intrinsics.fy, intrinsics.ppx, intrinsics.ppy = lens.fx, lens.fy, lens.cx, lens.cy
        # A real D455 calls its rectified depth so, with coefficients of zero.
        intrinsics.model = getattr(rs.distortion, lens.model if lens.distorted else "brown_conrady")
        intrinsics.coeffs = list(lens.coeffs)
        video.intrinsics = intrinsics
        return self._sensors[sensor].add_video_stream(video, True)

    def _add_options(self, depth_unit: float) -> None:
        option = self._rs.option
        for name, options in OPTIONS.items():
            for key, (least, most, step, default) in options.items():
                limits = self._rs.option_range()
                limits.min, limits.max, limits.step, limits.default = least, most, step, default
                self._sensors[name].add_option(getattr(option, key), limits, True)
        self._sensors["depth"].add_read_only_option(option.depth_units, depth_unit)
        self._sensors["depth"].add_read_only_option(option.stereo_baseline, BASELINE)


def _check(image: Any, name: str, shape: tuple[int, ...], dtype: Any) -> None:
    if not isinstance(image, np.ndarray) or image.shape != shape or image.dtype != dtype:
        told = f"{image.shape} {image.dtype}" if isinstance(image, np.ndarray) else type(image).__name__
        raise ValueError(f"{name}: expected an array {shape} {np.dtype(dtype)}, as the camera's mode is, got {told}.")
