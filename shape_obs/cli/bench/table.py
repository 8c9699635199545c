"""``shape-obs bench table`` reproduces the paper's table and figure."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

import tyro
from tqdm import tqdm

from shape_obs.bench.interleaved_timing import Clock, machine
from shape_obs.bench.table.figures import draw, need_matplotlib
from shape_obs.bench.table.report import as_values, markdown
from shape_obs.bench.table.run import Plan, as_csv, run
from shape_obs.bench.table.summary import every_row, rankings, results, tracings
from shape_obs.cli.files import make_folder
from shape_obs.utils.files import write_text

_LEAST: Final = 10  # frames: two chunks, or there is no interval
Only = Literal[
    "centerline", "contour", "surface", "gmm", "fcm", "kmeans", "kohonen", "som", "thinning", "contours", "corners"
]


@dataclass(frozen=True)
class Table:
    """The paper's table: clusterers side by side on simulated frames.

    Writes table.md, table.json, frames.csv and two figures. A run that was interrupted goes on where it stopped when it
    is given the same folder.
    """

    out: Path = Path("table")
    """Folder for the results."""
    frames: int = 1000
    """Of each configuration."""
    seed: int = 0
    """Of all frames."""
    only: tuple[Only, ...] = ()
    """Configurations and methods to measure; all where none of a sort is named."""
    redo: bool = False
    """Measure what --only names anew, though the folder holds it."""
    jobs: int = 1
    """Processes, of one thread each. Times are comparable only while there is a core for each of them."""
    renderer: Literal["auto", "gl", "rays"] = "auto"
    """The simulator's camera."""
    clock: Clock = "wall"
    """Counts the time that passes, or the processor time of the one thread, which a busy machine hardly changes."""
    figures: bool = True
    """Draw the figures; they need the extra viz."""
    json: bool = False
    """Print JSON instead of Markdown."""


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    args = tyro.cli(Table, args=list(argv), prog="shape-obs bench table")
    if args.frames < _LEAST:
        raise ValueError(f"--frames: expected at least {_LEAST}, got {args.frames}.")
    if args.jobs < 1:
        raise ValueError(f"--jobs: expected at least 1, got {args.jobs}.")
    if args.seed < 0:
        raise ValueError(f"--seed: expected 0 or more, got {args.seed}.")
    if args.figures:
        need_matplotlib()
    folder = make_folder(args.out)
    plan = _plan(args)
    with tqdm(desc="table", unit="chunk", leave=False, file=sys.stderr) as bar:

        def tick(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        parts = run(plan, folder, jobs=args.jobs, redo=args.redo, tick=tick)
    whole = _whole(args)
    found, ranked, traces = results(parts, whole), rankings(parts, whole), tracings(parts, whole)
    page = markdown(whole, machine(), found, ranked, traces)
    values = json.dumps(as_values(whole, machine(), found, ranked, traces), indent=2)
    write_text(folder / "table.md", page)
    write_text(folder / "table.json", values + "\n")
    write_text(folder / "frames.csv", as_csv(every_row(parts, whole)))
    if args.figures and found:
        draw(plan, found, folder)
    print(values if args.json else page)
    return 0


def _whole(args: Table) -> Plan:
    return Plan(args.frames, args.seed, args.renderer, clock=args.clock)


def _plan(args: Table) -> Plan:
    """What --only leaves."""
    whole, asked = _whole(args), set(args.only).__contains__
    names = tuple(filter(asked, whole.names)) or whole.names
    methods, traced = tuple(filter(asked, whole.methods)), tuple(filter(asked, whole.tracings))
    if not methods and not traced:
        methods, traced = whole.methods, whole.tracings
    return replace(whole, names=names, methods=methods, tracings=traced)
