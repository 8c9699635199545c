"""``shape-obs bench``: run one of the measurements; only its module is imported."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from shape_obs.cli import run_part

MEASUREMENTS: Final = {
    "claims": "the accuracy that the project claims, against known truth",
    "table": "the paper's table: clusterers side by side on simulated frames",
    "peers": "time and quality of the detector and other methods on the same masks",
    "latency": "the time of every stage from image to 3D points",
    "envs": "steps per second of the simulated environments",
    "servo": "shape servoing: features and laws on the same goals",
}
_SPEED: Final = ("peers", "latency", "envs")


def main(argv: Sequence[str]) -> int:
    """Run the command and return its exit code."""
    if argv and argv[0] in _SPEED:
        from tests.benchmarks.cli import speed

        return speed.main(argv[0], argv[1:])
    return run_part("bench", "measurement", MEASUREMENTS, argv)
