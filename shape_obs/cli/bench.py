"""``shape-obs bench``: measurements. ``claims`` checks the accuracy that the project claims."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro
from tqdm import tqdm

from shape_obs.evaluation.report import GROUPS, Effort
from shape_obs.spec import did_you_mean

MEASUREMENTS = ("claims",)
Group = Literal["ropes", "tangles", "hands", "noise", "outlines", "sheets", "clouds", "shapes", "cable"]


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
    garments: Path | None = None
    """A JSON file of annotated garment outlines, to be measured with the drawn ones."""
    json: bool = False
    """Print JSON instead of tables."""


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    if not argv or argv[0] in ("-h", "--help"):
        print("usage: shape-obs bench {" + ",".join(MEASUREMENTS) + "} [OPTIONS]")
        return 0
    if argv[0] not in MEASUREMENTS:
        raise ValueError(f"unknown measurement {argv[0]!r}{did_you_mean(argv[0], MEASUREMENTS)}")
    args = tyro.cli(Claims, args=list(argv[1:]), prog="shape-obs bench claims")
    if not 0 < args.share <= 100:
        raise ValueError(f"--share: expected a number above 0, at most 100, got {args.share}.")
    if args.garments is not None and not args.garments.is_file():
        raise FileNotFoundError(f"{args.garments}: no such file")
    tables = measure(args)
    if args.json:
        print(json.dumps(tables, indent=2))
    return 0


def measure(args: Claims) -> dict[str, list[dict[str, Any]]]:
    """The measurements that are asked for, printed as they come unless JSON is asked for."""
    tables: dict[str, list[dict[str, Any]]] = {}
    effort = Effort(args.share, args.seed, args.renderer, args.garments)
    groups = tqdm(args.only or GROUPS, desc="claims", leave=False, file=sys.stderr)
    for group in groups:
        groups.set_postfix_str(group)
        for title, rows in GROUPS[group](effort):
            tables[title] = rows
            if not args.json:
                tqdm.write(f"\n{title}\n{table(rows)}", file=sys.stdout)
    return tables


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Rows of equal keys as aligned columns."""
    cells = [[*rows[0]], *([f"{v:.3f}" if isinstance(v, float) else str(v) for v in row.values()] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return "\n".join("  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)) for line in cells)
