"""Fill the pages on speed and draw their pictures, from the results of two commands:

shape-obs bench peers --json > peers.json
shape-obs bench latency --memory 100000 --json > latency.json
uv run python docs/pictures/speed.py peers.json latency.json
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
from matplotlib.ticker import LogLocator, NullFormatter

mpl.use("Agg")

DOCS = Path(__file__).parent.parent
PAGES = {"peers": DOCS / "benchmarks" / "speed-methods.md", "latency": DOCS / "benchmarks" / "speed-pipeline.md"}
IMAGES = DOCS / "images"
OURS, THEIRS, INK = "#2d55c8", "#c8cdd6", "#1e1e1e"
STAGES = ("#2d55c8", "#7f9be8", "#e17828", "#f0b98d", "#3c9650", "#c8cdd6")
METHODS = ("one pass: sumElems", "classic segmentation, full frame", "shape_obs, warm", "shape_obs, cold")
BLOCK = r"(<!-- {name} -->\n).*?(<!-- end -->)"
Document = dict[str, Any]
Row = dict[str, Any]


def main(paths: Iterable[str]) -> None:
    """Fill the pages and draw their pictures from result files of `bench peers` and `bench latency`."""
    measured = {}
    for path in paths:
        document = json.loads(Path(path).read_text(encoding="utf-8"))
        measured[document["measurement"]] = document
    if not measured:
        raise SystemExit("usage: speed.py peers.json latency.json")
    for name, document in measured.items():
        page = PAGES[name].read_text(encoding="utf-8")
        for block, text in blocks({name: document}).items():
            page = filled(page, block, text)
        PAGES[name].write_text(page, encoding="utf-8")
    for name, picture in pictures(measured).items():
        figure = picture()
        figure.savefig(IMAGES / f"speed_{name}.png", dpi=100, bbox_inches="tight")
        plt.close(figure)


def filled(page: str, name: str, block: str) -> str:
    """Replace the text between the marks of a block."""
    page, times = re.subn(BLOCK.format(name=name), lambda found: f"{found[1]}\n{block}\n\n{found[2]}", page, flags=re.S)
    if times != 1:
        raise ValueError(f"expected one block <!-- {name} --> ... <!-- end -->, got {times}.")
    return page


def blocks(measured: dict[str, Document]) -> dict[str, str]:
    """Name of a block -> its Markdown."""
    found: dict[str, str] = {}
    for name, document in measured.items():
        found[f"machine {name}"] = _machine(document)
        found[f"asked {name}"] = _asked(document["claims"])
    if "peers" in measured:
        found |= {work: _peers(part) for work, part in measured["peers"]["works"].items()}
        found["losses"] = _losses(measured["peers"])
    if "latency" in measured:
        latency = measured["latency"]
        parts: dict[str, Callable[[list[Row]], str]] = {"totals": _totals, "stages": _stages, "growth": _growth}
        found |= {name: make(latency[name]) for name, make in parts.items() if name in latency}
    return found


def pictures(measured: dict[str, Document]) -> dict[str, Callable[[], Any]]:
    """Name of a picture -> what draws it."""
    found: dict[str, Callable[[], Any]] = {}
    if "peers" in measured:
        found["peers"] = lambda: draw_peers(measured["peers"]["works"])
    if "stages" in measured.get("latency", {}):
        found["stages"] = lambda: draw_stages(measured["latency"])
    if "growth" in measured.get("latency", {}):
        found["growth"] = lambda: draw_growth(measured["latency"]["growth"])
    return found


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


def _machine(document: Document) -> str:
    machine = dict(document["machine"])
    where = f"{machine.pop('processor')}, {machine.pop('cores')} cores, {machine.pop('system')}"
    packages = ", ".join(f"{name} {version}" for name, version in machine.items())
    run = f"{document['frames']} frames in turns of {document['burst']}, seed {document['seed']}"
    return f"{where}; {packages}; {run}, {document['clock']} clock."


def _asked(claims: list[Row]) -> str:
    reached = {"yes": "yes", "no": "**no**", "not measured": "not measured"}
    rows = ((row["what"], row["asked"], _with_unit(row), reached[row["reached"]]) for row in claims)
    return table(("What", "Target", "Measured", "Reached"), rows)


def _with_unit(claim: Row) -> str:
    """Return the measured value with the unit of its target, as "x", " %" or " MB"."""
    unit = re.sub(r"^\S+ [\d.]+", "", claim["asked"])
    return number(claim["seen"]) + ("" if claim["seen"] is None else unit)


def _peers(part: Document) -> str:
    head = ("Method", "Median [ms]", "Over ours", "SC", "CH", "Spacing CV")
    rows = [
        (
            f"**{row['method']}**" if _is_ours(row) else row["method"],
            number(row["median_ms"]),
            number(row["over_ours"]),
            f"{row['sc']:.3f}",
            number(row["ch"]),
            f"{100 * row['spacing_cv']:.1f} %",
        )
        for row in part["rows"]
    ]
    refused = f" {part['refused']} detections were refused." if part["refused"] else ""
    caption = f"{part['points']} points from {part['samples']} pixels (median), {part['frames']} frames.{refused}"
    slow = [row for row in part["rows"] if row["frames"] < part["frames"]]
    if slow:
        caption += f" On {slow[0]['frames']} frames only: {', '.join(row['method'] for row in slow)}."
    return f"{caption}\n\n{table(head, rows)}"


def _losses(document: Document) -> str:
    """Where another method is faster, or its points stand better for the mask."""
    lines = []
    for work, part in document["works"].items():
        mine = next(row for row in part["rows"] if _is_ours(row))
        for row in part["rows"]:
            if _is_ours(row):
                continue
            better = []
            if row["over_ours"] < 1:
                better.append(f"takes {number(row['over_ours'])} times as long as ours")
            if row["ch"] > 1.0005 * mine["ch"]:
                better.append(f"has a Calinski-Harabasz score {100 * (row['ch'] / mine['ch'] - 1):.1f} % higher")
            if row["sc"] > mine["sc"] + 5e-4:
                better.append(f"has a silhouette {row['sc'] - mine['sc']:.3f} higher")
            if better:
                lines.append(f"- {work}: {row['method']} {', '.join(better)}.")
    return "\n".join(lines) or "Nowhere in this run."


def _totals(rows: list[Row]) -> str:
    """Return a table of times, and one of their ratios to a pass over the image and to the classic segmentation."""
    found = {(row["image"], row["method"]): row for row in rows}
    images = list(dict.fromkeys(row["image"] for row in rows))

    def time(image: str, method: str) -> str:
        row = found.get((image, method))
        return "–" if row is None else f"{number(row['median_ms'])} ({number(row['p95_ms'])})"

    def ratio(image: str, method: str, key: str) -> str:
        row = found.get((image, method))
        return "–" if row is None else number(row[key])

    head = ("Image", "One pass [ms]", "Classic [ms]", "Warm [ms]", "Cold [ms]")
    times = [(image, *(time(image, method) for method in METHODS)) for image in images]
    ours, keys = METHODS[2:], ("passes", "faster_than_classic")
    compared = [(image, *(ratio(image, method, key) for key in keys for method in ours)) for image in images]
    heads = ("Image", "Warm: passes", "Cold: passes", "Warm: times faster than classic", "Cold: times faster")
    return f"{table(head, times)}\n\n{table(heads, compared)}"


def _stages(rows: list[Row]) -> str:
    names = list(rows[0])[2:]
    head = ("Image, detector", *(name.capitalize() for name in names))
    return table(
        head,
        (
            (f"{row['image']}, {row['method'].removeprefix('shape_obs, ')}", *(number(row[name]) for name in names))
            for row in rows
        ),
    )


def _growth(rows: list[Row]) -> str:
    """Return one line for each thing that grows."""
    lines = []
    for grows in dict.fromkeys(row["grows"] for row in rows):
        curve = [row for row in rows if row["grows"] == grows]
        amounts, times = ([row[key] for row in curve] for key in ("amount", "median_ms"))
        lines.append(
            (grows, ", ".join(map(str, amounts)), ", ".join(map(number, times)), number(curve[-1]["times_smallest"]))
        )
    return table(("What grows", "Numbers", "Median [ms]", "Largest over smallest"), lines)


def draw_peers(works: dict[str, Document]) -> Any:
    """Bars of the median times, one panel a work."""
    figure, axes = plt.subplots(1, len(works), figsize=(4.2 * len(works), 3.8), layout="constrained", squeeze=False)
    for axis, (work, part) in zip(axes[0], works.items(), strict=True):
        rows = sorted(part["rows"], key=lambda row: -row["median_ms"])
        names = [row["method"] for row in rows]
        bars = axis.barh(
            names, [row["median_ms"] for row in rows], color=[OURS if _is_ours(row) else THEIRS for row in rows]
        )
        axis.bar_label(bars, [number(row["median_ms"]) for row in rows], padding=3, fontsize=7)
        axis.set_xscale("log")
        axis.set_xlabel("milliseconds per frame", fontsize=8)
        axis.set_title(f"{work}: {part['samples']} pixels to {part['points']} points", fontsize=9)
        axis.tick_params(labelsize=7)
        axis.margins(x=0.2)
        axis.spines[["top", "right"]].set_visible(False)
    return figure


def draw_stages(latency: Document) -> Any:
    """Stacked bars of the stages of a tracked frame, and one pass over the image."""
    figure, axis = plt.subplots(figsize=(5.5, 3.4), layout="constrained")
    rows = [row for row in latency["stages"] if row["method"] == "shape_obs, warm"]
    names = [name for name in (list(rows[0])[2:] if rows else []) if name != "total"]
    sizes, base = [row["image"] for row in rows], [0.0] * len(rows)
    for name, colour in zip(names, STAGES, strict=False):
        axis.bar(sizes, [row[name] for row in rows], bottom=base, color=colour, label=name)
        base = [low + row[name] for low, row in zip(base, rows, strict=True)]
    floor = [row["median_ms"] for row in latency["totals"] if row["method"].startswith("one pass")]
    axis.plot(sizes, floor[: len(sizes)], "_", color=INK, markersize=30, label="one pass over the image")
    axis.set_ylabel("milliseconds per frame", fontsize=8)
    axis.tick_params(labelsize=8)
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(fontsize=8, loc="upper left", reverse=True, markerscale=0.4)
    return figure


def draw_growth(rows: list[Row]) -> Any:
    """One panel for each thing that grows; dotted is proportional growth."""
    grown = list(dict.fromkeys(row["grows"] for row in rows))
    figure, axes = plt.subplots(
        1, len(grown), figsize=(2.8 * len(grown), 2.6), layout="constrained", sharey=True, squeeze=False
    )
    for axis, grows in zip(axes[0], grown, strict=True):
        curve = [row for row in rows if row["grows"] == grows]
        amounts, times = ([row[key] for row in curve] for key in ("amount", "median_ms"))
        axis.loglog(amounts, times, "o-", color=OURS, markersize=4)
        axis.loglog(amounts, [times[0] * amount / amounts[0] for amount in amounts], ":", color=OURS)
        axis.set_xticks(amounts, [f"{amount}" for amount in amounts], fontsize=7)
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter(NullFormatter())
        axis.tick_params(labelsize=7)
        axis.set_title(grows, fontsize=9)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0][0].set_ylabel("milliseconds per frame", fontsize=8)
    return figure


def _is_ours(row: Row) -> bool:
    return row["method"].startswith("shape_obs")


if __name__ == "__main__":
    main(sys.argv[1:])
