"""``shape-obs bench``: measurements. Only the one that runs is imported."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from shape_obs.cli import run_part

MEASUREMENTS: Final = {
    "claims": "the accuracy that the project claims, against known truth",
    "table": "the paper's table and figure: clusterers side by side on simulated frames",
    "peers": "time and quality beside other ways to the same points, on the same masks",
    "latency": "the time of every stage from image to 3D points, and how it grows",
    "envs": "steps per second of the simulated environments, bare, wrapped and in vectors",
    "training": "the wrapper's share of the time that a training takes",
    "servo": "shape servoing: features and laws on the same goals, from the camera and from the true points",
}


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    return run_part("bench", "measurement", MEASUREMENTS, argv)
