"""Draw the results of a study: the error over time, and the shapes at the start, at the end and at the goal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.drawing import GOAL
from shape_obs.utils.files import write_whole
from tests.benchmarks.servo.episode import REACHED, Found
from tests.benchmarks.servo.settings import LAYOUTS, Difficulty, Setting
from tests.benchmarks.tables import Row

Array = npt.NDArray[np.float64]

PICTURES: Final = ("curves.png", "overlays.png")
_INK: Final = "#22313f"
_COLOURS: Final = (
    "#1f6fb4", "#d4541a", "#3a8f4d", "#8a56a8", "#b08a1e", "#2a9aa0", "#c0417c", "#6d6d6d", "#7a4a2b", "#4b5fd0",
)  # fmt: skip
_LINES: Final[dict[str, dict[str, Any]]] = {
    "start": {"color": "#b8bcc0", "linewidth": 2.0},
    "final": {"color": _COLOURS[0], "linewidth": 1.8},
    "goal": {"color": tuple(level / 255 for level in GOAL), "linewidth": 2.0, "linestyle": ":"},
}
_STYLES: Final = {"camera": "-", "truth": (0, (4, 2))}
_DPI: Final = 110
_FINEST: Final = 0.3  # millimetres; only the true points get below it


def draw(found: Found, folder: Path) -> list[Path]:
    """Draw both pictures of the episodes that did not break off; return the paths, none without such episodes."""
    whole = {setting: [each for each in some if not each.failure] for setting, some in found.items()}
    whole = {setting: some for setting, some in whole.items() if some}
    if not whole:
        return []
    paths = [folder / name for name in PICTURES]
    for sheet, path in zip((_curves(whole), _overlays(whole)), paths, strict=True):
        write_whole(path, lambda temporary, sheet=sheet: sheet.savefig(temporary, dpi=_DPI))
    return paths


def _curves(found: Found) -> Any:
    """Draw median and quartiles of the error over time, a line for each law or each feature set, whichever are more."""
    from matplotlib.figure import Figure

    many = _distinct(setting.features for setting in found), _distinct(setting.law for setting in found)
    by_law = len(many[1]) >= len(many[0])
    lines = many[by_law]
    panels = _distinct(_panel(setting, by_law) for setting in found)
    columns: list[Difficulty] = _distinct(setting.difficulty for setting in found)
    figure = Figure(figsize=(0.9 + 2.7 * len(columns), 0.9 + 2.3 * len(panels)), layout="constrained")
    axes = figure.subplots(len(panels), len(columns), squeeze=False, sharex=True, sharey=True)
    for setting, some in found.items():
        axis = axes[panels.index(_panel(setting, by_law)), columns.index(setting.difficulty)]
        line = setting.law if by_law else setting.features
        colour = _COLOURS[lines.index(line) % len(_COLOURS)]
        errors = np.array([episode.errors_mm for episode in some])
        low, middle, high = np.percentile(errors, [25, 50, 75], axis=0)
        steps = np.arange(errors.shape[1])
        axis.plot(steps, middle, color=colour, linewidth=1.6, linestyle=_STYLES[setting.source])
        if setting.source == "camera" or not any(other.source == "camera" for other in found):
            axis.fill_between(steps, low, high, color=colour, alpha=0.14, linewidth=0)
    for row, panel in zip(axes, panels, strict=True):
        for axis, difficulty in zip(row, columns, strict=True):
            _plain(axis, f"{' '.join(panel)}, {difficulty}")
            axis.set(yscale="log", xlabel="step" if panel == panels[-1] else "")
            axis.set_ylim(bottom=_FINEST)
            axis.yaxis.set_major_formatter("{x:g}")
            axis.axhline(REACHED, color=_INK, linewidth=0.8, linestyle=":")
        row[0].set_ylabel("mean error [mm]")
    figure.legend(handles=_legend(lines, found), loc="outside upper center", ncols=5, frameon=False, fontsize=9)
    return figure


def _panel(setting: Setting, by_law: bool) -> tuple[str, ...]:
    return setting.env, setting.size, setting.features if by_law else setting.law


def _legend(lines: Sequence[str], found: Found) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [Line2D([], [], color=_COLOURS[i % len(_COLOURS)], label=line) for i, line in enumerate(lines)]
    for source in _distinct(setting.source for setting in found):
        name = {"camera": "from the camera", "truth": "from the true points"}[source]
        handles.append(Line2D([], [], color="#777777", linestyle=_STYLES[source], label=name))
    reached = Line2D([], [], color=_INK, linewidth=0.8, linestyle=":", label=f"{REACHED:g} mm: goal reached")
    return [*handles, Patch(color="#777777", alpha=0.2, label="quartiles"), reached]


def _overlays(found: Found) -> Any:
    """Draw a good goal, the median one and the worst of the best setting of each environment and difficulty."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    groups = _distinct((setting.env, setting.difficulty) for setting in found)
    figure = Figure(figsize=(10.2, 0.6 + 3.1 * len(groups)), layout="constrained")
    axes = figure.subplots(len(groups), 3, squeeze=False)
    for row, group in zip(axes, groups, strict=True):
        setting = max(
            (setting for setting in found if (setting.env, setting.difficulty) == group),
            key=lambda setting: _worth(setting, found[setting]),
        )
        ranked = sorted(found[setting], key=lambda episode: episode.final_mm)
        shown = {"good": ranked[len(ranked) // 4], "median": ranked[len(ranked) // 2], "worst": ranked[-1]}
        for axis, (name, episode) in zip(row, shown.items(), strict=True):
            _shapes(axis, setting, episode)
            _plain(axis, f"{name}: seed {episode.seed}, {episode.start_mm:.0f} to {episode.final_mm:.1f} mm")
        label = f"{setting.env}, {setting.difficulty}\n{setting.features}, {setting.law}\n{row[0].get_ylabel()}"
        row[0].set_ylabel(label, fontsize=9)
    handles = [Line2D([], [], label="end" if name == "final" else name, **style) for name, style in _LINES.items()]
    handles.append(Line2D([], [], color="#777777", marker="o", markersize=4, linewidth=0, label="point 0"))
    title = "mean distance from the goal at the start and at the end above each panel"
    figure.legend(
        handles=handles, loc="outside upper center", ncols=4, frameon=False, fontsize=9, title=title, title_fontsize=9
    )
    return figure


def _worth(setting: Setting, some: Sequence[Row]) -> tuple[bool, int, float]:
    """Return the rank of a setting: the camera first, then by goals reached, then by the final error."""
    final = float(np.median([episode.final_mm for episode in some]))
    return setting.source == "camera", sum(episode.success for episode in some), -final


def _shapes(axis: Any, setting: Setting, episode: Row) -> None:
    """Draw the start in grey, the end in blue and the goal as orange dots; point 0 is marked."""
    edges, plane = LAYOUTS[setting.env].edges(), _plane(episode)
    for name, style in _LINES.items():
        points = np.asarray(episode[name])[:, plane]
        axis.plot(*points[edges].transpose(2, 1, 0), **style)
        axis.plot(*points[0], marker="o", markersize=4, color=style["color"])
    axis.set(xlabel="xyz"[plane[0]] + " [mm]", ylabel="xyz"[plane[1]] + " [mm]")
    axis.set_aspect("equal", adjustable="datalim")


def _plane(episode: Row) -> list[int]:
    """Return the two axes in which to draw: from above, or from the front where the shapes are higher than deep."""
    _, depth, height = np.ptp(np.concatenate([np.asarray(episode[name]) for name in _LINES]), axis=0)
    return [0, 1] if depth >= height else [0, 2]


def _plain(axis: Any, title: str) -> None:
    axis.set_title(title, fontsize=9, color=_INK)
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(color="#e4e4e0", linewidth=0.7)
    axis.set_axisbelow(True)
    axis.tick_params(labelsize=8)


def _distinct(values: Iterable[Any]) -> list[Any]:
    return list(dict.fromkeys(values))
