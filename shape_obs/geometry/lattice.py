"""The form of a sheet: a fine lattice of points, row by row."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import NO_VALUES, FittedForm
from shape_obs.geometry.polyline import even_points, straightened

if TYPE_CHECKING:
    from typing_extensions import Self

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


# A gap of a sheet in space may differ from the others by this share, and by so many times what they differ.
_UNEVEN: Final = 0.09
_OFTEN: Final = 3.0


@dataclass(frozen=True, eq=False)
class FittedLattice(FittedForm):
    """A lattice of points over a sheet, row by row; the outer rows and columns lie on the sheet's border.

    Args:
        gauges: How far down each row lies, ``(rows,)``, and how far right each column, ``(cols,)``: summed mean gaps.
        rows: How many rows, from the sheet's top to its bottom; the columns follow, from left to right.
        off: ``(P,)`` metres by which points may be off their material, see ``isometry``; ``(0,)`` if nothing shows it.
    """

    gauges: tuple[Array, Array]
    rows: int
    off: Array = field(default_factory=lambda: NO_VALUES, kw_only=True)

    @classmethod
    def over(cls, points: Array, interpolated: Mask, rows: int, **other: Any) -> Self:
        """Build a lattice of ``(P, D)`` points and measure its gaps."""
        return cls(points, interpolated, _gauges(points, rows), rows, **other)

    @property
    def lattice(self) -> Array:
        """``(rows, cols, D)``."""
        lattice = self.points.reshape(self.rows, -1, self.points.shape[1])
        return np.ascontiguousarray(lattice, dtype=np.float64)

    @property
    def size(self) -> float:
        """Half the length around: the mean row plus the mean column."""
        return float(sum(gauge[-1] for gauge in self.gauges))

    @property
    def corners(self) -> Array:
        """``(4, D)`` top left, top right, bottom right, bottom left."""
        return self.lattice[[0, 0, -1, -1], [0, -1, -1, 0]]

    def turned(self, quarters: int) -> Self:
        """Return the same lattice with its first corner ``quarters`` corners further on, clockwise."""
        if quarters == 0:
            return self
        lattice = np.rot90(self.lattice, quarters)
        flags = np.rot90(self.interpolated.reshape(self.rows, -1), quarters).ravel()
        points = np.ascontiguousarray(lattice).reshape(self.points.shape)
        gauges = _gauges(points, len(lattice))
        off = np.rot90(self.off.reshape(self.rows, -1), quarters).ravel() if len(self.off) else self.off
        return replace(self, points=points, interpolated=flags, gauges=gauges, rows=len(lattice), off=off)

    def smoothed(self, values: Array, known: Mask) -> Array:
        """Fill ``(P,)`` values by the nearest known ones, and smooth them over 3 x 3 points by local planes."""
        lattice = values.reshape(self.rows, -1)
        if not known.all():
            missing = ~known.reshape(lattice.shape)
            from scipy.ndimage import distance_transform_edt  # takes 0.2 s to import

            nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
            lattice = lattice[tuple(np.asarray(nearest))]
        return straightened(straightened(lattice, 3).T, 3).T.ravel()

    def with_points(self, points: Array) -> Self:
        """Return the same lattice with its points elsewhere: ``(P, D')`` for ``(P, D)``."""
        return replace(self, points=points, gauges=_gauges(points, self.rows))


def _gauges(points: Array, rows: int) -> tuple[Array, Array]:
    lattice = points.reshape(rows, -1, points.shape[1])
    return lattice_gauges(np.ascontiguousarray(lattice, dtype=np.float64))


@compiled("(f8[:,:,::1],)", reassociate=True)
def lattice_gauges(lattice: Array) -> tuple[Array, Array]:
    """Return how far down each row lies ``(R,)`` and how far right each column ``(C,)``: mean distances, summed."""
    rows, cols, dimension = lattice.shape
    down, right = np.zeros(rows), np.zeros(cols)
    for r in range(rows):
        for c in range(cols):
            upwards = leftwards = 0.0
            for d in range(dimension):
                upwards += (lattice[r, c, d] - lattice[r - 1, c, d]) ** 2
                leftwards += (lattice[r, c, d] - lattice[r, c - 1, d]) ** 2
            down[r] += math.sqrt(upwards) / cols
            right[c] += math.sqrt(leftwards) / rows
    down[0] = right[0] = 0.0  # nothing is above the first row, or left of the first column
    return np.cumsum(down), np.cumsum(right)


@compiled("(f8[:,:,::1], f8[::1], f8[::1], i8, i8, b1)")
def sample_lattice(lattice: Array, down: Array, right: Array, rows: int, cols: int, centers: bool) -> Array:
    """Return a smaller lattice with equal gaps on the mean, bilinear in between, ``(rows*cols, D)``.

    Args:
        lattice: ``(R, C, D)``.
        down: ``(R,)`` how far down each row lies.
        right: ``(C,)`` how far right each column.
        rows: How many.
        cols: How many.
        centers: Whether the points are the centres of equal pieces; else the outer ones lie on the border.
    """
    across, dimension = lattice.shape[1:]
    found = even_points(lattice.reshape(len(lattice), across * dimension), down, rows, centers)
    columns = transposed(found.reshape(rows, across, dimension)).reshape(across, rows * dimension)
    found = even_points(columns, right, cols, centers)
    return transposed(found.reshape(cols, rows, dimension)).reshape(rows * cols, dimension)


@compiled("(f8[:,:,::1],)")
def uneven_places(lattice: Array) -> Mask:
    """Return which points of a lattice with equal gaps have gaps that differ, and their neighbours, ``(R*C,)`` bool.

    A sheet does not stretch. Where a gap differs from the median down or across by more than the others do, the sheet
    is folded or crumpled there.

    Args:
        lattice: ``(R, C, D)``, at least two rows and columns.
    """
    rows, cols, dimension = lattice.shape
    across, down = np.empty((rows, cols - 1)), np.empty((rows - 1, cols))
    for r in range(rows):
        for c in range(cols):
            right = below = 0.0
            for d in range(dimension):
                if c < cols - 1:
                    right += (lattice[r, c + 1, d] - lattice[r, c, d]) ** 2
                if r < rows - 1:
                    below += (lattice[r + 1, c, d] - lattice[r, c, d]) ** 2
            if c < cols - 1:
                across[r, c] = math.sqrt(right)
            if r < rows - 1:
                down[r, c] = math.sqrt(below)
    widths, heights = max(np.median(across), 1e-12), max(np.median(down), 1e-12)
    for r in range(rows):
        for c in range(cols):
            if c < cols - 1:
                across[r, c] = abs(across[r, c] / widths - 1)
            if r < rows - 1:
                down[r, c] = abs(down[r, c] / heights - 1)
    limit = max(_UNEVEN, _OFTEN * max(np.median(across), np.median(down)))
    out = np.zeros((rows, cols), np.bool_)
    for r in range(rows):
        for c in range(cols):
            if c < cols - 1 and across[r, c] > limit:
                _mark(out, r, c)
                _mark(out, r, c + 1)
            if r < rows - 1 and down[r, c] > limit:
                _mark(out, r, c)
                _mark(out, r + 1, c)
    return out.reshape(rows * cols)


@compiled
def _mark(out: Mask, row: int, col: int) -> None:
    """Mark a place of a lattice and its four neighbours."""
    rows, cols = out.shape
    out[row, col] = True
    out[max(row - 1, 0), col] = out[min(row + 1, rows - 1), col] = True
    out[row, max(col - 1, 0)] = out[row, min(col + 1, cols - 1)] = True


@compiled
def transposed(lattice: Array) -> Array:
    """Return a lattice with its rows and columns exchanged: ``(R, C, D)`` -> ``(C, R, D)``."""
    rows, cols, dimension = lattice.shape
    out = np.empty((cols, rows, dimension))
    for r in range(rows):
        for c in range(cols):
            for d in range(dimension):
                out[c, r, d] = lattice[r, c, d]
    return out


@compiled("(f8[:,:,::1],)")
def assess_lattice(lattice: Array) -> tuple[float, float, float, float]:
    """Return how much a lattice looks like a sheet.

    Returns:
        The corner farthest from a right angle, degrees; the share of cells that face away from a neighbour; by which
        share a side is longer than its chord, at most; standard deviation over mean of the cells' areas.
    """
    rows, cols = lattice.shape[:2]
    border, count = np.empty(2 * (rows + cols) - 4, np.complex128), 0
    for k in range(4):
        for i in range((rows if k % 2 else cols) - 1):
            r = (0, i, rows - 1, rows - 1 - i)[k]
            c = (i, cols - 1, cols - 1 - i, 0)[k]
            border[count] = complex(lattice[r, c, 0], lattice[r, c, 1])
            count += 1
    angle, winding, at = 90.0, 0.0, 0
    for k in range(4):
        count, other = (rows, cols) if k % 2 else (cols, rows)
        end = (at + count - 1) % len(border)
        ahead, back = border[at + max(count // 8, 1)] - border[at], border[at - max(other // 8, 1)] - border[at]
        between = ahead * back.conjugate()
        here = math.degrees(abs(math.atan2(between.imag, between.real)))
        if abs(here - 90) > abs(angle - 90):
            angle = here
        length = 0.0
        for i in range(at, at + count - 1):
            length += abs(border[(i + 1) % len(border)] - border[i])
        winding = max(winding, length / max(abs(border[end] - border[at]), 1e-9) - 1)
        at = end
    area, whole, square = np.empty((rows - 1, cols - 1)), 0.0, 0.0
    below = above = False
    for r in range(rows - 1):
        for c in range(cols - 1):
            x, y = lattice[r + 1, c + 1, 0] - lattice[r, c, 0], lattice[r + 1, c + 1, 1] - lattice[r, c, 1]
            u, v = lattice[r + 1, c, 0] - lattice[r, c + 1, 0], lattice[r + 1, c, 1] - lattice[r, c + 1, 1]
            area[r, c] = (x * v - y * u) / 2
            below, above = below or area[r, c] < 0, above or area[r, c] > 0
            whole += abs(area[r, c])
    folds = 0.0
    if below and above:
        down = right = 0
        for r in range(rows - 1):
            for c in range(cols - 1):
                down += r > 0 and area[r, c] * area[r - 1, c] < 0
                right += c > 0 and area[r, c] * area[r, c - 1] < 0
        folds = max(down / max((rows - 2) * (cols - 1), 1), right / max((rows - 1) * (cols - 2), 1))
    mean = whole / area.size
    for r in range(rows - 1):
        for c in range(cols - 1):
            square += (abs(area[r, c]) - mean) ** 2
    return angle, folds, winding, math.sqrt(square / area.size) / max(mean, 1e-18)
