"""``shape-obs bench claims``: measure the accuracy that the project claims."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from shape_obs.bench.claims import GROUPS, Effort, Group
from shape_obs.cli.bench.output import Output, check_minimum, need_matplotlib, progress


@dataclass(frozen=True)
class Claims:
    """Measure accuracy on drawn, moving and simulated objects against known truth."""

    only: tuple[Group, ...] = ()
    """Groups to measure; all if none is named."""
    share: float = 1.0
    """Share of the full counts."""
    seed: int = 0
    """Seed of everything that is drawn at random."""
    renderer: Literal["auto", "gl", "rays"] = "auto"
    """The simulator's renderer."""
    jobs: int = 1
    """Processes that share the episodes of the group envs."""
    garments: Path | None = None
    """A JSON file of annotated garment outlines, measured together with the drawn ones."""
    figures: Path | None = None
    """Folder for the pictures of the groups that have some (belief)."""
    json: bool = False
    """Print JSON instead of tables."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return its exit code."""
    args = tyro.cli(Claims, args=list(argv), prog="shape-obs bench claims")
    if not 0 < args.share <= 100:
        raise ValueError(f"--share: expected a number above 0, at most 100, got {args.share}.")
    check_minimum(args, jobs=1)
    if args.garments is not None and not args.garments.is_file():
        raise FileNotFoundError(f"{args.garments}: no such file")
    if args.figures is not None:
        need_matplotlib()
        args.figures.mkdir(parents=True, exist_ok=True)
    groups, output = args.only or tuple(GROUPS), Output(args.json)
    with progress("claims", "group", len(groups)) as bar:
        effort = Effort(
            args.share, args.seed, args.renderer, args.garments, args.jobs, bar.set_postfix_str, args.figures
        )
        for group in groups:
            bar.set_postfix_str(group)
            for title, rows in GROUPS[group](effort):
                output.table(title, list(rows))
            bar.update()
    output.close()
    return 0
