"""Fill the pages on the paper's Table I, and copy their pictures, from the folder of a run:

shape-obs bench table --out table
uv run python docs/pictures/table.py table

Without a folder, the bars are drawn again from the tables of the second page.
"""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

from tests.benchmarks.table.figures import PICTURES, draw_bars
from tests.benchmarks.table.frames import CONFIGURATIONS
from tests.benchmarks.table.summary import LABELS
from tests.benchmarks.tables import Row

DOCS = Path(__file__).parent.parent
PAGES = {
    "table": DOCS / "benchmarks" / "table-1.md",
    "details": DOCS / "benchmarks" / "table-1-configurations.md",
}
IMAGES = DOCS / "images"


def main(folder: Path) -> None:
    """Fill the marked blocks of both pages from a run, and copy its pictures into the docs."""
    measured = (folder / "table.md").read_text(encoding="utf-8")
    first = re.search(r"^## (?!All three)", measured, flags=re.MULTILINE)
    split = first.start() if first else len(measured)
    blocks = {"table": measured[:split].replace("\n## ", "\n### "), "details": measured[split:]}
    for name, page in PAGES.items():
        text, count = re.subn(
            rf"(<!-- {name} -->\n).*?(<!-- end -->)",
            lambda found, block=blocks[name]: f"{found[1]}\n{block.strip()}\n\n{found[2]}",
            page.read_text(encoding="utf-8"),
            flags=re.DOTALL,
        )
        assert count == 1, f"{page} has {count} places for the table"
        page.write_text(text, encoding="utf-8")
    for name in PICTURES:
        shutil.copyfile(folder / name, IMAGES / f"table_{name}")


def read_page() -> list[Row]:
    """Read the means of the page's tables and half their 95 % intervals, as the bars need them."""
    page = PAGES["details"].read_text(encoding="utf-8")
    return [row for name in CONFIGURATIONS for row in _read_table(page, name)]


def _read_table(page: str, name: str) -> list[Row]:
    """Read the table of a configuration, which stands below its heading."""
    title = name.capitalize()
    table = re.search(
        rf"^## {title}, .*\n\n\|  \| SC \| CH \| time \[s\] \|.*\n.*\n((?:\|.*\n)+)", page, flags=re.MULTILINE
    )
    if table is None:
        raise ValueError(
            f"{PAGES['details']}: expected the heading '## {title}, ...' and directly below it a table with the "
            "columns '', 'SC', 'CH', 'time [s]'."
        )
    methods, found = {label: method for method, label in LABELS.items()}, []
    for line in table[1].splitlines():
        label, *cells = line.strip("| ").split(" | ")
        row = Row(configuration=name, method=methods[label])
        for measure, cell, factor in zip(("sc", "ch", "ms"), cells, (1, 1, 1000), strict=False):
            mean, _, half = cell.partition(" ± ")
            row |= {measure: factor * float(mean), f"{measure}_half_interval": factor * float(half or "nan")}
        found.append(row)
    return found


if __name__ == "__main__":
    if len(sys.argv) > 2:
        raise SystemExit("usage: table.py [FOLDER]")
    if len(sys.argv) == 2:
        main(Path(sys.argv[1]))
    else:
        draw_bars(read_page()).savefig(IMAGES / "table_bars.png", dpi=105)
