"""Draw the packages of `shape_obs` in the order of their imports: `uv run python docs/pictures/house.py`.

The layers come from import-linter's contract in `pyproject.toml`, the arrows from the imports themselves.
"""

from __future__ import annotations

import re
from collections import Counter
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import grimp
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch, Patch
from PIL import Image

mpl.use("Agg")

DOCS = Path(__file__).parent.parent
ENVS: Final = "shape_obs_envs"  # drawn as one room, above the wrappers
# The lowest room of each group, its colour, and what the group is.
GROUPS: Final = (
    ("utils", "#dfe3ea", "shared by all"),
    ("geometry", "#cfe0ff", "detection"),
    ("metrics", "#d5efd9", "around the detector"),
    ("wrappers", "#ffe3c9", "Gymnasium"),
    ("deploy", "#f6d6dc", "applications"),
)
INK, FAINT, DARK = "#1e1e1e", "#aab4c4", "#3c5a96"
COLUMNS: Final = 6
BOX: Final = (0.86, 0.62)  # of a column, of a row
STEPS: Final = 30000  # of the search for columns
Array = npt.NDArray[np.float64]
Edge = tuple[str, str]


def main() -> None:
    """Write the picture, in 64 colours."""
    with BytesIO() as memory:
        draw_house().savefig(memory, format="png", dpi=100)
        picture = Image.open(memory).convert("RGB").quantize(64, dither=Image.Dither.NONE)
    picture.save(DOCS / "images" / "house.png", optimize=True)


def layers(container: str = "shape_obs") -> list[list[str]]:
    """Return the layers of import-linter's contract for a package, lowest first."""
    text = (DOCS.parent / "pyproject.toml").read_text(encoding="utf-8")
    contract = re.search(rf'containers = \["{container}"\]\n.*?layers = \[\n(.*?)\n\]', text, flags=re.S)
    if contract is None:
        raise ValueError(f"pyproject.toml has no contract with layers for {container}.")
    lines = [line.strip().strip('",') for line in contract[1].splitlines()]
    return [line.split(" | ")[::-1] for line in reversed(lines)]


def imports() -> Counter[Edge]:
    """Return how many imports lead from one room to another."""
    graph = grimp.build_graph("shape_obs", ENVS, exclude_type_checking_imports=True, cache_dir=None)
    found: Counter[Edge] = Counter()
    for module in graph.modules:
        for target in graph.find_modules_directly_imported_by(module):
            edge = _room(module), _room(target)
            if edge[0] != edge[1] and "" not in edge:
                found[edge] += 1
    return found


def necessary(edges: Counter[Edge]) -> set[Edge]:
    """Return the edges that no other path between the same rooms replaces."""
    below: dict[str, set[str]] = {}
    for room, target in edges:
        below.setdefault(room, set()).add(target)

    def reaches(room: str, target: str) -> bool:
        return any(step == target or reaches(step, target) for step in below.get(room, ()))

    return {
        (room, target) for room, target in edges if not any(reaches(step, target) for step in below[room] - {target})
    }


def columns(rows: list[list[str]], edges: set[Edge]) -> dict[str, tuple[float, float]]:
    """Return a place for each room, such that few arrows run behind other rooms: simulated annealing."""
    names = [room for row in rows for room in row]
    height = np.array([float(level) for level, row in enumerate(rows) for _ in row])
    ends = np.array([[names.index(room), names.index(target)] for room, target in sorted(edges)])
    draw = np.random.default_rng(0)
    place = np.concatenate([draw.permutation(COLUMNS)[: len(row)] for row in rows]).astype(float)
    cost = _cost(place, height, ends)
    best, least = place.copy(), cost
    for step in range(STEPS):
        room = draw.integers(len(names))
        trial = place.copy()
        trial[room] = draw.integers(COLUMNS)
        taken = (height == height[room]) & (trial == trial[room])
        taken[room] = False
        trial[taken] = place[room]
        changed = _cost(trial, height, ends)
        if changed < cost or draw.random() < np.exp((cost - changed) / (3.0 * (1 - step / STEPS) + 1e-9)):
            place, cost = trial, changed
            if cost < least:
                best, least = place.copy(), cost
    return {name: (float(x), float(y)) for name, x, y in zip(names, best, height, strict=True)}


def _cost(place: Array, height: Array, ends: npt.NDArray[np.int64]) -> float:
    """Return how far arrows run sideways, how many rooms they run behind, and how many cross."""
    from_x, from_y, to_x, to_y = place[ends[:, 0]], height[ends[:, 0]], place[ends[:, 1]], height[ends[:, 1]]
    slope = (to_x - from_x) / (to_y - from_y)
    at = from_x[:, None] + slope[:, None] * (height - from_y[:, None])
    between = (height < from_y[:, None]) & (height > to_y[:, None])
    behind = np.sum(between & (np.abs(at - place) < 0.55))
    low, high = np.maximum(to_y[:, None], to_y), np.minimum(from_y[:, None], from_y)
    at_low, at_high = (from_x[:, None] + slope[:, None] * (level - from_y[:, None]) for level in (low, high))
    crossings = np.sum((low < high) & ((at_low - at_low.T) * (at_high - at_high.T) < 0)) / 2
    return 4.0 * behind + 1.0 * crossings + float(np.sum(np.abs(to_x - from_x)))


def draw_house() -> Any:
    """Return the figure."""
    rows = layers()
    rows.insert(next(index for index, row in enumerate(rows) if "wrappers" in row) + 1, [ENVS])
    edges = imports()
    dark = necessary(edges)
    place = columns(rows, dark)
    figure, axis = plt.subplots(figsize=(9, 10.5), layout="constrained")
    axis.set_xlim(-0.6, COLUMNS - 0.4)
    axis.set_ylim(-0.7, len(rows) - 0.3)
    axis.set_axis_off()
    for edge, count in edges.items():
        if edge not in dark:
            _arrow(axis, place, edge, color=FAINT, linewidth=0.3 + 0.05 * min(count, 10), alpha=0.45, head=0.0)
    for edge in dark:
        _arrow(axis, place, edge, color=DARK, linewidth=0.9, alpha=0.95, head=6.0)
    colour = GROUPS[0][1]
    starts = {name: shade for name, shade, _ in GROUPS}
    for row in rows:
        colour = next((starts[room] for room in row if room in starts), colour)
        for room in row:
            _box(axis, place[room], room, colour)
    handles = [Patch(facecolor=shade, edgecolor=INK, linewidth=0.5, label=text) for _, shade, text in reversed(GROUPS)]
    figure.legend(handles=handles[::-1], fontsize=10, loc="outside lower center", ncols=len(GROUPS), frameon=False)
    return figure


def _arrow(axis: Any, place: dict[str, tuple[float, float]], edge: Edge, head: float, **style: Any) -> None:
    (from_x, from_y), (to_x, to_y) = place[edge[0]], place[edge[1]]
    start, stop = (from_x, from_y - BOX[1] / 2), (to_x, to_y + BOX[1] / 2 + (0.06 if head else 0.0))
    kind = "-|>" if head else "-"
    axis.add_patch(
        FancyArrowPatch(start, stop, arrowstyle=kind, mutation_scale=head or 1, shrinkA=0, shrinkB=0, **style)
    )


def _box(axis: Any, at: tuple[float, float], room: str, colour: str) -> None:
    width, height = BOX
    corner = at[0] - width / 2 + 0.06, at[1] - height / 2 + 0.06
    axis.add_patch(
        FancyBboxPatch(
            corner, width - 0.12, height - 0.12, boxstyle="round,pad=0.06",
            facecolor=colour, edgecolor=INK, linewidth=0.7, zorder=3,
        )
    )  # fmt: skip
    axis.text(*at, room, ha="center", va="center_baseline", fontsize=10, color=INK, zorder=4)


def _room(module: str) -> str:
    """Return the room of a module: `shape_obs.image.roi` -> `image`; empty for the package itself."""
    parts = module.split(".")
    return ENVS if parts[0] == ENVS else parts[1] if len(parts) > 1 else ""


if __name__ == "__main__":
    main()
