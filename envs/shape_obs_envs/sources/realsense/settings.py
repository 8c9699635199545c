"""Settings of a camera: exposure, gain, white balance, laser and preset, and librealsense's depth filters."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from shape_obs.source import SourceError
from shape_obs_envs.sources.realsense.driver import Identity, librealsense

_LOG: Final = logging.getLogger(__name__)
#: librealsense counts the colour camera's exposure in this unit of a second. The colour image of a D405 comes from the
#: depth camera, which counts microseconds.
_EXPOSURE_UNIT: Final = 1e-4
_DEPTH_EXPOSURE_UNIT: Final = 1e-6
PRESETS: Final = ("default", "hand", "high_accuracy", "high_density", "medium_density")
#: filter -> its parameters and librealsense's option for each
_FILTERS: Final[dict[str, dict[str, str]]] = {
    "temporal": {"alpha": "filter_smooth_alpha", "delta": "filter_smooth_delta", "persistence": "holes_fill"},
    "spatial": {
        "magnitude": "filter_magnitude",
        "alpha": "filter_smooth_alpha",
        "delta": "filter_smooth_delta",
        "holes": "holes_fill",
    },
    "threshold": {"min_distance": "min_distance", "max_distance": "max_distance"},
    "hole_filling": {"mode": "holes_fill"},
}
_WARNINGS: Final = {
    "hole_filling": "invents depth where none was measured, and points on it count as measured",
    "spatial": "takes tens of milliseconds per frame and rounds edges",
}
Filter = str | tuple[str, Mapping[str, float]]


@dataclass(frozen=True)
class CameraOptions:
    """Options of a camera; None keeps automatic control or the present value.

    Args:
        exposure: Exposure of the colour camera in seconds; switches its automatic exposure off.
        gain: Gain of the colour camera, in its own units; requires ``exposure``.
        white_balance: White balance of the colour camera in kelvin; switches its automatic white balance off.
        laser_power: Power of the projector in milliwatts; 0 switches it off.
        preset: Preset of the depth camera: ``"default"``, ``"hand"``, ``"high_accuracy"``, ``"high_density"`` or
            ``"medium_density"``.

    Raises:
        ValueError: A gain without an exposure, or an unknown preset.
    """

    exposure: float | None = None
    gain: float | None = None
    white_balance: float | None = None
    laser_power: float | None = None
    preset: str | None = None

    def __post_init__(self) -> None:
        if self.gain is not None and self.exposure is None:
            raise ValueError(
                "gain: automatic exposure also sets the gain; to fix it, give exposure in seconds as well."
            )
        if self.preset is not None and self.preset not in PRESETS:
            raise ValueError(f"preset: expected one of {', '.join(map(repr, PRESETS))}, got {self.preset!r}.")

    def apply(self, device: Any) -> None:
        """Set the options of a camera.

        Args:
            device: An ``rs.device`` whose streams have not been started.

        Raises:
            SourceError: The camera does not have an option, or refuses the value.
        """
        option, who = librealsense().option, Identity.of(device)
        depth, colour = _sensor(device, "depth", who), _sensor(device, "color", who)
        for sensor in (depth, colour):
            if sensor.supports(option.global_time_enabled):
                sensor.set_option(option.global_time_enabled, 1)
        if colour.supports(option.auto_exposure_priority):
            colour.set_option(option.auto_exposure_priority, 0)  # low light must not reduce the frame rate
        if self.preset is not None:  # first, because it changes other options
            preset = getattr(librealsense().rs400_visual_preset, self.preset)
            _set(depth, option.visual_preset, int(preset), f"preset {self.preset!r}", who)
        if self.laser_power is not None:
            _set(depth, option.emitter_enabled, float(self.laser_power > 0), "laser_power (the projector)", who)
            if self.laser_power > 0:
                _set(depth, option.laser_power, self.laser_power, f"laser_power {self.laser_power} mW", who)
        if self.exposure is not None:
            _set(colour, option.enable_auto_exposure, 0, "exposure (automatic control)", who)
            unit = _DEPTH_EXPOSURE_UNIT if _has_stream(colour, "depth") else _EXPOSURE_UNIT
            _set(colour, option.exposure, self.exposure / unit, f"exposure {self.exposure} s", who, unit)
        if self.gain is not None:
            _set(colour, option.gain, self.gain, f"gain {self.gain}", who)
        if self.white_balance is not None:
            _set(colour, option.enable_auto_white_balance, 0, "white_balance (automatic control)", who)
            _set(colour, option.white_balance, self.white_balance, f"white_balance {self.white_balance} K", who)


class DepthFilters:
    """Apply librealsense's depth filters, in the given order.

    Args:
        filters: Names, or pairs of a name and its parameters: ``("temporal", {"alpha": 0.4, "delta": 20})``.

    Raises:
        ValueError: An unknown name or parameter, a value out of its range, or ``"decimation"``.
    """

    def __init__(self, filters: Sequence[Filter]) -> None:
        self._blocks = [_block(*((one, {}) if isinstance(one, str) else one)) for one in filters]

    def __call__(self, frame: Any) -> Any:
        """Filter a depth frame; its size stays the same."""
        for block in self._blocks:
            frame = block.process(frame)
        return frame


def check_filters(filters: Sequence[Filter]) -> None:
    """Check names and parameters of filters, but not their values, without librealsense.

    Raises:
        ValueError: As ``DepthFilters``.
    """
    if isinstance(filters, str):
        raise ValueError(f"filters: expected a sequence of names, got {filters!r}; write ({filters!r},).")
    for one in filters:
        name, parameters = (one, {}) if isinstance(one, str) else one
        if name == "decimation":
            raise ValueError(
                "filters: 'decimation' changes the size of the depth image; choose a smaller stream instead, "
                "width=424, height=240 for example."
            )
        if name not in _FILTERS:
            raise ValueError(f"filters: expected {', '.join(map(repr, _FILTERS))}, got {name!r}.")
        for key in parameters:
            if key not in _FILTERS[name]:
                raise ValueError(f"filters: {name!r} has the parameters {', '.join(_FILTERS[name])}, not {key!r}.")


def _sensor(device: Any, stream: str, who: Identity) -> Any:
    for sensor in device.query_sensors():
        if _has_stream(sensor, stream):
            return sensor
    name = "colour" if stream == "color" else stream
    raise SourceError(
        f"{who} has no {name} camera; expected one with colour and depth.", serial=who.serial, usb=who.usb
    )


def _has_stream(sensor: Any, stream: str) -> bool:
    wanted = getattr(librealsense().stream, stream)
    return any(profile.stream_type() == wanted for profile in sensor.get_stream_profiles())


def _set(sensor: Any, option: Any, value: float, what: str, who: Identity, unit: float = 1.0) -> None:
    """Set an option in librealsense's units; ``unit`` converts them to the user's units in messages."""
    if not sensor.supports(option):
        raise SourceError(f"{who}: {what}: the camera has no such option.", serial=who.serial, usb=who.usb)
    limits = sensor.get_option_range(option)
    if not limits.min <= value <= limits.max:
        raise SourceError(
            f"{who}: {what}: expected {limits.min * unit:g} to {limits.max * unit:g}"
            f" (the camera's default is {limits.default * unit:g}).",
            serial=who.serial,
            usb=who.usb,
        )
    try:
        sensor.set_option(option, value)
    except RuntimeError as error:
        raise SourceError(f"{who}: {what}: the camera refused it: {error}", serial=who.serial, usb=who.usb) from error


def _block(name: str, parameters: Mapping[str, float]) -> Any:
    check_filters(((name, parameters),))
    if name in _WARNINGS:
        _LOG.warning("The depth filter %r %s.", name, _WARNINGS[name])
    rs = librealsense()
    block = getattr(rs, f"{name}_filter")()
    for key, value in parameters.items():
        option = getattr(rs.option, _FILTERS[name][key])
        limits = block.get_option_range(option)
        if not limits.min <= value <= limits.max:
            raise ValueError(f"filters: {name}: {key} must be {limits.min:g} to {limits.max:g}, got {value}.")
        block.set_option(option, value)
    return block
