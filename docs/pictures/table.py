"""Fill the tables of the paper's Table I on the page of speed and draw its bars, from the folder of a run:

shape-obs bench table --clock thread --out table
uv run python docs/pictures/table.py table
"""

from __future__ import annotations

import csv
import re
import sys
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from shape_obs.bench.table import CONFIGURATIONS, LABELS, PAPER

DOCS = Path(__file__).parent.parent
PAGE = DOCS / "benchmarks" / "speed.md"
COLOURS = {"gmm": "#8c9db5", "fcm": "#b59a8c", "kmeans": "#9ab58c", "kohonen": "#b58cab", "som": "#1f6fb4"}
HEADS = {
    "sc": "Silhouette (higher is better)",
    "ch": "Calinski-Harabasz score (higher is better, logarithmic)",
    "ms": "Time per frame [ms] (lower is better, logarithmic)",
}


def main(folder: Path) -> None:
    """Fill the marked blocks of the page, and draw the bars."""
    machine, parts = (folder / "table.md").read_text(encoding="utf-8").split("\n\n## Centerline", 1)
    details, whole = parts.split("## All", 1)
    blocks = {"table": f"{machine}\n\n#### All three configurations{whole}", "details": f"## Centerline{details}"}
    blocks["details"] = re.sub("^##", "####", blocks["details"], flags=re.MULTILINE)
    page = PAGE.read_text(encoding="utf-8")
    for name in blocks:
        page, count = re.subn(
            rf"(<!-- {name} -->\n).*?(<!-- end -->)",
            lambda found, block=blocks[name]: f"{found[1]}\n{block.strip()}\n\n{found[2]}",
            page,
            flags=re.DOTALL,
        )
        assert count == 1, f"{PAGE} has {count} places for the {name}"
    PAGE.write_text(page, encoding="utf-8")
    with (folder / "table.csv").open(encoding="utf-8") as file:
        draw_bars([*csv.DictReader(file)]).savefig(DOCS / "images" / "table_bars.png", dpi=105)


def draw_bars(rows: list[dict[str, str]]) -> Any:
    """Draw the three measures by configuration with intervals, and hatched those of the paper."""
    figure, names = Figure(figsize=(10.2, 9.6), layout="constrained"), list(CONFIGURATIONS)
    for axis, (measure, head) in zip(figure.subplots(3, 1), HEADS.items(), strict=True):
        for i, method in enumerate(LABELS):
            shift = 0.168 * (i - 2)
            own = [row for row in rows if row["method"] == method and row["configuration"] in names]
            places = [names.index(row["configuration"]) + shift for row in own]
            axis.bar(places, [float(row[measure]) for row in own], 0.155, color=COLOURS[method], label=LABELS[method])
            halves = [float(row[f"{measure}_half"]) for row in own]
            axis.errorbar(places, [float(row[measure]) for row in own], halves, fmt="none", ecolor="#22313f", capsize=2)
            if method in PAPER:
                axis.bar(
                    3 + shift, PAPER[method][measure], 0.155, color="white", edgecolor=COLOURS[method], hatch="////"
                )
        axis.set_xticks(range(4), [*names, "as published, on the paper's data"])
        axis.set_title(head, loc="left")
        axis.set(axisbelow=True, yscale="linear" if measure == "sc" else "log")
        axis.grid(axis="y", color="#e4e4e0")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=5, frameon=False)
    return figure


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit("usage: table.py FOLDER")
    main(Path(sys.argv[1]))
