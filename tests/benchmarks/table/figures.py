"""Draw the figures of the table: the methods side by side on the same masks, and bars of the three measures."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.metrics import nearest
from shape_obs.utils.files import write_whole
from tests.benchmarks.table.frames import CONFIGURATIONS, Name, Scene, scenes
from tests.benchmarks.table.methods import Method, Runner, clustered_pixels
from tests.benchmarks.table.run import Plan
from tests.benchmarks.table.summary import LABELS, MEASURES, PAPER
from tests.benchmarks.tables import Row

Array = npt.NDArray[np.float64]

PICTURES: Final = ("side_by_side.jpg", "bars.png")
_FRAME: Final = 4  # of the first chunk, which every run has, when the track has settled
_TINTS: Final = ("#a8c8e8", "#f6cfa5", "#b9dfb6", "#e9b8c4", "#cdbfe3", "#e8e0a2")
_COLOURS: Final[dict[Method, str]] = {
    "gmm": "#8c9db5",
    "fcm": "#b59a8c",
    "kmeans": "#9ab58c",
    "kohonen": "#b58cab",
    "som": "#1f6fb4",
}
_INK, _FIRST, _PAPER = "#22313f", "#d4541a", "#f4f4f2"
_MARGIN: Final = 14  # pixels around the object
_CAPTION: Final = 0.95  # inches above each picture
_DPI: Final = 105


def draw(plan: Plan, found: Sequence[Row], folder: Path) -> list[Path]:
    """Draw both figures into a folder and return their paths."""
    sheets = (_side_by_side(plan), draw_bars(found))
    paths = [folder / name for name in PICTURES]
    for sheet, path in zip(sheets, paths, strict=True):
        quality: dict[str, Any] = {"pil_kwargs": {"quality": 84, "optimize": True}} if path.suffix == ".jpg" else {}
        write_whole(path, partial(sheet.savefig, dpi=_DPI, **quality))
    return paths


def _side_by_side(plan: Plan) -> Any:
    """Draw every method on one frame of every configuration."""
    from matplotlib.figure import Figure

    found = {name: _looked_at(plan, name) for name in plan.names}
    windows = {name: _window(scene) for name, (scene, _) in found.items()}
    heights = [window[3] / window[2] for window in windows.values()]
    width = 3.1
    figure = Figure(figsize=(width * len(plan.methods), sum(heights) * width + _CAPTION * len(heights) + 0.1))
    figure.set_facecolor("white")
    axes = figure.subplots(
        len(found),
        len(plan.methods),
        squeeze=False,
        gridspec_kw={
            "height_ratios": heights,
            "wspace": 0.03,
            "hspace": _CAPTION * len(heights) / (sum(heights) * width),
        },
    )
    figure.subplots_adjust(left=0.005, right=0.995, bottom=0.01, top=1 - _CAPTION / figure.get_figheight())
    for row, name in zip(axes, plan.names, strict=True):
        scene, rows = found[name]
        for axis, method in zip(row, plan.methods, strict=True):
            _panel(axis, name, scene, rows[method], windows[name])
            axis.set_title(_caption(method, rows[method][1]), fontsize=14, color=_INK, loc="left")
    return figure


def _looked_at(plan: Plan, name: Name) -> tuple[Scene, dict[Method, tuple[Array | None, Row]]]:
    """Return the drawn frame, and the points and measures of every method on it."""
    numbers = plan.chunks[0][: _FRAME + 1]
    made = list(scenes(name, 0, len(numbers), plan.seed, plan.renderer))
    found: dict[Method, tuple[Array | None, Row]] = {}
    for method in plan.methods:
        runner = Runner(name, method)
        for scene in made[:-1]:
            runner.points(scene)
        found[method] = runner.measure(made[-1], numbers[-1], exact=True)
    return made[-1], found


def _panel(axis: Any, name: Name, scene: Scene, result: tuple[Array | None, Row], window: tuple[int, ...]) -> None:
    points, _ = result
    left, top, width, height = window
    limits = {"xlim": (left - 0.5, left + width - 0.5), "ylim": (top + height - 0.5, top - 0.5)}
    axis.set(**limits, xticks=[], yticks=[], facecolor=_PAPER)
    axis.spines[:].set_color("#d5d5d0")
    if points is None:
        axis.text(0.5, 0.5, "not found", transform=axis.transAxes, ha="center", color=_FIRST)
        return
    spec = CONFIGURATIONS[name]
    axis.imshow(_tinted(scene, clustered_pixels(spec, scene), points, thick=name == "contour"), interpolation="nearest")
    for edge in spec.layout.edges():
        axis.plot(*points[edge].T, color=_INK, linewidth=0.9, alpha=0.75, zorder=2)
    axis.scatter(*points.T, s=9, color=_INK, zorder=3, linewidths=0)
    axis.scatter(*points[:1].T, s=46, facecolors="none", edgecolors=_FIRST, linewidths=1.4, zorder=4)
    middle = points.mean(axis=0)
    for i, place in enumerate(points):
        away = place - middle if name == "contour" else np.array([0.7, -1.0])
        offset = 6.5 * away / max(float(np.linalg.norm(away)), 1e-9)
        axis.annotate(
            str(i), place, xytext=(offset[0], -offset[1]), textcoords="offset points", fontsize=5.2, color="#5d6b78",
            ha="center", va="center", zorder=5,
        )  # fmt: skip


def _tinted(scene: Scene, pixels: Array, points: Array, *, thick: bool) -> npt.NDArray[np.uint8]:
    """Draw the mask with each clustered pixel in the tint of its cluster; an outline is three pixels thick."""
    from matplotlib.colors import to_rgba_array

    *tints, paper = np.rint(255 * to_rgba_array([*_TINTS, _PAPER])[:, :3])
    picture = np.where(scene.mask[..., None] > 0, 228 if thick else 205, paper).astype(np.uint8)
    colour = np.stack(tints)[nearest(pixels, points) % len(tints)]
    for offset in product((-1, 0, 1), repeat=2) if thick else [(0, 0)]:
        at = np.rint(pixels).astype(int) + offset[::-1]
        inside = np.all((at >= 0) & (at < scene.mask.shape[::-1]), axis=1)
        picture[at[inside, 1], at[inside, 0]] = colour[inside]
    return picture


def _caption(method: Method, row: Row) -> str:
    return f"{LABELS[method]}\nSC {row.sc:.3f}, CH {row.ch:_.0f}\n{row.ms:.1f} ms".replace("_", " ")


def _window(scene: Scene) -> tuple[int, int, int, int]:
    """Return left, top, width and height of the object with a margin."""
    rows, columns = np.nonzero(scene.mask)
    low = np.maximum([columns.min() - _MARGIN, rows.min() - _MARGIN], 0)
    high = np.minimum([columns.max() + _MARGIN + 1, rows.max() + _MARGIN + 1], scene.mask.shape[::-1])
    return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])


def draw_bars(found: Sequence[Row]) -> Any:
    """Draw the three measures by configuration with intervals, and those of the paper."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    shown = [result for result in found if result.configuration in CONFIGURATIONS]
    methods: list[Method] = list(dict.fromkeys(result.method for result in shown))
    names = [name for name in CONFIGURATIONS if any(result.configuration == name for result in shown)]
    figure = Figure(figsize=(10.2, 9.6), layout="constrained")
    heads = {
        "sc": "Silhouette (higher is better)",
        "ch": "Calinski-Harabasz score (higher is better, logarithmic)",
        "ms": "Time per frame [ms] (lower is better, logarithmic)",
    }
    for axis, measure in zip(figure.subplots(3, 1), MEASURES, strict=True):
        wide = 0.84 / max(len(methods), 1)
        for i, method in enumerate(methods):
            shift = (i - (len(methods) - 1) / 2) * wide
            for result in (result for result in shown if result.method == method):
                at, half = names.index(result.configuration) + shift, result[f"{measure}_half_interval"]
                axis.bar(at, result[measure], wide * 0.92, color=_COLOURS[method])
                if np.isfinite(half):
                    axis.errorbar(at, result[measure], half, color=_INK, linewidth=1, capsize=2)
            if method in PAPER:
                axis.bar(
                    len(names) + shift, PAPER[method][measure], wide * 0.92, facecolor="white",
                    edgecolor=_COLOURS[method], hatch="////", linewidth=1.2,
                )  # fmt: skip
        axis.set_xticks(range(len(names) + 1), [*names, "as published, on the paper's data"], fontsize=10)
        axis.set_title(heads[measure], fontsize=12, color=_INK, loc="left")
        axis.set(axisbelow=True, yscale="linear" if measure == "sc" else "log")
        if measure != "sc":
            axis.yaxis.set_major_locator(LogLocator(subs=(1, 3) if measure == "ch" else (1,), numticks=9))
            axis.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axis.yaxis.set_minor_formatter(NullFormatter())
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(axis="y", color="#e4e4e0", linewidth=0.8)
    handles: list[Any] = [Patch(color=_COLOURS[method], label=LABELS[method]) for method in methods]
    handles += [
        Line2D([], [], color=_INK, marker="_", markersize=7, linewidth=0, label="95 % interval"),
        Patch(facecolor="white", edgecolor="#8a8f98", hatch="////", label="published figure"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False, fontsize=10)
    return figure
