"""``shape-obs bench training``: the wrapper's share of the time that a training takes."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import tyro
from tqdm import tqdm

from shape_obs.bench.backends import backends
from shape_obs.bench.interleaved_timing import Clock, machine, opengl
from shape_obs.bench.training_overhead import (
    ALGORITHMS,
    SIZES,
    Algorithm,
    Course,
    overhead_claims,
    overhead_rows,
    overheads,
)
from shape_obs.cli.bench.printing import table


@dataclass(frozen=True)
class Training:
    """The wrapper's share of the time that a training of the cable takes, and that of the same training on true points.

    All take turns, on one thread; resets are counted too. Needs the extras sim and sb3.
    """

    algorithms: tuple[Algorithm, ...] = ALGORITHMS
    """SAC learns after each step, with hindsight replay; PPO ten times over after each 256 steps."""
    sizes: tuple[str, ...] = tuple(f"{width}x{height}" for width, height in SIZES)
    """Of the images."""
    steps: int = 1000
    """How many are counted at least, of each training."""
    renderer: Literal["auto", "gl", "rays"] = "auto"
    """The camera; auto takes OpenGL where there is one."""
    seed: int = 0
    """Of episodes and networks."""
    clock: Clock = "wall"
    """Counts the time that passes, or the processor time of the one thread, which a busy machine hardly changes."""
    json: bool = False
    """Print JSON instead of tables."""


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    args = tyro.cli(Training, args=list(argv), prog="shape-obs bench training")
    if args.steps < 16:
        raise ValueError(f"--steps: expected at least 16, got {args.steps}.")
    courses = [
        Course(algorithm, _size(text), args.steps, args.renderer, args.seed, args.clock)
        for algorithm in args.algorithms
        for text in args.sizes
    ]
    document: dict[str, Any] = {
        "measurement": "training",
        "machine": machine("mujoco", "gymnasium", "stable-baselines3", "torch") | {"opengl": opengl() or "none"},
        "steps": args.steps, "seed": args.seed, "clock": args.clock, "renderer": args.renderer,
    }  # fmt: skip
    if not args.json and "numba" not in backends():
        print("numba is not installed and left out: pip install shape-obs[fast]")
    total = (1 + len(backends())) * sum(course.counted for course in courses)
    rows = []
    with tqdm(desc="training", unit="step", total=total, leave=False, file=sys.stderr) as bar:
        for course in courses:
            bar.set_postfix_str(f"{course.algorithm} {course.image}")
            rows += overhead_rows(course, overheads(course, bar.update))
    document |= {"trainings": rows, "claims": overhead_claims(rows)}
    if args.json:
        print(json.dumps(document, indent=2))
        return 0
    print("\n".join(f"{name}: {what}" for name, what in document["machine"].items()))
    print(f"\ntime of a step of training, milliseconds\n{table(rows)}")
    if document["claims"]:
        print(f"\nasked and seen\n{table(document['claims'])}")
    return 0


def _size(text: str) -> tuple[int, int]:
    width, x, height = text.partition("x")
    if not (x and width.isdigit() and height.isdigit() and 16 <= int(height) <= int(width) <= 4096):
        raise ValueError(
            f"--sizes: expected WIDTHxHEIGHT, 16 to 4096 pixels and no higher than wide, such as 84x84, got {text!r}."
        )
    return int(width), int(height)
