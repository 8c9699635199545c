"""Fill the pages on speed and draw their pictures, from the results of two commands:

shape-obs bench peers --json > peers.json
shape-obs bench latency --memory 100000 --json > latency.json
uv run python docs/pictures/speed.py peers.json latency.json

Without files, the pictures are drawn again from the tables that stand on the pages.
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
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, NullFormatter, NullLocator
from speed_page import DOCS, PAGES, TIMES, Document, Row, filled, number, read_pages, table

mpl.use("Agg")

IMAGES = DOCS / "images"
OURS, THEIRS, INK = "#2d55c8", "#c8cdd6", "#1e1e1e"
PROPORTIONAL = "#8a8f98"
STAGES = ("#2d55c8", "#8fa8ec", "#3c9650", "#b6d9bd", "#8a56a8", "#c8cdd6")
STAGE_NAMES = {
    "segmentation": "segmentation: image to mask",
    "fit": "fit: mask to points",
    "lift": "lift: points to 3D",
}
DPI, LETTERS, SMALL = 130, 8.5, 8  # figures are 8.3 inches wide, so that letters of 8 points are 11 pixels high at 830


def main(paths: Iterable[str]) -> None:
    """Fill the pages and draw their pictures from result files of `bench peers` and `bench latency`."""
    measured = {}
    for path in paths:
        document = json.loads(Path(path).read_text(encoding="utf-8"))
        measured[document["measurement"]] = document
    for name, document in measured.items():
        page = PAGES[name].read_text(encoding="utf-8")
        for block, text in blocks({name: document}).items():
            page = filled(page, block, text)
        PAGES[name].write_text(page, encoding="utf-8")
    for name, picture in pictures(measured or read_pages()).items():
        figure = picture()
        figure.savefig(IMAGES / f"speed_{name}.png", dpi=DPI, bbox_inches="tight")
        plt.close(figure)


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

    times = [(image, *(time(image, method) for method in TIMES.values())) for image in images]
    ours, keys = list(TIMES.values())[2:], ("passes", "faster_than_classic")
    compared = [(image, *(ratio(image, method, key) for key in keys for method in ours)) for image in images]
    head = ("Image", *TIMES)
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
    heights = [len(part["rows"]) for part in works.values()]
    figure, axes = plt.subplots(
        len(works), 1, figsize=(8.3, 0.9 * len(works) + 0.26 * sum(heights)), layout="constrained", squeeze=False,
        sharex=True, gridspec_kw={"height_ratios": heights},
    )  # fmt: skip
    for axis, (work, part) in zip(axes[:, 0], works.items(), strict=True):
        rows = sorted(part["rows"], key=lambda row: -row["median_ms"])
        names = [row["method"] for row in rows]
        bars = axis.barh(
            names, [row["median_ms"] for row in rows], color=[OURS if _is_ours(row) else THEIRS for row in rows]
        )
        axis.bar_label(bars, [f"{number(row['median_ms'])} ms" for row in rows], padding=3, fontsize=SMALL)
        axis.set_xscale("log")
        axis.xaxis.set_major_formatter("{x:g}")
        axis.set_title(f"{work.capitalize()}: {part['samples']} pixels to {part['points']} points", fontsize=10)
        axis.tick_params(labelsize=SMALL, labelbottom=True)
        axis.margins(x=0.1)
        axis.spines[["top", "right"]].set_visible(False)
    axes[-1][0].set_xlabel("median time per frame [ms], logarithmic; shorter bars are faster", fontsize=LETTERS)
    handles = [Patch(color=OURS, label="this library"), Patch(color=THEIRS, label="other methods")]
    figure.legend(handles=handles, loc="outside upper center", ncols=2, frameon=False, fontsize=LETTERS)
    return figure


def draw_stages(latency: Document) -> Any:
    """Stacked bars of the stages of a tracked frame, and one pass over the image."""
    figure, axis = plt.subplots(figsize=(8.3, 4.2), layout="constrained")
    rows = [row for row in latency["stages"] if row["method"] == "shape_obs, warm"]
    names = [name for name in (list(rows[0])[2:] if rows else []) if name != "total"]
    sizes, base = [row["image"] for row in rows], [0.0] * len(rows)
    for name, colour in zip(names, STAGES, strict=False):
        axis.bar(sizes, [row[name] for row in rows], bottom=base, color=colour, label=STAGE_NAMES.get(name, name))
        base = [low + row[name] for low, row in zip(base, rows, strict=True)]
    floor = [row["median_ms"] for row in latency["totals"] if row["method"].startswith("one pass")]
    axis.plot(
        sizes, floor[: len(sizes)], "_", color=INK, markersize=40, markeredgewidth=2.5,
        label="for comparison: one pass over the image",
    )  # fmt: skip
    axis.set_ylabel("median time per frame [ms]", fontsize=LETTERS)
    axis.set_xlabel("image size [pixels]", fontsize=LETTERS)
    axis.tick_params(labelsize=LETTERS)
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(fontsize=LETTERS, loc="upper left", reverse=True, markerscale=0.5)
    return figure


def draw_growth(rows: list[Row]) -> Any:
    """One panel for each thing that grows; dotted is proportional growth."""
    grown = list(dict.fromkeys(row["grows"] for row in rows))
    columns = min(2, len(grown))
    lines = -(-len(grown) // columns)
    figure, axes = plt.subplots(
        lines, columns, figsize=(8.3, 0.5 + 2.4 * lines), layout="constrained", sharey=True, squeeze=False
    )
    for axis in axes.flat[len(grown) :]:
        axis.set_visible(False)
    for axis, grows in zip(axes.flat, grown, strict=False):
        curve = [row for row in rows if row["grows"] == grows]
        amounts, times = ([row[key] for row in curve] for key in ("amount", "median_ms"))
        axis.loglog(amounts, [times[0] * amount / amounts[0] for amount in amounts], ":", color=PROPORTIONAL, lw=2)
        axis.loglog(amounts, times, "o-", color=OURS, markersize=5)
        axis.set_xticks(amounts, [f"{amount}" for amount in amounts])
        axis.xaxis.set_minor_locator(NullLocator())
        axis.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter(NullFormatter())
        axis.tick_params(labelsize=LETTERS, labelleft=True)
        axis.set_xlabel(f"number of {grows}", fontsize=LETTERS)
        axis.spines[["top", "right"]].set_visible(False)
    for line in axes:
        line[0].set_ylabel("time per frame [ms]", fontsize=LETTERS)
    handles = [
        Line2D([], [], color=OURS, marker="o", markersize=5, label="measured median"),
        Line2D([], [], color=PROPORTIONAL, linestyle=":", lw=2, label="growth in proportion to the number"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=2, frameon=False, fontsize=LETTERS)
    return figure


def _is_ours(row: Row) -> bool:
    return row["method"].startswith("shape_obs")


if __name__ == "__main__":
    main(sys.argv[1:])
