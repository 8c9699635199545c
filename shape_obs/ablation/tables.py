"""The tables of a study, as Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from shape_obs.ablation.statistics import Interval
from shape_obs.ablation.study import Study
from shape_obs.ablation.summary import LEVELS, ArmSummary, groups
from shape_obs.utils.files import write_text

TABLE: Final = "table.md"
_NONE: Final = "–"


def write_table(study: Study, summary: Mapping[str, ArmSummary], root: Path) -> Path:
    """Write ``table.md``; returns its path."""
    text = markdown(study, summary) + "\n"
    write_text(root / TABLE, text)
    return root / TABLE


def markdown(study: Study, summary: Mapping[str, ArmSummary]) -> str:
    """All tables, each with a line that says what it shows."""
    plan, parts = study.evaluation, list(groups(study))
    reference = study.reference or next(iter(study.arms))
    bracket = "in brackets its 95 % stratified bootstrap interval"
    sheets = [
        f"{study.algorithm} on {study.env}, {study.steps:,} steps; {plan.final_goals} held-out goals of each "
        f"difficulty, scored by the true points. Interquartile mean over runs, {bracket}.",
        _table(
            "Goals reached in the end [%]",
            ["arm", "runs", *parts],
            [[arm, each.runs, *(_told(each.success[name], 1) for name in parts)] for arm, each in summary.items()],
        ),
        _table(
            "Mean error in the end [mm]",
            ["arm", *parts],
            [[arm, *(_told(each.final_mm[name], 2) for name in parts)] for arm, each in summary.items()],
        ),
        _table(
            f"Steps of training until {', '.join(map(str, LEVELS))} % are reached, as seen every {plan.every:,} steps",
            ["arm", *parts],
            [[arm, *(" / ".join(map(_steps, each.steps_to[name])) for name in parts)] for arm, each in summary.items()],
        ),
        _table(
            "Goals reached on average over the training [%]",
            ["arm", *parts],
            [[arm, *(_told(each.area[name], 1) for name in parts)] for arm, each in summary.items()],
        ),
        _table(
            "Milliseconds of a step, with the environment",
            ["arm", "in training", "with the trained policy"],
            [[arm, f"{each.ms_training:.1f}", f"{each.ms_acting:.1f}"] for arm, each in summary.items()],
        ),
    ]
    if plan.disturbances:
        sheets.append(
            _table(
                "Lost under disturbances that no training saw [points of a hundred]",
                ["arm", *plan.disturbances],
                [
                    [arm, *(_told(each.lost.get(name), 1) for name in plan.disturbances)]
                    for arm, each in summary.items()
                ],
            )
        )
    if any(each.difference for each in summary.values()):
        sheets.append(
            _table(
                f"Against {reference}: goals reached [points of a hundred], and how probably a run reaches more",
                ["arm", "difference", "probability"],
                [
                    [arm, _told(each.difference, 1, sign=True), _told(each.improvement, 2)]
                    for arm, each in summary.items()
                    if each.difference
                ],
            )
        )
    return "\n\n".join(sheets)


def _table(title: str, head: Sequence[object], rows: Sequence[Sequence[object]]) -> str:
    lines = [list(head), ["---", *["---:"] * (len(head) - 1)], *rows]
    return "\n".join([f"**{title}**", "", *("| " + " | ".join(map(str, line)) + " |" for line in lines)])


def _told(found: Interval | None, digits: int, sign: bool = False) -> str:
    """``"91.3 [88.0, 94.7]"``."""
    if found is None:
        return _NONE
    form = f"{'+' if sign else ''}.{digits}f"
    bounds = "" if np.isnan(found.low) else f" [{found.low:{form}}, {found.high:{form}}]"
    return f"{found.value:{form}}{bounds}"


def _steps(steps: int | None) -> str:
    return _NONE if steps is None else f"{steps:,}"


def plain_summary(summary: Mapping[str, ArmSummary]) -> dict[str, Any]:
    """For JSON: intervals as ``[value, low, high]``, with None where there is no bound."""

    def plain(value: Any) -> Any:
        if isinstance(value, Interval):
            return [None if np.isnan(number) else round(number, 4) for number in value]
        if isinstance(value, Mapping):
            return {str(key): plain(item) for key, item in value.items()}
        return list(value) if isinstance(value, tuple) else value

    return {arm: {name: plain(value) for name, value in vars(each).items()} for arm, each in summary.items()}
