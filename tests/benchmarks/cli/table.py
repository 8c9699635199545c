"""``shape-obs bench table``: reproduce the paper's table and figure."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from shape_obs.cli.parsing import Option, parse
from tests.benchmarks import Clock
from tests.benchmarks.cli.output import need_matplotlib, progress

Only = Literal[
    "centerline", "contour", "surface", "gmm", "fcm", "kmeans", "kohonen", "som", "thinning", "contours", "corners"
]


@dataclass(frozen=True)
class Table:
    """Reproduce the paper's table: clusterers side by side on simulated frames.

    Writes table.md, table.json, frames.csv and two figures. Run it again with the same folder to continue an
    interrupted run.
    """

    out: Annotated[Path, Option("FOLDER", "output")] = Path("table")
    """Folder for the results."""
    # ten frames are two chunks, the fewest that give an interval
    frames: Annotated[int, Option("N", "measurement", least=10)] = 1000
    """Number of frames of each configuration."""
    seed: Annotated[int, Option("N", "measurement", least=0)] = 0
    """Seed of all frames."""
    only: Annotated[tuple[Only, ...], Option(group="measurement")] = ()
    """Configurations and methods to measure; all configurations, or all methods, if none is named."""
    redo: Annotated[bool, Option(group="measurement")] = False
    """Measure what --only names again, even if the folder contains it."""
    jobs: Annotated[int, Option("N", "processing", least=1)] = 1
    """Number of processes, with one thread each. Times are comparable only if every process has a core."""
    renderer: Annotated[Literal["auto", "gl", "rays"], Option(group="measurement")] = "auto"
    """The simulator's renderer."""
    clock: Annotated[Clock, Option(group="timing")] = "wall"
    """Clock: elapsed time, or the processor time of the thread, which hardly depends on other load."""
    figures: Annotated[bool, Option(group="output")] = True
    """Draw the figures (needs the extra 'viz')."""
    json: Annotated[bool, Option(group="output")] = False
    """Print JSON instead of Markdown."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return its exit code."""
    args = parse(Table, argv, "shape-obs bench table")
    from shape_obs.utils.files import make_folder, write_text
    from tests.benchmarks.interleaved_timing import machine
    from tests.benchmarks.table.figures import draw
    from tests.benchmarks.table.report import as_values, markdown
    from tests.benchmarks.table.run import Plan, run
    from tests.benchmarks.table.summary import every_row, rankings, results, tracings
    from tests.benchmarks.tables import as_csv

    if args.figures:
        need_matplotlib()
    folder = make_folder(args.out)
    whole, named = Plan(args.frames, args.seed, args.renderer, clock=args.clock), set(args.only).__contains__
    methods, traced = tuple(filter(named, whole.methods)), tuple(filter(named, whole.tracings))
    if not methods and not traced:
        methods, traced = whole.methods, whole.tracings
    names = tuple(filter(named, whole.names)) or whole.names
    plan = replace(whole, names=names, methods=methods, tracings=traced)
    with progress("table", "chunk") as bar:

        def tick(finished: int, total: int) -> None:
            bar.total = total
            bar.update(finished - bar.n)

        done = run(plan, folder, jobs=args.jobs, redo=args.redo, tick=tick)
    found, ranked, traces = results(done, whole), rankings(done, whole), tracings(done, whole)
    page = markdown(whole, machine(), found, ranked, traces)
    values = json.dumps(as_values(whole, machine(), found, ranked, traces), indent=2)
    write_text(folder / "table.md", page)
    write_text(folder / "table.json", values + "\n")
    write_text(folder / "frames.csv", as_csv(every_row(done)))
    if args.figures and found:
        draw(plan, found, folder)
    print(values if args.json else page)
    return 0
