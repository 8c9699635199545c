"""``shape-obs bench``: measure the library on this machine. Only the chosen measurement is imported."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from shape_obs.cli import run_part

MEASUREMENTS: Final = {
    "speed": "the time of each stage on this machine, from images to points",
    "table": "the paper's table: clusterers side by side on simulated frames",
}


def main(argv: Sequence[str]) -> int:
    """Run the chosen measurement and return the exit code."""
    return run_part("bench", "measurement", MEASUREMENTS, argv)
