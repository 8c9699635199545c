"""List the RealSense cameras on this machine and what may be wrong: ``python -m shape_obs_envs.sources.realsense``."""

from __future__ import annotations

import sys

from shape_obs_envs.sources.realsense.devices import listed_cameras
from shape_obs_envs.sources.realsense.driver import Identity, librealsense, plugged_cameras, shared_modes


def main() -> int:
    """Print the cameras; return 1 if none can be opened."""
    devices = listed_cameras()
    for device in devices:
        who, firmware = Identity.of(device), librealsense().camera_info.firmware_version
        print(f"{who}, firmware {device.get_info(firmware)}")
        for width, height, fps in shared_modes(device):
            print(f"  {width} x {height} at {fps}")
        if who.slow:
            print("  On USB 2, where many modes are missing: use a USB 3 port and cable.")
    if not devices:
        plugged = ", ".join(plugged_cameras())
        rules = "install librealsense's udev rules, unplug it and plug it in again"
        print(f"Plugged in, but cannot be opened: {plugged}; {rules}." if plugged else "No RealSense camera on USB.")
    return 0 if devices else 1


if __name__ == "__main__":
    sys.exit(main())
