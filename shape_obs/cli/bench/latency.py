"""``shape-obs bench latency``: the time of every stage from image to 3D points, and how it grows."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import tyro
from tqdm import tqdm

from shape_obs.bench import growth, latency
from shape_obs.bench import latency as memory
from shape_obs.bench.backends import backends
from shape_obs.bench.interleaved_timing import Clock, machine
from shape_obs.bench.synthetic.streams import SIZES
from shape_obs.cli.bench.printing import table

Part = Literal["stages", "growth"]
Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class Latency:
    """The time of every stage from an RGB-D image to 20 points in space, warm and cold, and how it grows.

    Beside it runs one pass over the same image, the floor, and the segmentation as it is usually written.
    All take turns on every frame, on one thread.
    """

    only: tuple[Part, ...] = ()
    """Parts to measure: stages at every image size, growth with pixels, points and shapes; both if none is named."""
    frames: int = 60
    """How many are counted."""
    seed: int = 0
    """Of motion, light and noise."""
    sizes: tuple[str, ...] = tuple(f"{width}x{height}" for width, height in SIZES)
    """Of the images."""
    memory: int = 0
    """Frames over which the growth of the process is measured; 0 leaves it out."""
    clock: Clock = "wall"
    """Counts the time that passes, or the processor time of the one thread, which a busy machine hardly changes."""
    burst: int = 10
    """Frames in a turn. With 1 every method finds the processor's caches full of another's work."""
    json: bool = False
    """Print JSON instead of tables."""


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    args = tyro.cli(Latency, args=list(argv), prog="shape-obs bench latency")
    for name, value, least in (("frames", args.frames, 1), ("memory", args.memory, 0), ("burst", args.burst, 1)):
        if value < least:
            raise ValueError(f"--{name}: expected at least {least}, got {value}.")
    document, asked = _measure(args, [_size(text) for text in args.sizes])
    document["claims"] = asked
    if args.json:
        print(json.dumps(document, indent=2))
        return 0
    if asked:
        print(f"\nasked and seen\n{table(asked)}")
    return 0


def _measure(args: Latency, sizes: list[tuple[int, int]]) -> tuple[dict[str, Any], Rows]:
    """The parts that are asked for, printed as they come unless JSON is asked for; and what is asked of them."""
    document: dict[str, Any] = {
        "measurement": "latency", "machine": machine(), "frames": args.frames, "seed": args.seed,
        "clock": args.clock, "burst": args.burst,
    }  # fmt: skip
    asked: Rows = []

    def told(key: str, title: str, rows: Rows) -> None:
        document[key] = rows
        if not args.json:
            print(f"\n{title}\n{table(rows)}")

    if "numba" not in backends() and not args.json:
        print("numba is not installed and left out: pip install shape-obs[fast]")
    if not args.only or "stages" in args.only:
        with _bar("stages", args.frames + latency.WARM_UP) as bar:
            found = latency.latencies(tuple(sizes), args.frames, args.seed, args.clock, args.burst, bar.update)
        told("totals", "image to points in 3D", latency.total_rows(found))
        told("stages", "stages, median milliseconds", latency.stage_rows(found))
        asked += latency.latency_claims(found)
    if not args.only or "growth" in args.only:
        with _bar("growth", args.frames + growth.WARM_UP) as bar:
            grown = growth.growths(args.frames, args.seed, args.clock, bar.update)
        told("growth", "growth, tracked", growth.growth_rows(grown))
        asked += growth.growth_claims(grown)
    if args.memory:
        with _bar("memory", args.memory + memory.MEMORY_WARM_UP) as bar:
            megabytes = memory.memory_growth(args.memory, args.seed, tick=bar.update)
        told("memory", "memory", [{"frames": args.memory, "growth_mb": megabytes}])
        asked += memory.memory_claims(args.memory, megabytes)
    return document, asked


def _bar(name: str, total: int) -> tqdm:
    return tqdm(desc=name, unit="frame", total=total, leave=False, file=sys.stderr)


def _size(text: str) -> tuple[int, int]:
    width, x, height = text.partition("x")
    if not (x and width.isdigit() and height.isdigit() and min(int(width), int(height)) >= 64):
        raise ValueError(f"--sizes: expected WIDTHxHEIGHT of at least 64 pixels each, such as 640x480, got {text!r}.")
    return int(width), int(height)
