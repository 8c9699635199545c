"""Compare the points of a surface with the drawn sheet."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from shape_obs import Surface
from shape_obs.bench.scenes import Sheet
from shape_obs.configurations.base import Ends
from tests.benchmarks.scenes.sheets import true_lattice
from tests.benchmarks.scores import off_lattice

ASPECTS = (1.0, 1.5, 2.0, 3.0)


class Away(NamedTuple):
    """Say how far points lie from their true positions.

    Args:
        mean: Pixels.
        slip: The largest distance in gaps, along a row or a column.
    """

    mean: float
    slip: float


def away(points: Any, sheet: Sheet, rows: int, cols: int, ends: Ends = "centers", corner: int = 0) -> Away:
    """Compare ``(N, 2)`` points with a sheet whose first corner is number ``corner``, counted clockwise."""
    true = true_lattice(np.rot90(sheet.points, corner), rows, cols, ends)
    off = np.asarray(points, dtype=np.float64).reshape(true.shape) - true
    return Away(float(np.linalg.norm(off, axis=-1).mean()), float(np.abs(off_lattice(off, true)).max()))


def found_corner(points: Any, sheet: Sheet, spec: Surface, ends: Ends = "centers") -> int:
    """Return the corner of the sheet, counted clockwise, from which the points are numbered."""
    return min(range(4), key=lambda corner: away(points, sheet, spec.rows, spec.cols, ends, corner).mean)


def first_corner(sheet: Sheet) -> tuple[int, bool]:
    """Return the corner at which numbering begins by the image, and whether another one is as good."""
    right = (sheet.points[:, -1] - sheet.points[:, 0]).mean(axis=0)
    down = (sheet.points[-1] - sheet.points[0]).mean(axis=0)
    right, down = right / np.linalg.norm(right), down / np.linalg.norm(down)
    degrees = np.degrees(np.angle(complex(*right) + complex(*down) / 1j))
    quarters = round(degrees / 90)
    return -quarters % 4, bool(abs(abs(degrees / 90 - quarters) - 0.5) * 90 < 2)
