"""Identity: what a camera is called in messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from shape_obs_envs.sources.realsense.driver import librealsense


@dataclass(frozen=True)
class Identity:
    """A camera's name, serial number and USB type, as far as it tells them."""

    name: str
    serial: str | None = None
    usb: str | None = None

    @classmethod
    def of(cls, device: Any) -> Identity:
        """Of an ``rs.device``."""
        info = librealsense().camera_info
        name, serial, usb = (
            device.get_info(key) if device.supports(key) else None
            for key in (info.name, info.serial_number, info.usb_type_descriptor)
        )
        return cls(name or "RealSense camera", serial, usb)

    @property
    def slow(self) -> bool:
        """Whether it hangs on USB 2, where many modes are missing."""
        return self.usb is not None and self.usb.startswith(("1", "2"))

    def __str__(self) -> str:
        usb = "" if self.usb is None else f" (USB {self.usb})"
        return f"{self.name} {self.serial or 'without a serial number'}{usb}"
