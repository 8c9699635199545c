"""``shape-obs bench peers``: time and quality beside other ways to the same points."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, get_args

import tyro
from tqdm import tqdm

from shape_obs.bench.interleaved_timing import Clock, machine
from shape_obs.bench.peer_comparison import WARM_UP, Result, claims, missing, run_work
from shape_obs.bench.synthetic.streams import Name
from shape_obs.cli.bench.printing import table


@dataclass(frozen=True)
class Peers:
    """The detector beside other ways to the same points: same masks, same N, in turn on every frame, one thread.

    A method's clock starts when its mask, or the mask's pixels as floats, lie ready. Clusterers are not charged for
    picking out the pixels, nor for an order, which they do not give.
    """

    only: tuple[Name, ...] = ()
    """Works to measure; all if none is named."""
    frames: int = 100
    """How many are counted."""
    slow_frames: int = 5
    """On how many of them slow methods run (n_init 10, mixture, fuzzy); 0 leaves these out."""
    seed: int = 0
    """Of the motions, and of the methods that draw."""
    clock: Clock = "wall"
    """Counts the time that passes, or the processor time of the one thread, which a busy machine hardly changes."""
    burst: int = 10
    """Frames in a turn. With 1 every method finds the processor's caches full of another's work."""
    json: bool = False
    """Print JSON instead of tables."""


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    args = tyro.cli(Peers, args=list(argv), prog="shape-obs bench peers")
    if args.frames < 1:
        raise ValueError(f"--frames: expected at least 1, got {args.frames}.")
    if args.slow_frames < 0:
        raise ValueError(f"--slow-frames: expected at least 0, got {args.slow_frames}.")
    if args.burst < 1:
        raise ValueError(f"--burst: expected at least 1, got {args.burst}.")
    works: tuple[Name, ...] = args.only or get_args(Name)
    results: dict[Name, Result] = {}
    away = missing()
    if not args.json:
        for module, package in away.items():
            print(f"{module} is not installed and left out: pip install {package}")
    for name in works:
        with tqdm(desc=name, unit="frame", total=args.frames + WARM_UP, leave=False, file=sys.stderr) as bar:
            results[name] = run_work(name, args.frames, args.slow_frames, args.seed, args.clock, args.burst, bar.update)
        if not args.json:
            print(f"\n{_title(results[name])}\n{table(results[name].rows())}")
    asked = claims(results)
    if args.json:
        print(json.dumps(_document(args, away, results, asked), indent=2))
    else:
        print(f"\nasked and seen\n{table(asked)}")
    return 0


def _title(result: Result) -> str:
    work = result.work
    refused = f", {result.refused} refused" if result.refused else ""
    return f"{work.name}: {work.n} points from {work.samples} pixels, {result.frames} frames{refused}"


def _document(
    args: Peers, away: dict[str, str], results: dict[Name, Result], asked: list[dict[str, Any]]
) -> dict[str, Any]:
    return {
        "measurement": "peers",
        "machine": machine(),
        "frames": args.frames,
        "seed": args.seed,
        "clock": args.clock,
        "burst": args.burst,
        "missing": away,
        "works": {
            name: {
                "points": result.work.n,
                "samples": result.work.samples,
                "frames": result.frames,
                "refused": result.refused,
                "rows": result.rows(),
            }
            for name, result in results.items()
        },
        "claims": asked,
    }
