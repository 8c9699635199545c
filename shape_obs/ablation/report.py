"""Report a study: tables as Markdown and JSON, and pictures of learning curves, final scores and disturbances."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from shape_obs.ablation.statistics import LEVELS, ArmSummary, Interval, groups
from shape_obs.ablation.study import Study
from shape_obs.utils.errors import install_hint
from shape_obs.utils.files import write_text, write_whole

Summary = Mapping[str, ArmSummary]

TABLE: Final = "table.md"
_NONE: Final = "–"
CURVES: Final = "curves.png"
INTERVALS: Final = "intervals.png"
DEGRADATION: Final = "degradation.png"
_INK, _GRID = "#22313f", "#e4e4e0"
_COLOURS: Final = (
    "#1f6fb4", "#d4541a", "#3a8f4d", "#8a56a8", "#b08a1e", "#2a9aa0", "#c0417c", "#6d6d6d", "#7a4a2b", "#4b5fd0",
)  # fmt: skip
_DPI: Final = 110


# ---- Tables


def write_table(study: Study, summary: Mapping[str, ArmSummary], root: Path) -> Path:
    """Write ``table.md`` and return its path."""
    text = markdown(study, summary) + "\n"
    write_text(root / TABLE, text)
    return root / TABLE


def markdown(study: Study, summary: Mapping[str, ArmSummary]) -> str:
    """Return all tables as Markdown, each with a title."""
    plan, parts = study.evaluation, list(groups(study))
    reference = study.reference or next(iter(study.arms))
    bracket = "in brackets its 95 % stratified bootstrap interval"
    sheets = [
        f"{study.algorithm} on {study.env}, {study.steps:,} steps; {plan.final_goals} held-out goals of each "
        f"difficulty, scored by the true points. Interquartile mean over runs, {bracket}.",
        _table(
            "Goals reached in the last evaluation [%]",
            ["arm", "runs", *parts],
            [[arm, each.runs, *(_cell(each.success[name], 1) for name in parts)] for arm, each in summary.items()],
        ),
        _table(
            "Mean final error [mm]",
            ["arm", *parts],
            [[arm, *(_cell(each.final_mm[name], 2) for name in parts)] for arm, each in summary.items()],
        ),
        _table(
            f"Steps of training until {', '.join(map(str, LEVELS))} % are reached, as seen every {plan.every:,} steps",
            ["arm", *parts],
            [[arm, *(" / ".join(map(_steps, each.steps_to[name])) for name in parts)] for arm, each in summary.items()],
        ),
        _table(
            "Goals reached on average over the training [%]",
            ["arm", *parts],
            [[arm, *(_cell(each.area[name], 1) for name in parts)] for arm, each in summary.items()],
        ),
        _table(
            "Milliseconds per step, with the environment",
            ["arm", "in training", "with the trained policy"],
            [[arm, f"{each.ms_training:.1f}", f"{each.ms_acting:.1f}"] for arm, each in summary.items()],
        ),
    ]
    if plan.disturbances:
        sheets.append(
            _table(
                "Lost under disturbances that no training saw [percentage points]",
                ["arm", *plan.disturbances],
                [
                    [arm, *(_cell(each.lost.get(name), 1) for name in plan.disturbances)]
                    for arm, each in summary.items()
                ],
            )
        )
    if any(each.difference for each in summary.values()):
        sheets.append(
            _table(
                f"Against {reference}: goals reached [percentage points], and the probability that a run reaches more",
                ["arm", "difference", "probability"],
                [
                    [arm, _cell(each.difference, 1, sign=True), _cell(each.improvement, 2)]
                    for arm, each in summary.items()
                    if each.difference
                ],
            )
        )
    return "\n\n".join(sheets)


def _table(title: str, head: Sequence[object], rows: Sequence[Sequence[object]]) -> str:
    lines = [list(head), ["---", *["---:"] * (len(head) - 1)], *rows]
    return "\n".join([f"**{title}**", "", *("| " + " | ".join(map(str, line)) + " |" for line in lines)])


def _cell(found: Interval | None, digits: int, sign: bool = False) -> str:
    """Return an interval as text, such as ``"91.3 [88.0, 94.7]"``."""
    if found is None:
        return _NONE
    form = f"{'+' if sign else ''}.{digits}f"
    bounds = "" if np.isnan(found.low) else f" [{found.low:{form}}, {found.high:{form}}]"
    return f"{found.value:{form}}{bounds}"


def _steps(steps: int | None) -> str:
    return _NONE if steps is None else f"{steps:,}"


def summary_to_dict(summary: Mapping[str, ArmSummary]) -> dict[str, Any]:
    """Return the summary as JSON values, with intervals as ``[value, low, high]`` and None for missing bounds."""

    def to_json(value: Any) -> Any:
        if isinstance(value, Interval):
            return [None if np.isnan(number) else round(number, 4) for number in value]
        if isinstance(value, Mapping):
            return {str(key): to_json(item) for key, item in value.items()}
        return list(value) if isinstance(value, tuple) else value

    return {arm: {name: to_json(value) for name, value in vars(each).items()} for arm, each in summary.items()}


# ---- Pictures


def need_matplotlib() -> None:
    """Raise ``ImportError`` if Matplotlib is missing, before any work is done."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise ImportError(f"the pictures need Matplotlib: {install_hint('viz')}") from error


def draw(study: Study, summary: Summary, root: Path) -> list[Path]:
    """Draw ``curves.png``, ``intervals.png`` and, with disturbances, ``degradation.png``; return their paths.

    Raises:
        ImportError: Matplotlib is missing.
    """
    need_matplotlib()
    sheets: dict[str, Callable[[Study, Summary], Any]] = {CURVES: _curves, INTERVALS: _intervals}
    if any(each.lost for each in summary.values()):
        sheets[DEGRADATION] = draw_degradation
    for name, sheet in sheets.items():
        figure = sheet(study, summary)
        write_whole(root / name, lambda path, figure=figure: figure.savefig(path, dpi=_DPI))
    return [root / name for name in sheets]


def _curves(study: Study, summary: Summary) -> Any:
    """Draw goals reached over the steps of training, with a panel for each difficulty."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    panels = list(groups(study))
    columns = 2 if len(panels) > 2 else len(panels)
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(1.2 + 3.4 * columns + (columns == 1), 0.5 + 3.0 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    handles: list[Any] = []
    for arm, each in summary.items():
        colour = _colour(study, arm)
        for axis, name in zip(axes, panels, strict=False):
            steps = np.array(list(each.curve[name])) / 1e3
            value, low, high = np.array(list(each.curve[name].values())).T
            axis.plot(
                steps, value, color=colour, linewidth=1.7, linestyle=_style(study, arm), label=arm, marker="o",
                markersize=2.5, clip_on=False,
            )  # fmt: skip
            axis.fill_between(steps, low, high, color=colour, alpha=0.14, linewidth=0)
        handles.append(axes[0].get_lines()[-1])
    for axis, name in zip(axes, panels, strict=False):
        _style_axis(axis)
        axis.set_ylim(0, 100)
        axis.set_xlim(left=0)
        axis.set_title(_title(name), fontsize=9, color=_INK)
        axis.tick_params(labelbottom=True, labelleft=True)
        axis.set_xlabel("thousand steps of training", fontsize=9)
    for axis in axes[::columns]:
        axis.set_ylabel("goals reached [%]", fontsize=9)
    if any(each.runs > 1 for each in summary.values()):
        handles.append(Patch(color="#777777", alpha=0.2, label="95 % interval"))
    entries = 4 if columns == 1 else 7
    figure.legend(handles=handles, loc="outside upper center", ncols=entries, frameon=False, fontsize=9)
    return figure


def _intervals(study: Study, summary: Summary) -> Any:
    """Draw goals reached in the last evaluation, with a panel for each difficulty."""
    panels = {_title(name): {arm: each.success[name] for arm, each in summary.items()} for name in groups(study)}
    figure, axes = _bars(study, list(summary), panels, "goals reached [%]")
    for axis in axes:
        axis.set_xlim(0, 100)
        for line in axis.get_lines():
            line.set_clip_on(False)
    return figure


def draw_degradation(study: Study, summary: Summary) -> Any:
    """Draw the decrease of goals reached, with a panel for each disturbance."""
    arms = [arm for arm, each in summary.items() if each.lost]
    names = study.evaluation.disturbances
    panels = {name: {arm: summary[arm].lost[name] for arm in arms} for name in names}
    figure, axes = _bars(study, arms, panels, "goals lost [percentage points]; above 0: fewer reached than without it")
    for axis in axes:
        axis.axvline(0, color=_INK, linewidth=0.8, zorder=0.9)
    return figure


def _bars(study: Study, arms: Sequence[str], panels: Mapping[str, Mapping[str, Interval]], label: str) -> Any:
    """Draw a row for each arm, with the interval as a bar and the value as a line in it."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    figure = Figure(figsize=(1.6 + 2.2 * len(panels), 1.25 + 0.38 * len(arms)), layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False, sharex=True, sharey=True)[0]
    for axis, (title, found) in zip(axes, panels.items(), strict=True):
        for row, arm in enumerate(arms):
            value, low, high = found[arm]
            colour = _colour(study, arm)
            if not np.isnan(low):
                axis.barh(row, high - low, left=low, height=0.56, color=colour, alpha=0.35, linewidth=0)
            axis.plot([value, value], [row - 0.34, row + 0.34], color=colour, linewidth=2.2, solid_capstyle="butt")
        _style_axis(axis)
        axis.use_sticky_edges = False  # otherwise a bar that begins at the axis looks cut off
        axis.grid(visible=False, axis="y")
        axis.set_title(title, fontsize=9, color=_INK)
        axis.set_yticks(range(len(arms)), arms)
        axis.tick_params(axis="y", length=0)
    axes[0].invert_yaxis()
    handles = [
        Line2D([], [], color="#777777", marker="|", markersize=10, markeredgewidth=2.2, linewidth=0,
               label="interquartile mean over runs"),
        Patch(color="#777777", alpha=0.35, label="95 % interval"),
    ]  # fmt: skip
    figure.legend(handles=handles, loc="outside upper center", ncols=2, frameon=False, fontsize=9)
    figure.supxlabel(label, fontsize=9)
    return figure, axes


def _title(name: str) -> str:
    return "all difficulties" if name == "all" else name


def _colour(study: Study, arm: str) -> str:
    """Return the colour of an arm, which does not depend on the other finished arms."""
    if study.arms[arm].observation == "truth":
        return _INK
    return _COLOURS[list(study.arms).index(arm) % len(_COLOURS)]


def _style(study: Study, arm: str) -> Any:
    """Return the line style of an arm: dashes for the simulator's points."""
    return (0, (4, 2)) if study.arms[arm].observation == "truth" else "-"


def _style_axis(axis: Any) -> None:
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(color=_GRID, linewidth=0.7)
    axis.set_axisbelow(True)
    axis.tick_params(labelsize=9)
