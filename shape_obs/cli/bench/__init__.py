"""``shape-obs bench``: measurements. Only the one that runs is imported."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Final

from shape_obs.spec import did_you_mean

MEASUREMENTS: Final = {
    "claims": "the accuracy that the project claims, against known truth",
    "table": "the paper's table and figure: clusterers side by side on simulated frames",
    "peers": "time and quality beside other ways to the same points, on the same masks",
    "latency": "the time of every stage from image to 3D points, and how it grows",
    "envs": "steps per second of the simulated environments, bare, wrapped and in vectors",
}


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    if not argv or argv[0] in ("-h", "--help"):
        print("usage: shape-obs bench {" + ",".join(MEASUREMENTS) + "} [OPTIONS]\n")
        print("\n".join(f"  {name:<8} {what}" for name, what in MEASUREMENTS.items()))
        return 0
    if argv[0] not in MEASUREMENTS:
        raise ValueError(f"unknown measurement {argv[0]!r}{did_you_mean(argv[0], MEASUREMENTS)}")
    return int(import_module(f"shape_obs.cli.bench.{argv[0]}").main(argv[1:]))
