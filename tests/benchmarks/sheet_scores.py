"""Compare points with drawn sheets: distances, slips, and the corner from which they are numbered."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import Sheet
from shape_obs.configurations.base import Ends
from shape_obs.configurations.surface import Surface
from shape_obs.shape import Shape
from tests.benchmarks.scenes.sheets import true_lattice
from tests.benchmarks.scores import off_lattice
from tests.benchmarks.tables import Row

ASPECTS: Final = (1.0, 1.5, 2.0, 3.0, 1 / 2, 1 / 3)
# In degrees. This close to an eighth of a turn, either of two corners may count as the top left one.
_UNDECIDED: Final = 2.0


def score_sheet(points: npt.ArrayLike, sheet: Sheet, rows: int, cols: int, ends: Ends, quarters: int) -> Row:
    """Compare ``(N, 2)`` found points with a cloth whose first corner is number ``quarters``, counted clockwise.

    Returns:
        ``mean`` and ``worst`` distance of the points from their true positions, in pixels; ``slip``: the largest
        distance of a point from its material, in gaps of the lattice along a row or a column; ``off``: all of these
        distances, (rows, cols, 2), down and across.
    """
    true = true_lattice(np.rot90(sheet.points, quarters), rows, cols, ends)
    away = np.asarray(points, dtype=np.float64).reshape(true.shape) - true
    off, distance = off_lattice(away, true), np.linalg.norm(away, axis=-1)
    return Row(mean=float(distance.mean()), worst=float(distance.max()), slip=float(np.abs(off).max()), off=off)


def first_corner(sheet: Sheet) -> tuple[int, bool]:
    """Return the first corner by the paper's rule (0 to 3, clockwise), and whether another one is as good."""
    right = (sheet.points[:, -1] - sheet.points[:, 0]).mean(axis=0)
    down = (sheet.points[-1] - sheet.points[0]).mean(axis=0)
    # The mean, as directions, of the angles between the cloth's axes and the image's.
    right, down = right / np.linalg.norm(right), down / np.linalg.norm(down)
    degrees = np.degrees(np.angle(complex(*right) + complex(*down) / 1j))
    quarters = round(degrees / 90)
    return -quarters % 4, bool(abs(abs(degrees / 90 - quarters) - 0.5) * 90 < _UNDECIDED)


def best_corner(shape: Shape, sheet: Sheet, spec: Surface) -> tuple[int, Row]:
    """Return the corner of the cloth at which the points fit best, and how well they fit there."""
    ends = spec.ends or "centers"
    scores = [score_sheet(shape.pixels, sheet, spec.rows, spec.cols, ends, quarters) for quarters in range(4)]
    return min(enumerate(scores), key=lambda pair: pair[1].mean)


def by_the_rule(shape: Shape, sheet: Sheet, spec: Surface) -> tuple[bool, Row]:
    """Return whether point 0 is at the corner that the paper's rule gives, and how well the points fit the cloth."""
    expected, undecided = first_corner(sheet)
    corner, found = best_corner(shape, sheet, spec)
    return corner == expected or (undecided and (corner - expected) % 2 == 1), found
