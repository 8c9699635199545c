"""``shape-obs calibrate``: what has to be measured of a camera. Only the one that runs is imported."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Final

from shape_obs.spec import did_you_mean

CALIBRATIONS: Final = {
    "intrinsics": "the camera's projection, from a ChArUco board; checks the factory's",
    "base": "the camera's place in the robot's base frame, from touched markers",
}


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    if not argv or argv[0] in ("-h", "--help"):
        print("usage: shape-obs calibrate {" + ",".join(CALIBRATIONS) + "} [OPTIONS]\n")
        print("\n".join(f"  {name:<10} {what}" for name, what in CALIBRATIONS.items()))
        return 0
    if argv[0] not in CALIBRATIONS:
        raise ValueError(f"unknown calibration {argv[0]!r}{did_you_mean(argv[0], CALIBRATIONS)}")
    return int(import_module(f"shape_obs.cli.calibrate.{argv[0]}").main(argv[1:]))
