"""CameraOptions: exposure, gain, white balance, laser and preset, checked and set before a stream starts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from shape_obs.source import SourceError
from shape_obs_envs.sources.realsense.driver import librealsense
from shape_obs_envs.sources.realsense.identity import Identity

#: librealsense counts the colour camera's exposure in these units of a second.
_EXPOSURE_UNIT: Final = 1e-4
PRESETS: Final = ("default", "hand", "high_accuracy", "high_density", "medium_density")


@dataclass(frozen=True)
class CameraOptions:
    """What the camera is set to; None leaves a value to the camera's automatics or as it is.

    Args:
        exposure: Of the colour camera, seconds; switches its automatic exposure off.
        gain: Of the colour camera, in its own units; needs ``exposure``.
        white_balance: Of the colour camera, kelvin; switches its automatic white balance off.
        laser_power: Of the projector, milliwatts; 0 switches it off.
        preset: Of the depth camera: ``"default"``, ``"hand"``, ``"high_accuracy"``, ``"high_density"`` or
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
            raise ValueError("gain: automatic exposure sets the gain too; fix both, give exposure in seconds as well.")
        if self.preset is not None and self.preset not in PRESETS:
            raise ValueError(f"preset: expected one of {', '.join(map(repr, PRESETS))}, got {self.preset!r}.")

    def apply(self, device: Any) -> None:
        """Set a camera; what is None stays as it is.

        Args:
            device: An ``rs.device`` whose streams have not been started.

        Raises:
            SourceError: The camera has no such option, or not this value.
        """
        option, who = librealsense().option, Identity.of(device)
        depth, colour = _sensor(device, "depth", who), _sensor(device, "color", who)
        for sensor in (depth, colour):
            if sensor.supports(option.global_time_enabled):
                sensor.set_option(option.global_time_enabled, 1)
        if colour.supports(option.auto_exposure_priority):
            colour.set_option(option.auto_exposure_priority, 0)  # darkness must not lower the frame rate
        if self.preset is not None:  # first: it sets other options as well
            preset = getattr(librealsense().rs400_visual_preset, self.preset)
            _set(depth, option.visual_preset, int(preset), f"preset {self.preset!r}", who)
        if self.laser_power is not None:
            _set(depth, option.emitter_enabled, float(self.laser_power > 0), "laser_power (the projector)", who)
            if self.laser_power > 0:
                _set(depth, option.laser_power, self.laser_power, f"laser_power {self.laser_power} mW", who)
        if self.exposure is not None:
            _set(colour, option.enable_auto_exposure, 0, "exposure (its automatics)", who)
            units = self.exposure / _EXPOSURE_UNIT
            _set(colour, option.exposure, units, f"exposure {self.exposure} s", who, _EXPOSURE_UNIT)
        if self.gain is not None:
            _set(colour, option.gain, self.gain, f"gain {self.gain}", who)
        if self.white_balance is not None:
            _set(colour, option.enable_auto_white_balance, 0, "white_balance (its automatics)", who)
            _set(colour, option.white_balance, self.white_balance, f"white_balance {self.white_balance} K", who)


def _sensor(device: Any, stream: str, who: Identity) -> Any:
    wanted = getattr(librealsense().stream, stream)
    for sensor in device.query_sensors():
        if any(profile.stream_type() == wanted for profile in sensor.get_stream_profiles()):
            return sensor
    name = "colour" if stream == "color" else stream
    raise SourceError(
        f"{who} has no {name} camera; expected one with colour and depth.", serial=who.serial, usb=who.usb
    )


def _set(sensor: Any, option: Any, value: float, what: str, who: Identity, unit: float = 1.0) -> None:
    """Set one option, in librealsense's units; ``unit`` of them is what the user counts in."""
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
