"""Fill the pages on the paper's Table I, and copy their pictures, from the folder of a run:

shape-obs bench table --out table
uv run python docs/pictures/table.py table
"""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

from shape_obs.bench.table.figures import PICTURES

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


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit("usage: table.py FOLDER")
    main(Path(sys.argv[1]))
