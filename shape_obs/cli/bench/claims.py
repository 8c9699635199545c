"""``shape-obs bench claims`` checks the accuracy that the project claims."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro
from tqdm import tqdm

from shape_obs.bench.claims import GROUPS, Effort
from shape_obs.cli.bench.printing import table

Group = Literal[
    "ropes",
    "tangles",
    "hands",
    "noise",
    "outlines",
    "sheets",
    "clouds",
    "shapes",
    "markers",
    "cable",
    "envs",
    "camera",
    "deploy",
    "robustness",
]


@dataclass(frozen=True)
class Claims:
    """Accuracy on drawn, moving and simulated objects, against known truth."""

    only: tuple[Group, ...] = ()
    """Groups to measure; all if none is named."""
    share: float = 1.0
    """Of the full counts."""
    seed: int = 0
    """Of everything drawn."""
    renderer: Literal["auto", "gl", "rays"] = "auto"
    """The simulator's camera."""
    jobs: int = 1
    """Processes that share the episodes of the group envs."""
    garments: Path | None = None
    """A JSON file of annotated garment outlines, to be measured with the drawn ones."""
    json: bool = False
    """Print JSON instead of tables."""


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    args = tyro.cli(Claims, args=list(argv), prog="shape-obs bench claims")
    if not 0 < args.share <= 100:
        raise ValueError(f"--share: expected a number above 0, at most 100, got {args.share}.")
    if args.jobs < 1:
        raise ValueError(f"--jobs: expected at least 1, got {args.jobs}.")
    if args.garments is not None and not args.garments.is_file():
        raise FileNotFoundError(f"{args.garments}: no such file")
    tables = measure(args)
    if args.json:
        print(json.dumps(tables, indent=2))
    return 0


def measure(args: Claims) -> dict[str, list[dict[str, Any]]]:
    """The measurements that are asked for, printed as they come unless JSON is asked for."""
    tables: dict[str, list[dict[str, Any]]] = {}
    groups = tqdm(args.only or GROUPS, desc="claims", leave=False, file=sys.stderr)
    effort = Effort(args.share, args.seed, args.renderer, args.garments, args.jobs, groups.set_postfix_str)
    for group in groups:
        groups.set_postfix_str(group)
        for title, rows in GROUPS[group](effort):
            tables[title] = rows
            if not args.json:
                tqdm.write(f"\n{title}\n{table(rows)}", file=sys.stdout)
    return tables
