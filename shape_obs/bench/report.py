"""What both measurements report: the machine, the clocks, and tables."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import distributions
from pathlib import Path
from typing import Any, Final

#: The processor time of this thread hardly depends on what else runs.
CLOCKS: Final[dict[str, Callable[[], float]]] = {"wall": time.perf_counter, "thread": time.thread_time}
_PACKAGES: Final = (
    "shape-obs", "numpy", "scipy", "opencv-python-headless", "opencv-python", "scikit-learn", "numba", "mujoco"
)  # fmt: skip


def machine() -> dict[str, str]:
    """Return the hardware and software that determine the speed: name -> description or version."""
    table, processor = Path("/proc/cpuinfo"), platform.processor() or "unknown"
    if table.is_file():
        lines = table.read_text(encoding="utf-8").splitlines()
        processor = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), processor)
    system = f"{os.cpu_count()} cores, {platform.system()} {platform.machine()}"
    installed = {each.metadata["Name"]: each.version for each in distributions()}
    versions = {name: installed[name] for name in _PACKAGES if name in installed}
    return {"processor": processor, "system": system, "python": platform.python_version(), **versions}


def in_words(described: Mapping[str, str]) -> str:
    """Return the description of a machine in one line."""
    return ", ".join(text if name in ("processor", "system") else f"{name} {text}" for name, text in described.items())


def markdown_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows of equal keys as an aligned Markdown table with three significant digits."""
    cells = [[f"{value:.3g}" if isinstance(value, float) else str(value) for value in row.values()] for row in rows]
    columns = [[title, *column] for title, column in zip(rows[0], zip(*cells, strict=True), strict=True)]
    widths = [max(map(len, column)) for column in columns]
    lines = [
        [cell.ljust(width) for cell, width in zip(line, widths, strict=True)] for line in zip(*columns, strict=True)
    ]
    lines.insert(1, ["-" * width for width in widths])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def as_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows of equal keys, without commas in their values, as CSV."""
    return "".join(",".join(map(str, line)) + "\n" for line in (rows[0], *(row.values() for row in rows)))
