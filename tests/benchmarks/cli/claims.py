"""``shape-obs bench claims``: measure the accuracy that the project claims."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from shape_obs.cli.parsing import Option, parse
from tests.benchmarks.claims import GROUPS, Effort, Group
from tests.benchmarks.cli.output import Output, need_matplotlib, progress


@dataclass(frozen=True)
class Claims:
    """Measure accuracy on drawn, moving and simulated objects against known truth."""

    only: Annotated[tuple[Group, ...], Option(group="measurement")] = ()
    """Groups to measure; all if none is named."""
    share: Annotated[float, Option("SHARE", "measurement", above=0, most=100)] = 1.0
    """Share of the full number of scenes and frames."""
    seed: Annotated[int, Option("N", "measurement", least=0)] = 0
    """Random seed."""
    renderer: Annotated[Literal["auto", "gl", "rays"], Option(group="measurement")] = "auto"
    """The simulator's renderer."""
    jobs: Annotated[int, Option("N", "processing", least=1)] = 1
    """Number of processes that share the episodes of the group envs."""
    garments: Annotated[Path | None, Option("FILE", "measurement", existing="file of outlines")] = None
    """A JSON file of annotated garment outlines, measured together with the drawn ones."""
    figures: Annotated[Path | None, Option("FOLDER", "output")] = None
    """Folder for the pictures of the groups that have some (belief)."""
    json: Annotated[bool, Option(group="output")] = False
    """Print JSON instead of tables."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return its exit code."""
    args = parse(Claims, argv, "shape-obs bench claims")
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
