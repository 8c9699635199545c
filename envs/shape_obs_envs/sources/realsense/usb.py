"""What the operating system knows of cameras that librealsense does not list."""

from __future__ import annotations

from pathlib import Path
from typing import Final

_INTEL: Final = "8086"
_DEVICES: Final = Path("/sys/bus/usb/devices")


def plugged_cameras() -> list[str]:
    """Names of the RealSense cameras on USB, whether or not we may open them; empty where the system does not tell."""
    names = []
    for device in sorted(_DEVICES.glob("*")):
        name = _read(device / "product")
        if _read(device / "idVendor") == _INTEL and "realsense" in name.lower():
            names.append(name)
    return names


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:  # no such attribute, or unplugged meanwhile
        return ""
