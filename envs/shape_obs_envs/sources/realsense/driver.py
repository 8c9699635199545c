"""Load librealsense on first use, and read what it reports about a device: identity, modes and lenses."""

from __future__ import annotations

import ctypes
import functools
import importlib
import importlib.metadata
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics, as_intrinsics
from shape_obs.source import SourceError
from shape_obs.utils.errors import install_hint

#: librealsense records .db3 files from this version on, and ROS bags before it.
_FIRST_DB3: Final = (2, 58)
_INTEL: Final = "8086"
_USB_DEVICES: Final = Path("/sys/bus/usb/devices")
#: A recording stores the pose with six digits, inverted twice. Rounded to what survives that, a camera and its
#: recording are registered identically, to the last pixel. The errors are 0.5 microradians and 5 micrometres.
_ROTATION_DIGITS: Final = 6
_TRANSLATION_DIGITS: Final = 5

#: Both sensors have 1280 x 800 pixels. Colour intrinsics are those of a real unit; its coefficients are those of
#: another unit (https://github.com/realsenseai/librealsense/issues/9551). Depth is rectified inside the camera.
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

Mode = tuple[int, int, int]  # width and height in pixels, frames per second


@functools.cache
def librealsense() -> Any:
    """Import ``pyrealsense2``.

    Raises:
        ImportError: It is not installed, or not available for this platform.
    """
    if sys.platform == "linux":
        _load_libusb()
    try:
        return importlib.import_module("pyrealsense2")
    except ImportError as error:
        raise ImportError(_installation_advice(error), name="pyrealsense2") from error


def recording_suffix() -> str:
    """Return the suffix of the recordings that this librealsense writes: ``".db3"``, or ``".bag"`` before 2.58."""
    librealsense()
    version = tuple(int(part) for part in importlib.metadata.version("pyrealsense2").split(".")[:2])
    return ".db3" if version >= _FIRST_DB3 else ".bag"


def plugged_cameras() -> list[str]:
    """Return the names of the RealSense cameras on USB, even those that cannot be opened; empty if unknown."""
    names = []
    for device in sorted(_USB_DEVICES.glob("*")):
        name = _read(device / "product")
        if _read(device / "idVendor") == _INTEL and "realsense" in name.lower():
            names.append(name)
    return names


def shared_modes(device: Any) -> list[Mode]:
    """Return the modes that colour and depth stream of an ``rs.device`` have in common, smallest first."""
    rs = librealsense()
    modes: dict[Any, set[Mode]] = {rs.stream.color: set(), rs.stream.depth: set()}
    for sensor in device.query_sensors():
        for profile in sensor.get_stream_profiles():
            if profile.stream_type() in modes:
                video = profile.as_video_stream_profile()
                modes[profile.stream_type()].add((video.width(), video.height(), video.fps()))
    return sorted(set.intersection(*modes.values()))


def recorded_streams(device: Any) -> list[str]:
    """Return the names of the streams of an ``rs.device`` that plays a recording, such as ``["color", "gyro"]``."""
    profiles = [profile for sensor in device.query_sensors() for profile in sensor.get_stream_profiles()]
    return sorted({profile.stream_type().name for profile in profiles})


@dataclass(frozen=True)
class Identity:
    """Name, serial number and USB type of a camera, as far as it reports them; used in messages."""

    name: str
    serial: str | None = None
    usb: str | None = None

    @classmethod
    def of(cls, device: Any) -> Identity:
        """Read the identity of an ``rs.device``."""
        info = librealsense().camera_info
        name, serial, usb = (
            device.get_info(key) if device.supports(key) else None
            for key in (info.name, info.serial_number, info.usb_type_descriptor)
        )
        return cls(name or "RealSense camera", serial, usb)

    @property
    def slow(self) -> bool:
        """Whether the camera is on USB 2, where many modes are missing."""
        return self.usb is not None and self.usb.startswith(("1", "2"))

    def is_model(self, model: str) -> bool:
        """Return whether the camera is of a model, such as ``"d435"``; a D435i is a D435 too."""
        return f" {model}".lower() in self.name.lower()

    def __str__(self) -> str:
        usb = "" if self.usb is None else f" (USB {self.usb})"
        return f"{self.name} {self.serial or 'without a serial number'}{usb}"


def lens_of(profile: Any, stream: Any) -> Intrinsics:
    """Return the intrinsics of a video stream of a ``pipeline_profile``.

    Raises:
        SourceError: The lens model is not supported.
    """
    try:
        return as_intrinsics(profile.get_stream(stream).as_video_stream_profile())
    except ValueError as error:
        raise SourceError(str(error)) from error


@dataclass(frozen=True)
class Geometry:
    """Lenses and relative pose of the two streams of a camera.

    Args:
        colour: Intrinsics of the raw colour image.
        depth: Intrinsics of the raw depth image.
        rotation: Rotation matrix of shape ``(3, 3)``, ``p_colour = rotation p_depth + translation``.
        translation: Translation of shape ``(3,)``, in metres.
        depth_unit: Unit of the raw depth image, in metres.
    """

    colour: Intrinsics
    depth: Intrinsics
    rotation: npt.NDArray[np.float64]
    translation: npt.NDArray[np.float64]
    depth_unit: float

    @classmethod
    def of(cls, profile: Any) -> Geometry:
        """Read the geometry of a running pipeline.

        Args:
            profile: The ``pipeline_profile`` that the pipeline's start returned, with a colour and a depth stream.

        Raises:
            SourceError: The lens model is not supported, or there is no depth sensor.
        """
        streams = librealsense().stream
        pose = profile.get_stream(streams.depth).get_extrinsics_to(profile.get_stream(streams.color))
        return cls(
            lens_of(profile, streams.color),
            lens_of(profile, streams.depth),
            # librealsense stores matrices column by column
            rotation=np.round(np.reshape(pose.rotation, (3, 3)), _ROTATION_DIGITS).T,
            translation=np.round(pose.translation, _TRANSLATION_DIGITS),
            depth_unit=_depth_unit(profile.get_device()),
        )


def d455_geometry(width: int, height: int, depth_unit: float) -> Geometry:
    """Return the geometry of a D455 in a mode: its sensors, scaled to cover the image and cropped at the centre.

    At 640 x 480 the scale is 0.6, and 64 columns are cut off on each side.
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


def _depth_unit(device: Any) -> float:
    option = librealsense().option.depth_units
    for sensor in device.query_sensors():
        if sensor.supports(option):  # as_depth_sensor() does not work while librealsense records
            return float(f"{sensor.get_option(option):.6g}")  # a float32 inside: 0.001 is read as 0.0010000000475
    raise SourceError("The camera has no depth sensor.")


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:  # no such attribute, or unplugged in the meantime
        return ""


def _load_libusb() -> None:
    """Load the packaged libusb, if installed: the wheels of pyrealsense2 expect one on the machine."""
    try:
        libusb_package = importlib.import_module("libusb_package")
    except ImportError:
        return  # use the machine's own
    path = libusb_package.get_library_path()
    if path is not None:
        ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)


def _installation_advice(error: ImportError) -> str:
    if sys.platform == "darwin":
        return (
            "pyrealsense2 has no packages for macOS: build librealsense with its Python wrapper, or use the camera on "
            f"Linux or Windows. ({error})"
        )
    return (
        "RealSense cameras and their recordings need librealsense, which is not installed: "
        f"{install_hint('realsense')}. ({error})"
    )
