"""``shape-obs bench``: measurements. ``claims`` checks the accuracy that the project claims."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import tyro
from tqdm import tqdm

from shape_obs.evaluation.claims import COUNTS, cable_episodes, drawn_ropes, moving_ropes, rope_table
from shape_obs.evaluation.ropes import KINDS
from shape_obs.spec import did_you_mean

MEASUREMENTS = ("claims",)


@dataclass(frozen=True)
class Claims:
    """Accuracy on drawn ropes, moving ropes and the simulated cable, against known truth."""

    ropes: int = 40
    """Drawn ropes of each kind; 0 leaves them out."""
    motions: int = 6
    """Moving ropes at each speed; 0 leaves them out."""
    episodes: int = 20
    """Episodes of the cable for each camera; 0 leaves the simulator out."""
    renderer: Literal["auto", "gl", "rays"] = "auto"
    """The simulator's camera."""
    seed: int = 0
    """Of everything drawn."""
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
    tables = measure(args)
    if args.json:
        print(json.dumps(tables, indent=2))
    else:
        for title, rows in tables.items():
            print(f"\n{title}\n{table(rows)}")
    return 0


def measure(args: Claims) -> dict[str, list[dict[str, Any]]]:
    """The measurements that are asked for."""
    tables: dict[str, list[dict[str, Any]]] = {}
    if args.ropes:
        cold = args.ropes * len(KINDS) * len(COUNTS) * 2
        tables["drawn ropes, cold"] = rope_table(_bar(drawn_ropes(args.ropes, args.seed), cold, "drawn ropes"))
    if args.motions:
        moved = moving_ropes((10, 40), range(args.seed, args.seed + args.motions))
        moved = _bar(moved, 2 * args.motions, "moving ropes")
        tables["moving ropes, tracked"] = [result._asdict() for result in moved]
    if args.episodes:
        seeds = range(args.seed, args.seed + args.episodes)
        cameras = ("d455", "rl", [84, 84])
        tables["simulated cable, random actions, visible surface"] = [
            cable_episodes(camera, args.renderer, seeds)._asdict() for camera in _bar(cameras, len(cameras), "cameras")
        ]
    return tables


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Rows of equal keys as aligned columns."""
    cells = [[*rows[0]], *([f"{v:.3f}" if isinstance(v, float) else str(v) for v in row.values()] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return "\n".join("  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)) for line in cells)


def _bar(items: Iterable[Any], total: int, name: str) -> Iterable[Any]:
    return tqdm(items, total=total, desc=name, leave=False, file=sys.stderr)
