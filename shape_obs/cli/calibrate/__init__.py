"""``shape-obs calibrate``: measure a camera. Only the chosen calibration is imported."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from shape_obs.cli import run_part

CALIBRATIONS: Final = {
    "intrinsics": "the camera's intrinsics, from a printed board",
    "base": "the camera's pose in the base frame, from touched markers",
}


def main(argv: Sequence[str]) -> int:
    """Run the chosen calibration and return the exit code."""
    return run_part("calibrate", "calibration", CALIBRATIONS, argv)
