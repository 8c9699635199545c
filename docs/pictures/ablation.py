"""The picture of lost goals of 'Training', from the page's table: uv run python docs/pictures/ablation.py."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from shape_obs.ablation import load_study
from shape_obs.ablation.report import draw_degradation
from shape_obs.ablation.statistics import Interval

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "benchmarks" / "simulation.md"
TITLE = "Percentage points lost under"


def read_page() -> dict[str, Any]:
    """Read the goals that each arm lost under each disturbance."""
    table = re.search(rf"^\| {TITLE} \|.*(?:\n\|.*)*", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    if table is None:
        raise ValueError(f"{PAGE}: expected a table whose first column is {TITLE!r}.")
    (_, *names), _, *rows = (line.strip("| ").split(" | ") for line in table[0].splitlines())
    lost = {}
    for arm, *cells in rows:
        values = [Interval(*map(float, re.findall(r"-?[\d.]+", cell))) for cell in cells]
        lost[arm] = SimpleNamespace(lost=dict(zip(names, values, strict=True)))
    return lost


if __name__ == "__main__":
    study = load_study(ROOT / "examples" / "ablations" / "cable.yaml")
    draw_degradation(study, read_page()).savefig(ROOT / "docs" / "images" / "ablate_degradation.png", dpi=110)
