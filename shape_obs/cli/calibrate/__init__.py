"""``shape-obs calibrate``: what has to be measured of a camera. Only the one that runs is imported."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from shape_obs.cli.parts import run_part

CALIBRATIONS: Final = {
    "intrinsics": "the camera's projection, from a ChArUco board; checks the factory's",
    "base": "the camera's place in the robot's base frame, from touched markers",
}


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    return run_part("calibrate", "calibration", CALIBRATIONS, argv)
