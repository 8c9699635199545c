"""The table and pictures of 'The paper's table', from the folder of a run:

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
PAGE, IMAGES = DOCS / "benchmarks" / "table-1.md", DOCS / "images"


def main(folder: Path) -> None:
    """Put what the run has written between the marks of the page, and its pictures into the docs."""
    measured = (folder / "table.md").read_text(encoding="utf-8").replace("\n## ", "\n### ")
    page, count = re.subn(
        r"(<!-- table -->\n).*?(<!-- end -->)",
        lambda found: f"{found[1]}\n{measured}\n{found[2]}",
        PAGE.read_text(encoding="utf-8"),
        flags=re.DOTALL,
    )
    assert count == 1, f"{PAGE} has {count} places for the table"
    PAGE.write_text(page, encoding="utf-8")
    for name in PICTURES:
        shutil.copyfile(folder / name, IMAGES / f"table_{name}")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit("usage: table.py FOLDER")
    main(Path(sys.argv[1]))
