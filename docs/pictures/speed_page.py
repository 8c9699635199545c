"""The Markdown tables of the pages on speed: how they are written, and what the pictures read back from them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parent.parent
PAGES = {"peers": DOCS / "benchmarks" / "speed-methods.md", "latency": DOCS / "benchmarks" / "speed-pipeline.md"}
BLOCK = r"(<!-- {name} -->\n).*?(<!-- end -->)"
TIMES = {
    "One pass [ms]": "one pass: sumElems",
    "Classic [ms]": "classic segmentation, full frame",
    "Warm [ms]": "shape_obs, warm",
    "Cold [ms]": "shape_obs, cold",
}  # column of the table of times -> method
Document = dict[str, Any]
Row = dict[str, Any]


def filled(page: str, name: str, block: str) -> str:
    """Replace the text between the marks of a block."""
    page, times = re.subn(BLOCK.format(name=name), lambda found: f"{found[1]}\n{block}\n\n{found[2]}", page, flags=re.S)
    if times != 1:
        raise ValueError(f"expected one block <!-- {name} --> ... <!-- end -->, got {times}.")
    return page


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table."""
    titles = list(head)
    lines = ["| " + " | ".join(line) + " |" for line in (titles, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(titles), *lines[1:]])


def number(value: float | None) -> str:
    """Three digits that count."""
    if value is None:
        return "–"
    if 0 < value < 1e-3:
        return "< 0.001"
    if value >= 100:
        return f"{value:,.0f}".replace(",", " ")
    return f"{value:.3g}"


def read_pages() -> dict[str, Document]:
    """Read what the pictures need of the results from the tables of the pages."""
    works = {work: _work(work) for work in ("rope", "contour", "cloth")}
    return {"peers": {"works": works}, "latency": {"totals": _totals(), "stages": _stages(), "growth": _growth()}}


def _work(work: str) -> Document:
    sizes = re.search(r"(\d+) points from (\d+) pixels", _block("peers", work))
    if sizes is None:
        raise ValueError(f"{PAGES['peers']}: expected 'N points from M pixels' in the block <!-- {work} -->.")
    rows = _rows("peers", work, "Method", "Median [ms]")
    times = [{"method": row["Method"], "median_ms": _value(row["Median [ms]"])} for row in rows]
    return {"points": int(sizes[1]), "samples": int(sizes[2]), "rows": times}


def _totals() -> list[Row]:
    """Read the first of the two tables; in its cells the median is followed by the 95 % quantile in brackets."""
    return [
        {"image": row["Image"], "method": method, "median_ms": _value(row[column].split(" (")[0])}
        for row in _rows("latency", "totals", "Image", *TIMES)
        for column, method in TIMES.items()
        if row[column] != "–"
    ]


def _stages() -> list[Row]:
    found = []
    for row in _rows("latency", "stages", "Image, detector", "Total"):
        image, detector = row.pop("Image, detector").split(", ")
        times = {name.lower(): _value(text) for name, text in row.items()}
        found.append({"image": image, "method": f"shape_obs, {detector}", **times})
    return found


def _growth() -> list[Row]:
    return [
        {"grows": row["What grows"], "amount": int(amount), "median_ms": _value(median)}
        for row in _rows("latency", "growth", "What grows", "Numbers", "Median [ms]")
        for amount, median in zip(row["Numbers"].split(", "), row["Median [ms]"].split(", "), strict=True)
    ]


def _block(page: str, name: str) -> str:
    found = re.search(BLOCK.format(name=name), PAGES[page].read_text(encoding="utf-8"), flags=re.DOTALL)
    if found is None:
        raise ValueError(f"{PAGES[page]}: expected a block <!-- {name} --> ... <!-- end -->.")
    return found[0]


def _rows(page: str, name: str, *columns: str) -> list[dict[str, str]]:
    """Return the rows of the first table of a block by the titles of its columns, some of which it must have."""
    found = re.search(r"^\|.*(?:\n\|.*)*", _block(page, name), flags=re.MULTILINE)
    head, _, *lines = (line.strip("| ").split(" | ") for line in found[0].splitlines()) if found else ([], [])
    if not set(columns) <= set(head):
        raise ValueError(
            f"{PAGES[page]}: expected a table with the columns {', '.join(map(repr, columns))} first in the block "
            f"<!-- {name} -->, got {', '.join(map(repr, head)) or 'none'}."
        )
    return [dict(zip(head, (cell.strip("* ") for cell in line), strict=True)) for line in lines]


def _value(text: str) -> float:
    return float(text.replace(" ", "").removeprefix("<"))
