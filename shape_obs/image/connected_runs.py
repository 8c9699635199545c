"""Masks as runs, the rows of connected pixels: components, cells, look-ups.

A run is one row of connected pixels: row, first column, column past the last one, in image coordinates.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]

_FAR_OFF: Final = 2.0**30  # pixels; no image reaches there, and integers hold it
_U = np.uint64
_TOPS = np.uint64(0x8080808080808080)  # the highest bit of each byte
_WHICH = np.uint64(0x0001020304050607)  # times 256^k, its highest byte is k

# A mask, its runs, the areas of its components, their box, and its runs along columns: see ``find_components``.
Components = tuple[Mask, Indices, Indices, tuple[int, int, int, int], int]


@compiled("(u1[:,::1], i8, i8, i8, f8, f8)")
def find_components(mask: Mask, left: int, top: int, step: int, min_area: float, min_share: float) -> Components:
    """Find the plausible components of a mask, 8-connected.

    Args:
        mask: ``(h, w)`` uint8, C-contiguous, 0 = background.
        left: Image column of its first pixel.
        top: Image row of its first pixel.
        step: Components that hold no pixel of a lattice are dropped, one pixel in ``step * step``, see ``shift``; a
            power of 2, and with 1 the lattice has every pixel.
        min_area: Smaller components are dropped, pixels.
        min_share: So are those smaller than this share of the largest.

    Returns:
        The mask with these components alone, itself if none are dropped; ``(R, 3)`` its runs, top to bottom and left
        to right; ``(Q,)`` the components' pixels, as they appear; left, top, width and height of the box around them;
        how many runs they have along their columns.
    """
    runs = _runs(mask, left, top)
    label, count = label_runs(runs)
    areas, met = np.zeros(count, np.int64), np.zeros(count, np.int64)
    for at in range(len(runs)):
        row, start, stop = runs[at, 0], runs[at, 1], runs[at, 2]
        areas[label[at]] += stop - start
        if row & (step - 1) == step // 2 and start + ((shift(row, step) - start) & (step - 1)) < stop:
            met[label[at]] = 1
    areas *= met
    floor = max(min_area, 1.0, min_share * areas.max() if count else 0.0)
    if count and areas.min() < floor:
        mask = mask.copy()
        for at in range(len(runs)):
            if areas[label[at]] < floor:
                for column in range(runs[at, 1] - left, runs[at, 2] - left):
                    mask[runs[at, 0] - top, column] = 0
    runs, box = _plausible(runs, label, areas, floor)
    return mask, runs, areas[areas >= floor], (box if len(runs) else (left, top, 0, 0)), count_column_runs(runs)


@compiled("(i8[:,::1], i8, i8, i8, i8, f8, f8)")
def draw_components(
    runs: Indices, left: int, top: int, right: int, bottom: int, min_area: float, min_share: float
) -> tuple[Components, tuple[int, int]]:
    """Draw the plausible components of runs, 8-connected, with a pixel of background around them.

    Args:
        runs: ``(R, 3)``, image coordinates, top to bottom and left to right.
        left: First image column of what is drawn at most.
        top: First image row.
        right: Image column past the last one.
        bottom: Image row past the last one.
        min_area: Smaller components are dropped, pixels.
        min_share: So are those smaller than this share of the largest.

    Returns:
        What ``find_components`` returns; image column and row of the mask's first pixel.
    """
    label, count = label_runs(runs)
    areas = np.zeros(count, np.int64)
    for at in range(len(runs)):
        areas[label[at]] += runs[at, 2] - runs[at, 1]
    floor = max(min_area, 1.0, min_share * areas.max() if count else 0.0)
    runs, box = _plausible(runs.copy(), label, areas, floor)
    box = box if len(runs) else (left, top, 0, 0)
    left, top = max(box[0] - 1, left), max(box[1] - 1, top)
    mask = np.zeros((min(box[1] + box[3] + 1, bottom) - top, min(box[0] + box[2] + 1, right) - left), np.uint8)
    for at in range(len(runs)):
        for column in range(runs[at, 1] - left, runs[at, 2] - left):
            mask[runs[at, 0] - top, column] = 1
    return (mask, runs, areas[areas >= floor], box, count_column_runs(runs)), (left, top)


@compiled
def _plausible(
    runs: Indices, label: Indices, areas: Indices, floor: float
) -> tuple[Indices, tuple[int, int, int, int]]:
    """Move the runs of components that are large enough to the front; return them and the box around them."""
    held, first, last = 0, 0, 0
    for at in range(len(runs)):
        if areas[label[at]] >= floor:
            row, start, stop = runs[at, 0], runs[at, 1], runs[at, 2]
            runs[held, 0], runs[held, 1], runs[held, 2] = row, start, stop
            first, last = (min(first, start), max(last, stop)) if held else (start, stop)
            held += 1
    box = (0, 0, 0, 0)
    if held:
        box = (first, runs[0, 0], last - first, runs[held - 1, 0] - runs[0, 0] + 1)
    return runs[:held], box


@compiled(inline=True)
def shift(row: Any, step: Any) -> Any:
    """Return where a row of a lattice of one pixel in ``step * step`` begins: every other one half a step further.

    The step is a power of 2, and the bits of a row are cheaper than a division.
    """
    return step // 4 + (step // 2 if row & step else 0)


@compiled
def _runs(mask: Mask, left: int, top: int) -> Indices:
    """Return the runs of a mask, which is read eight pixels at once."""
    height, across = mask.shape[0], (mask.shape[1] + 7) // 8
    if mask.shape[1] < 8 * across:
        wide = np.zeros((height, 8 * across), np.uint8)
        for row in range(height):
            for column in range(mask.shape[1]):
                wide[row, column] = mask[row, column]
        mask = wide
    words = mask.reshape(height * across * 8).view(np.uint64)
    most, count = 4 * across + 1, 0  # runs in a row
    found = np.empty((2 * height + most, 3), np.int64)
    for row in range(height):
        if count + most > len(found):
            found = np.concatenate((found, np.empty((len(found) + most, 3), np.int64)))
        inside, at, last = _U(0), row * across, (row + 1) * across
        while at < last:
            word = words[at]
            at += 1
            if word | inside == 0:
                while at + 4 <= last and words[at] | words[at + 1] | words[at + 2] | words[at + 3] == 0:
                    at += 4
                continue
            on = (((word & ~_TOPS) + ~_TOPS) | word) & _TOPS  # the top bit of each byte that is not 0
            edges = on ^ ((on << _U(8)) | inside)  # where a run begins, and behind its end
            column = left + (at - 1 - row * across) * 8
            while edges:
                lowest = edges & (~edges + _U(1))
                edges ^= lowest
                place = column + np.int64(((lowest >> _U(7)) * _WHICH) >> _U(56))
                inside ^= _U(0x80)
                if inside:
                    found[count, 0], found[count, 1] = row + top, place
                else:
                    found[count, 2] = place
                    count += 1
        if inside:
            found[count, 2] = left + 8 * across
            count += 1
    return found[:count].copy()


@compiled
def label_runs(runs: Indices) -> tuple[Indices, int]:
    """Return the component of each run, ``(R,)``, and how many there are: union-find over neighbouring rows."""
    count = len(runs)
    parent = np.empty(count, np.int64)
    for at in range(count):
        parent[at] = at
    above = 0  # the first run of the row above that can still touch
    for at in range(count):
        row, start, stop = runs[at, 0], runs[at, 1], runs[at, 2]
        while above < at and (runs[above, 0] < row - 1 or (runs[above, 0] == row - 1 and runs[above, 2] < start)):
            above += 1
        other = above
        while other < at and runs[other, 0] == row - 1 and runs[other, 1] <= stop:
            if runs[other, 2] >= start:
                a, b = find_root(parent, at), find_root(parent, other)
                if a != b:
                    parent[max(a, b)] = min(a, b)
            other += 1
    label = np.empty(count, np.int64)
    known = 0
    for at in range(count):
        root = find_root(parent, at)
        if root == at:
            label[at] = known
            known += 1
        else:
            label[at] = label[root]
    return label, known


@compiled
def find_root(parent: Indices, at: int) -> int:
    """Return the root of a run's tree, shortening the path to it."""
    while parent[at] != at:
        parent[at] = parent[parent[at]]
        at = parent[at]
    return at


@compiled
def count_column_runs(runs: Indices) -> int:
    """Return how many runs a mask has along its columns: pixels without one above them."""
    found, above = 0, 0
    for at in range(len(runs)):
        row, start, stop = runs[at, 0], runs[at, 1], runs[at, 2]
        while runs[above, 0] < row - 1 or (runs[above, 0] == row - 1 and runs[above, 2] <= start):
            above += 1
        found += stop - start
        other = above
        while runs[other, 0] == row - 1 and runs[other, 1] < stop:
            found -= min(stop, runs[other, 2]) - max(start, runs[other, 1])
            other += 1
    return found


@compiled("(i8[:,::1], i8)")
def gather_cells(runs: Indices, size: int) -> tuple[Array, Array]:
    """Gather the pixels of ``(R, 3)`` runs into squares of an edge: ``(M, 2)`` centroids, ``(M,)`` counts.

    The centroid keeps what coarse cells would lose: 8 x 8 cells cost 0.5 % of the Calinski-Harabasz score of all
    pixels, at a fiftieth of their number.
    """
    if len(runs) == 0:
        return np.empty((0, 2)), np.empty(0)
    top, bottom = runs[0, 0] // size, runs[-1, 0] // size
    left, right, most, share = runs[0, 1], runs[0, 2], 0, 1 / size  # divisions are slow
    for at in range(len(runs)):
        left, right = min(left, runs[at, 1]), max(right, runs[at, 2])
        most += int((runs[at, 2] - runs[at, 1]) * share) + 2
    left, right = left // size, (right - 1) // size
    across = right - left + 1
    places = np.full((bottom - top + 1) * across, -1, np.int32)  # of the squares that hold pixels
    sums, held = np.empty((min(most, len(places)), 3), np.int64), 0
    base, below = -across - left, top * size
    for at in range(len(runs)):
        row, start, stop = runs[at, 0], runs[at, 1], runs[at, 2]
        while row >= below:
            below += size
            base += across
        cell = base + int((start + 0.5) * share)
        while start < stop:
            end = min((cell - base + 1) * size, stop)
            count, into = end - start, places[cell]
            if into < 0:
                places[cell] = into = held
                sums[into, 0] = sums[into, 1] = sums[into, 2] = 0
                held += 1
            sums[into, 0] += count
            sums[into, 1] += (start + end - 1) * count  # twice the sum of the columns
            sums[into, 2] += row * count
            start = end
            cell += 1
    points, weight, at = np.empty((held, 2)), np.empty(held), 0
    for cell in range(len(places)):
        if places[cell] >= 0:
            count, columns, rows = sums[places[cell], 0], sums[places[cell], 1], sums[places[cell], 2]
            points[at, 0], points[at, 1], weight[at] = columns / (2 * count), rows / count, count
            at += 1
    return points, weight


@compiled("(u1[:,::1], i8, i8, f8[:,::1], i8)")
def near_mask(mask: Mask, left: int, top: int, points: Array, reach: int) -> npt.NDArray[np.bool_]:
    """Return whether a mask has a pixel at most ``reach`` from each of ``(N, 2)`` image points: ``(N,)``."""
    height, width = mask.shape
    out = np.zeros(len(points), np.bool_)
    for at in range(len(points)):
        column, row = nearest_pixel(points[at, 0]) - left, nearest_pixel(points[at, 1]) - top
        if 0 <= row < height and 0 <= column < width and mask[row, column] != 0:
            out[at] = True
            continue
        for v in range(max(row - reach, 0), min(row + reach + 1, height)):
            for u in range(max(column - reach, 0), min(column + reach + 1, width)):
                if mask[v, u] != 0:
                    out[at] = True
    return out


@compiled(inline=True)
def nearest_pixel(at: float) -> int:
    """Return the nearest pixel; one off every image for NaN and for what no integer can hold."""
    return int(np.rint(at)) if -_FAR_OFF < at < _FAR_OFF else int(-_FAR_OFF)
