"""A software D455: a camera without hardware, inside librealsense, that delivers the images pushed into it."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraLike, Intrinsics, as_intrinsics
from shape_obs_envs.sources.realsense.driver import Geometry, d455_geometry, librealsense
from shape_obs_envs.sources.registration import RawImages

#: Smoothing factor of the reported frame rate; stamps that are seconds apart are pauses.
_SMOOTHING: Final = 0.2
_PAUSE: Final = 1.0
_SHORTEST: Final = 1e-4
_SENSORS: Final = {"depth": "Stereo Module", "colour": "RGB Camera"}
_BASELINE: Final = 95.0  # millimetres, between the two depth imagers
_INFO: Final = {
    "name": "Intel RealSense D455",
    "firmware_version": "5.16.0.1",
    "recommended_firmware_version": "5.16.0.1",
    "product_id": "0B5C",
    "product_line": "D400",
}
#: sensor -> option -> (least, most, step, default), as `rs-enumerate-devices -o` prints them
_OPTIONS: Final = {
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


class _Pair(NamedTuple):
    colour: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.uint16]
    number: int
    milliseconds: float
    clock: Any


class SoftwareD455:
    """A librealsense software device with the lenses, options and behaviour of a D455.

    It delivers raw images: colour with the lens distortion, and depth seen from 59 mm next to it, in the camera's depth
    unit. ``push`` makes them from ideal images. A ``RealSenseSource`` reads it like a camera on USB, through the same
    pipeline, and can connect to it repeatedly.

    Frames are numbered as they are pushed; a lost frame leaves a gap. All methods may be called from any thread.

    Push at about ``fps``, or pass stamps that advance accordingly: librealsense keeps discarded frames for one second
    of their stamps, and becomes slow when there are thousands of them.

    Args:
        serial: Serial number.
        width: Width of both streams in pixels; scaled and cropped as the camera does. 640 x 480, or 160 x 120 as a
            small size.
        height: Height of both streams in pixels.
        fps: Reported frames per second; frames are delivered as fast as they are pushed.
        camera: Intrinsics of the images given to ``push``; None for those of the frames that a source returns, so that
            images come out as they went in, except for resampling.
        usb: USB type.
        depth_unit: Unit of the raw depth images in metres.

    Attributes:
        geometry: Lenses and relative pose of the two streams.
        device: The ``rs.software_device``.

    Raises:
        ValueError: ``camera`` has distortion.
        ImportError: librealsense is not installed.
    """

    geometry: Geometry
    device: Any

    def __init__(
        self,
        serial: str = "000000000455",
        *,
        width: int = 640,
        height: int = 480,
        fps: int = 30,
        camera: CameraLike = None,
        usb: str = "3.2",
        depth_unit: float = 0.001,
    ) -> None:
        self._rs = rs = librealsense()
        self.serial, self.fps = serial, fps
        self.geometry = geometry = d455_geometry(width, height, depth_unit)
        pinhole = replace(geometry.colour, model="pinhole", coeffs=(0.0,) * 5)
        self.camera = pinhole if camera is None else as_intrinsics(camera, (height, width))
        self._raw_images = RawImages(
            self.camera, geometry.colour, geometry.depth, geometry.rotation, geometry.translation, depth_unit
        )
        self.device = device = rs.software_device()
        for key, value in {
            **_INFO,
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
        pose.rotation = geometry.rotation.T.ravel().tolist()  # librealsense stores matrices column by column
        pose.translation = geometry.translation.tolist()
        self._profiles["depth"].register_extrinsics_to(self._profiles["colour"], pose)
        device.create_matcher(rs.matchers.default)
        self._lock = threading.Lock()
        self._number, self._plugged, self._lose, self._lag = 0, True, 0, 0
        self._interval, self._last = 1 / fps, -math.inf
        self._frozen: set[str] = set()
        self._delayed: deque[_Pair] = deque()

    @property
    def plugged(self) -> bool:
        """Whether the camera is plugged in."""
        return self._plugged

    def push(self, rgb: npt.NDArray[np.uint8], depth: npt.NDArray[Any], stamp: float | None = None) -> int:
        """Deliver a frame made from ideal images.

        Args:
            rgb: Colour image of ``camera``, shape ``(H, W, 3)``, uint8 RGB.
            depth: Depth image of ``camera``, shape ``(H, W)``, in uint16 millimetres or floating-point metres; values
                that are 0 or not finite are invalid.
            stamp: Time in seconds by the camera's own clock; None for the present time of day.

        Returns:
            The number of the frame.

        Raises:
            ValueError: An image has another size or type.
        """
        return self.push_raw(*self._raw_images(rgb, depth), stamp)

    def push_raw(self, colour: npt.NDArray[np.uint8], depth: npt.NDArray[np.uint16], stamp: float | None = None) -> int:
        """Deliver a frame of raw sensor images.

        Args:
            colour: Image of ``geometry.colour``, shape ``(H, W, 3)``, uint8 RGB.
            depth: Image of ``geometry.depth``, shape ``(H, W)``, uint16 in ``depth_unit``.
            stamp: See ``push``.

        Returns:
            The number of the frame.

        Raises:
            ValueError: An image has another size or type.
        """
        # librealsense reads as many bytes as the stream's mode requires, regardless of the array's size.
        _check(colour, "colour", (*self.geometry.colour.size, 3), np.uint8)
        _check(depth, "depth", self.geometry.depth.size, np.uint16)
        domains = self._rs.timestamp_domain
        clock = domains.global_time if stamp is None else domains.hardware_clock
        seconds = time.time() if stamp is None else float(stamp)
        with self._lock:
            self._number += 1
            self._update_rate(seconds)
            pair = _Pair(np.ascontiguousarray(colour), np.ascontiguousarray(depth), self._number, 1000 * seconds, clock)
            self._delayed.append(pair)
            while len(self._delayed) > self._lag:
                self._deliver(self._delayed.popleft())
            return pair.number

    def drop(self, count: int = 1) -> None:
        """Lose the next ``count`` frames."""
        with self._lock:
            self._lose = count

    def delay(self, frames: int) -> None:
        """Deliver each further frame ``frames`` pushes late; after 0, delayed frames follow at the next push."""
        with self._lock:
            self._lag = frames

    def freeze_colour(self, frozen: bool = True) -> None:
        """Stop the colour stream while depth continues, or resume it."""
        self._freeze("colour", frozen)

    def freeze_depth(self, frozen: bool = True) -> None:
        """Stop the depth stream while colour continues, or resume it."""
        self._freeze("depth", frozen)

    def unplug(self) -> None:
        """Unplug the camera: frames are lost, and the camera is not found."""
        with self._lock:
            self._plugged = False
            self._delayed.clear()

    def plug(self) -> None:
        """Plug the camera in again."""
        with self._lock:
            self._plugged = True

    def option(self, sensor: str, name: str) -> float:
        """Return the value of an option in librealsense's units: ``option("colour", "exposure")``."""
        return self._sensors[sensor].get_option(getattr(self._rs.option, name))

    def _update_rate(self, seconds: float) -> None:
        """Update the reported frame rate, which sets how long librealsense waits for the other image of a pair."""
        step, self._last = seconds - self._last, seconds
        if 0 < step < _PAUSE:
            self._interval += _SMOOTHING * (max(step, _SHORTEST) - self._interval)

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
            # Without these two, librealsense pairs a third of the images wrongly.
            (metadata.frame_counter, pair.number),
            (metadata.actual_fps, round(1000 / self._interval)),
            (metadata.actual_exposure, 0),
            (metadata.time_of_arrival, int(1000 * time.time())),
        ):
            sensor.set_metadata(key, value)
        frame = rs.software_video_frame()  # a new one each time: reusing one aborts the process
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
        # A real D455 reports this model for its rectified depth, with coefficients of zero.
        intrinsics.model = getattr(rs.distortion, lens.model if lens.distorted else "brown_conrady")
        intrinsics.coeffs = list(lens.coeffs)
        video.intrinsics = intrinsics
        return self._sensors[sensor].add_video_stream(video, True)

    def _add_options(self, depth_unit: float) -> None:
        option = self._rs.option
        for name, options in _OPTIONS.items():
            for key, (least, most, step, default) in options.items():
                limits = self._rs.option_range()
                limits.min, limits.max, limits.step, limits.default = least, most, step, default
                self._sensors[name].add_option(getattr(option, key), limits, True)
        self._sensors["depth"].add_read_only_option(option.depth_units, depth_unit)
        self._sensors["depth"].add_read_only_option(option.stereo_baseline, _BASELINE)


def _check(image: Any, name: str, shape: tuple[int, ...], dtype: Any) -> None:
    if not isinstance(image, np.ndarray) or image.shape != shape or image.dtype != dtype:
        given = f"{image.shape} {image.dtype}" if isinstance(image, np.ndarray) else type(image).__name__
        raise ValueError(f"{name}: expected an array {shape} {np.dtype(dtype)}, the camera's mode, got {given}.")
