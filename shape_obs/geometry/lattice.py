"""The form of a sheet: a fine lattice of points, row by row."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import FittedForm
from shape_obs.geometry.polyline import straightened

if TYPE_CHECKING:
    from typing_extensions import Self

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class FittedLattice(FittedForm):
    """A lattice of points over a sheet, row by row; the outer rows and columns lie on the sheet's border.

    Args:
        gauges: How far down each row lies, ``(rows,)``, and how far right each column, ``(cols,)``: summed mean gaps.
        rows: How many rows, from the sheet's top to its bottom; the columns follow, from left to right.
        kink: Radians by which the outline around it turns at most, either way, away from its corners.
    """

    gauges: tuple[Array, Array]
    rows: int
    kink: float = 0.0

    @classmethod
    def over(cls, points: Array, interpolated: Mask, rows: int, kink: float = 0.0, **other: Any) -> Self:
        """Build a lattice of ``(P, D)`` points and measure its gaps."""
        return cls(points, interpolated, _gauges(points, rows), rows, kink, **other)

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

    @property
    def sides(self) -> tuple[Array, Array, Array, Array]:
        """The four border lines, ``(cols, D)`` or ``(rows, D)``, clockwise: each ends where the next begins."""
        lattice = self.lattice
        return lattice[0], lattice[:, -1], lattice[-1, ::-1], lattice[::-1, 0]

    def at(self, v: Array, u: Array) -> Array:
        """Return ``(R*C, D)`` points at every pair of ``(R,)`` places down and ``(C,)`` places across, row by row.

        Places are rows and columns of the lattice, fractions included; in between it is bilinear.
        """
        across = _between(u, self.lattice.shape[1]) @ self.lattice
        return np.tensordot(_between(v, self.rows), across, axes=1).reshape(len(v) * len(u), -1)

    def evenly(self, rows: int, cols: int, *, centers: bool) -> Array:
        """Return ``(rows*cols, D)`` points with equal gaps down and across, on the mean over the lattice.

        Args:
            rows: How many.
            cols: How many.
            centers: Whether they are the centres of equal pieces; else the outer ones lie on the border.
        """
        return sample_lattice(self.lattice, *self.gauges, rows, cols, centers)

    def interpolated_at(self, v: Array, u: Array) -> Mask:
        """Return ``(R*C,)`` whether most of what lies around such a place is interpolated."""
        if not self.interpolated.any():
            return np.zeros(len(v) * len(u), bool)
        flags = self.interpolated.reshape(self.rows, -1).astype(np.float64)
        return (_between(v, self.rows) @ flags @ _between(u, flags.shape[1]).T).ravel() > 0.5

    def turned(self, quarters: int) -> Self:
        """Return the same lattice with its first corner ``quarters`` corners further on, clockwise."""
        if quarters == 0:
            return self
        lattice = np.rot90(self.lattice, quarters)
        flags = np.rot90(self.interpolated.reshape(self.rows, -1), quarters).ravel()
        points = np.ascontiguousarray(lattice).reshape(self.points.shape)
        gauges = _gauges(points, len(lattice))
        return replace(self, points=points, interpolated=flags, gauges=gauges, rows=len(lattice))

    def smoothed(self, values: Array, known: Mask) -> Array:
        """Fill ``(P,)`` values by the nearest known ones, and smooth them over 3 x 3 points by local planes."""
        lattice = values.reshape(self.rows, -1)
        if not known.all():
            missing = ~known.reshape(lattice.shape)
            nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
            lattice = lattice[tuple(np.asarray(nearest))]
        return straightened(straightened(lattice, 3).T, 3).T.ravel()

    def with_points(self, points: Array) -> Self:
        """Return the same lattice with its points elsewhere: ``(P, D')`` for ``(P, D)``."""
        return replace(self, points=points, gauges=_gauges(points, self.rows))


def _gauges(points: Array, rows: int) -> tuple[Array, Array]:
    lattice = points.reshape(rows, -1, points.shape[1])
    return lattice_gauges(np.ascontiguousarray(lattice, dtype=np.float64))


def _between(at: Array, count: int) -> Array:
    """Return ``(N, count)`` weights that interpolate ``count`` values at ``(N,)`` fractions of an index."""
    return np.maximum(1 - np.abs(at[:, None] - np.arange(count)), 0.0)


@compiled("(f8[:,:,::1],)", reassociate=True)
def lattice_gauges(lattice: Array) -> tuple[Array, Array]:
    """Return how far down each row lies ``(R,)`` and how far right each column ``(C,)``: mean distances, summed."""
    rows, cols, dimension = lattice.shape
    down, right = np.zeros(rows), np.zeros(cols)
    for r in range(rows - 1):
        whole = 0.0
        for c in range(cols):
            square = 0.0
            for d in range(dimension):
                square += (lattice[r + 1, c, d] - lattice[r, c, d]) ** 2
            whole += math.sqrt(square)
        down[r + 1] = whole / cols
    for r in range(rows):
        for c in range(cols - 1):
            square = 0.0
            for d in range(dimension):
                square += (lattice[r, c + 1, d] - lattice[r, c, d]) ** 2
            right[c + 1] += math.sqrt(square) / rows
    for r in range(1, rows):
        down[r] += down[r - 1]
    for c in range(1, cols):
        right[c] += right[c - 1]
    return down, right


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
    row, below = _equal_gaps(down, rows, centers)
    col, beside = _equal_gaps(right, cols, centers)
    out = np.empty((rows * cols, lattice.shape[2]))
    for r in range(rows):
        for c in range(cols):
            i, j, v, u = row[r], col[c], below[r], beside[c]
            for d in range(lattice.shape[2]):
                upper = (1 - u) * lattice[i, j, d] + u * lattice[i, j + 1, d]
                lower = (1 - u) * lattice[i + 1, j, d] + u * lattice[i + 1, j + 1, d]
                out[r * cols + c, d] = (1 - v) * upper + v * lower
    return out


@compiled
def _equal_gaps(gauge: Array, count: int, centers: bool) -> tuple[Indices, Array]:
    """Return which rows come before ``count`` places with equal gaps, and the weight of the next row."""
    before, share = np.empty(count, np.int64), np.empty(count)
    row, last = 0, len(gauge) - 1
    for i in range(count):
        at = gauge[last] * ((i + 0.5) / count if centers else i / (count - 1))
        while row < last - 1 and gauge[row + 1] <= at:
            row += 1
        gap = gauge[row + 1] - gauge[row]
        before[i], share[i] = row, min((at - gauge[row]) / gap, 1.0) if gap > 0 else 0.0
    return before, share


@compiled("(f8[:,:,::1],)")
def outer_corners(nodes: Array) -> Array:
    """Return the corners ``(4, D)`` of a sheet, clockwise, whose pieces have their centres at ``(R, C, D)`` nodes."""
    rows, cols, dimension = nodes.shape
    out = np.empty((4, dimension))
    for k in range(4):
        r, c = rows - 1 if k >= 2 else 0, cols - 1 if k in (1, 2) else 0
        beneath, beside = r - 1 if r else 1, c - 1 if c else 1
        for d in range(dimension):
            out[k, d] = 2 * nodes[r, c, d] - (nodes[r, beside, d] + nodes[beneath, c, d]) / 2
    return out


@compiled("(f8[:,:,::1],)")
def assess_lattice(lattice: Array) -> tuple[float, float, float, float]:
    """Return how much a lattice looks like a sheet.

    Returns:
        The corner farthest from a right angle, degrees; the share of cells that face away from a neighbour; by which
        share a side is longer than its chord, at most; standard deviation over mean of the cells' areas.
    """
    rows, cols = lattice.shape[0], lattice.shape[1]
    angle, winding = 90.0, 0.0
    for k in range(4):
        count, other = (rows, cols) if k % 2 else (cols, rows)
        corner, length = _along_border(lattice, k, 0), 0.0
        ahead, back = (
            _along_border(lattice, k, max(count // 8, 1)) - corner,
            _along_border(lattice, (k + 3) % 4, other - 1 - max(other // 8, 1)) - corner,
        )
        between = ahead * back.conjugate()
        here = math.degrees(abs(math.atan2(between.imag, between.real)))
        if abs(here - 90) > abs(angle - 90):
            angle = here
        last = corner
        for i in range(1, count):
            place = _along_border(lattice, k, i)
            length += abs(place - last)
            last = place
        winding = max(winding, length / max(abs(last - corner), 1e-9) - 1)
    area = np.empty((rows - 1, cols - 1))
    whole = square = 0.0
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
        apart_down = apart_right = 0
        for r in range(rows - 1):
            for c in range(cols - 1):
                apart_down += r > 0 and area[r, c] * area[r - 1, c] < 0
                apart_right += c > 0 and area[r, c] * area[r, c - 1] < 0
        folds = max(apart_down / max((rows - 2) * (cols - 1), 1), apart_right / max((rows - 1) * (cols - 2), 1))
    mean = whole / area.size
    for r in range(rows - 1):
        for c in range(cols - 1):
            square += (abs(area[r, c]) - mean) ** 2
    return angle, folds, winding, math.sqrt(square / area.size) / max(mean, 1e-18)


@compiled
def _along_border(lattice: Array, k: int, i: int) -> complex:
    """Return the point ``i`` steps from corner ``k`` along the border, clockwise."""
    rows, cols = lattice.shape[0], lattice.shape[1]
    if k == 0:
        row, col = 0, i
    elif k == 1:
        row, col = i, cols - 1
    elif k == 2:
        row, col = rows - 1, cols - 1 - i
    else:
        row, col = rows - 1 - i, 0
    return complex(lattice[row, col, 0], lattice[row, col, 1])
