"""What the pictures of 'Speed' need, from the tables that stand on the pages."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parent.parent
PAGES = {"peers": DOCS / "benchmarks" / "speed-methods.md", "latency": DOCS / "benchmarks" / "speed-pipeline.md"}
BLOCK = r"(<!-- {name} -->\n).*?(<!-- end -->)"
Document = dict[str, Any]
Row = dict[str, Any]


def read_pages() -> dict[str, Document]:
    """What the pictures need of the results, from the tables of the pages."""
    peers, latency = (PAGES[name].read_text(encoding="utf-8") for name in ("peers", "latency"))
    works: dict[str, Document] = {}
    for work in ("rope", "contour", "cloth"):
        found = _block(peers, work)
        sizes = re.search(r"(\d+) points from (\d+) pixels", found)
        assert sizes is not None, work
        rows = [{"method": row["Method"], "median_ms": _value(row["Median [ms]"])} for row in _rows(found)]
        works[work] = {"points": int(sizes[1]), "samples": int(sizes[2]), "rows": rows}
    totals, stages, growth = (_rows(_block(latency, name)) for name in ("totals", "stages", "growth"))
    return {
        "peers": {"works": works},
        "latency": {
            "totals": [
                {"image": row["Image"], "method": row["Method"], "median_ms": _value(row["Median [ms]"])}
                for row in totals
            ],
            "stages": [
                {
                    "image": row.pop("Image"),
                    "method": row.pop("Method"),
                    **{name.lower(): _value(text) for name, text in row.items()},
                }
                for row in stages
            ],
            "growth": [
                {"grows": row["What grows"], "amount": int(row["To"]), "median_ms": _value(row["Median [ms]"])}
                for row in growth
            ],
        },
    }


def _block(page: str, name: str) -> str:
    found = re.search(BLOCK.format(name=name), page, flags=re.DOTALL)
    assert found is not None, name
    return found[0]


def _rows(block: str) -> list[dict[str, str]]:
    """The rows of a Markdown table by the titles of their columns."""
    lines = [line.strip("| \n").split(" | ") for line in block.splitlines() if line.startswith("| ")]
    return [
        dict(zip(lines[0], (cell.strip("* ") for cell in line), strict=True))
        for line in lines[1:] if not line[0].startswith("--")
    ]  # fmt: skip


def _value(text: str) -> float:
    return float(text.replace(" ", "").removeprefix("<"))
