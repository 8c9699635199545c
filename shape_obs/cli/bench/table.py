"""``shape-obs bench table``: reproduce the paper's table."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from shape_obs.cli.outputs import Overwrite, check_outputs, note_output
from shape_obs.cli.parsing import Option, parse

_PARTS = Literal["centerline", "contour", "surface", "gmm", "fcm", "kmeans", "kohonen", "som"]


@dataclass(frozen=True)
class Arguments:
    """Reproduce the paper's table: clusterers side by side on simulated frames.

    Writes table.md and table.csv.
    """

    out: Annotated[Path, Option("FOLDER", "output")] = Path("table")
    """Folder for the results."""
    overwrite: Overwrite = False
    """Replace existing files; unchanged tables of earlier runs are replaced in any case."""
    # ten frames are two episodes, the fewest that give an interval
    frames: Annotated[int, Option("N", "measurement", least=10)] = 200
    """Number of frames of each configuration."""
    seed: Annotated[int, Option("N", "measurement", least=0)] = 0
    """Seed of all frames."""
    only: Annotated[tuple[_PARTS, ...], Option(group="measurement")] = ()
    """Configurations and methods to measure; all configurations, or all methods, if none is named."""
    clock: Annotated[Literal["wall", "thread"], Option(group="measurement")] = "wall"
    """Clock: elapsed time, or the processor time of the thread, which hardly depends on other load."""
    json: Annotated[bool, Option(group="output")] = False
    """Print JSON instead of Markdown."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return the exit code."""
    args = parse(Arguments, argv, "shape-obs bench table")
    files = [args.out / "table.md", args.out / "table.csv"]
    check_outputs(args, *files)
    from tqdm import tqdm

    from shape_obs.bench.report import as_csv, in_words, machine
    from shape_obs.bench.table import CONFIGURATIONS, LABELS, episodes, markdown, measure, summarised
    from shape_obs.utils.files import make_folder, write_text

    names = [name for name in CONFIGURATIONS if name in args.only] or list(CONFIGURATIONS)
    methods = [method for method in LABELS if method in args.only] or list(LABELS)
    make_folder(args.out)
    with tqdm(total=len(names) * len(episodes(args.frames)), desc="table", leave=False, file=sys.stderr) as bar:
        found = summarised(measure(names, methods, args.frames, args.seed, args.clock, bar.update))
    what = f"{args.frames} frames of each configuration, seed {args.seed}, {args.clock} clock"
    page = f"{what}; {in_words(machine())}\n\n{markdown(found)}"
    for path, text in zip(files, (page, as_csv(found)), strict=True):
        write_text(path, text)
        note_output(path)
    known = [
        {key: None if isinstance(value, float) and math.isnan(value) else value for key, value in row.items()}
        for row in found
    ]
    run = {"frames": args.frames, "seed": args.seed, "clock": args.clock, "machine": machine(), "results": known}
    print(json.dumps(run, indent=2) if args.json else page)
    return 0
