"""Colours looked up in a table, on Numba."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numba import njit

from shape_obs.kernels.interface import Found, Mask
from shape_obs.roi import Window

reads_tables: Final = True

_BITS: Final = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1, bitorder="little")
# Of a row of eight pixels as a byte: the row as mask bytes.
_SPREAD: Final = np.ascontiguousarray(_BITS * np.uint8(255)).view(np.uint64).ravel()
# And its tally, a byte each: how many pixels the near and the far half have, and the sums of their columns, 0...3.
_HALVES: Final = _BITS.reshape(256, 2, 4).astype(np.uint64)
_TALLY: Final = np.concatenate([_HALVES.sum(axis=2), _HALVES @ np.arange(4, dtype=np.uint64)], axis=1) @ (
    np.array([1, 1 << 8, 1 << 16, 1 << 24], np.uint64)
)

_U = np.uint64


@njit(inline="always")
def _bit(flat: Any, at: Any, table: Any) -> Any:
    """Whether the table has the colour whose red value stands at ``at``: 0 or 1."""
    red, green, blue = _U(flat[at]), _U(flat[at + _U(1)]), _U(flat[at + _U(2)])
    return (table[(red << _U(10)) | (green << _U(2)) | (blue >> _U(6))] >> (blue & _U(63))) & _U(1)


@njit(inline="always")
def _eight(flat: Any, at: Any, table: Any) -> Any:
    """The same of eight pixels in a row, the first in the lowest bit."""
    bits = _bit(flat, at, table)
    for k in range(1, 8):
        bits |= _bit(flat, at + _U(3 * k), table) << _U(k)
    return bits


@njit(cache=True, nogil=True)
def _table_mask(flat: Any, origin: int, pitch: int, width: int, height: int, table: Any) -> Mask:
    out = np.empty((height, width), np.uint8)
    for row in range(height):
        at = _U(origin + row * pitch)
        for column in range(width):
            out[row, column] = -np.uint8(_bit(flat, at, table))
            at += _U(3)
    return out


@njit(inline="always")
def _read_cell(
    rows: Any, flat: Any, at: Any, pitch: Any, u0: Any, v0: Any, left: Any, top: Any, right: Any, bottom: Any, table: Any
) -> None:
    """The 8 x 8 pixels from (u0, v0) on as eight ``rows`` of bits; outside the window they are 0."""
    if u0 >= left and v0 >= top and u0 + 8 <= right and v0 + 8 <= bottom:
        for y in range(8):
            rows[y] = _eight(flat, _U(at + y * pitch), table)
        return
    for y in range(8):
        rows[y] = _U(0)
        if top <= v0 + y < bottom:
            for k in range(max(left - u0, 0), min(right - u0, 8)):
                rows[y] |= _bit(flat, _U(at + y * pitch + 3 * k), table) << _U(k)


@njit(inline="always")
def _push(cell: Any, seen: Any, stack: Any, top: Any) -> Any:
    if seen[_U(cell)] == 0:
        seen[_U(cell)] = 1
        stack[_U(top)] = cell
        top += 1
    return top


@njit(cache=True, nogil=True)
def _seek(
    flat: Any,
    origin: int,
    pitch: int,
    left: int,
    top: int,
    right: int,
    bottom: int,
    table: Any,
    step: int,
    edge: int,
    min_area: int,
    min_share: float,
) -> Any:
    """Columns and rows are the image's; its pixel (u, v) stands at ``origin + v * pitch + 3 * u``."""
    west, north = left & ~7, top & ~7
    across, down = (right - west + 7) >> 3, (bottom - north + 7) >> 3
    pitch_of_cells = across + 2  # cells around the window count as seen
    seen = np.ones((down + 2) * pitch_of_cells, np.uint8)
    for row in range(1, down + 1):
        seen[row * pitch_of_cells + 1 : row * pitch_of_cells + 1 + across] = 0
    stack = np.empty(across * down, np.int64)
    rows = np.empty(8, np.uint64)
    words = np.zeros((bottom - top, across), np.uint64)
    most = across * down * (1 if edge == 8 else 4)
    points, weight = np.empty((most, 2)), np.empty(most)
    piece, home = np.empty(most, np.int64), np.empty(most, np.int64)
    area = np.zeros(across * down, np.int64)
    found, pieces = 0, 0
    for v in range(top + (-(top - step // 2)) % step, bottom, step):
        # Rows of the lattice are shifted by half a step in turn.
        first = left + ((step // 4 if (v // step) & 1 == 0 else step // 4 + step // 2) - left) % step
        line, start = (((v - north) >> 3) + 1) * pitch_of_cells + 1, origin + v * pitch
        for u in range(first, right, step):
            cell = line + ((u - west) >> 3)
            if seen[_U(cell)] != 0 or _bit(flat, _U(start + 3 * u), table) == 0:
                continue
            waiting = _push(cell, seen, stack, 0)
            while waiting > 0:
                waiting -= 1
                cell = stack[_U(waiting)]
                row, column = cell // pitch_of_cells - 1, cell % pitch_of_cells - 1
                u0, v0 = west + 8 * column, north + 8 * row
                _read_cell(rows, flat, origin + v0 * pitch + 3 * u0, pitch, u0, v0, left, top, right, bottom, table)
                n = su = sv = 0
                every = _U(0)
                for half in range(0, 8, 4):
                    tally = below = _U(0)
                    for y in range(4):
                        bits = rows[half + y]
                        every |= bits
                        tally += _TALLY[bits]
                        below += (_TALLY[bits] & _U(0xFFFF)) * _U(y)
                    for side in range(2):
                        count = np.int64((tally >> _U(8 * side)) & _U(255))
                        columns = np.int64((tally >> _U(8 * side + 16)) & _U(255)) + 4 * side * count
                        lines = np.int64((below >> _U(8 * side)) & _U(255)) + half * count
                        if edge == 4 and count > 0:
                            points[found, 0], points[found, 1] = u0 + columns / count, v0 + lines / count
                            weight[found], piece[found], home[found] = count, pieces, cell
                            found += 1
                        n, su, sv = n + count, su + columns, sv + lines
                if n == 0:
                    continue
                for y in range(max(v0, top), min(v0 + 8, bottom)):
                    words[_U(y - top), _U(column)] = _SPREAD[rows[y - v0]]
                area[pieces] += n
                if edge == 8:
                    points[found, 0], points[found, 1] = u0 + su / n, v0 + sv / n
                    weight[found], piece[found], home[found] = n, pieces, cell
                    found += 1
                # The search goes on where pixels touch the next cell, and nowhere else.
                if every & _U(1):
                    waiting = _push(cell - 1, seen, stack, waiting)
                if every >> _U(7):
                    waiting = _push(cell + 1, seen, stack, waiting)
                for bits, beside in ((rows[0], cell - pitch_of_cells), (rows[7], cell + pitch_of_cells)):
                    if bits:
                        waiting = _push(beside, seen, stack, waiting)
                        if bits & _U(1):
                            waiting = _push(beside - 1, seen, stack, waiting)
                        if bits >> _U(7):
                            waiting = _push(beside + 1, seen, stack, waiting)
            pieces += 1
    # The plausible pieces alone, the largest first.
    floor = max(min_area, min_share * area[:pieces].max()) if pieces else 0
    order = np.argsort(-area[:pieces], kind="mergesort")
    rank = np.full(pieces, -1, np.int64)
    kept = 0
    for at in order:
        if area[at] >= floor:
            rank[at] = kept
            kept += 1
    held = 0
    for at in range(found):
        if rank[piece[at]] >= 0:
            points[held], weight[held], piece[held] = points[at], weight[at], rank[piece[at]]
            held += 1
        else:
            row, column = home[at] // pitch_of_cells - 1, home[at] % pitch_of_cells - 1
            for y in range(max(north + 8 * row, top), min(north + 8 * row + 8, bottom)):
                words[y - top, column] = 0
    return words, points[:held].copy(), weight[:held].copy(), piece[:held].copy(), area[order[:kept]]


def table_mask(rgb: npt.NDArray[np.uint8], window: Window, table: npt.NDArray[np.uint64]) -> Mask:
    """See ``Kernels.table_mask``."""
    flat, origin, pitch = _flat(rgb, window)
    origin += window.top * pitch + 3 * window.left
    return _table_mask(flat, origin, pitch, window.width, window.height, table)


def seek(
    rgb: npt.NDArray[np.uint8],
    window: Window,
    table: npt.NDArray[np.uint64],
    step: int,
    edge: int,
    min_area: int,
    min_share: float,
) -> Found:
    """See ``Kernels.seek``."""
    flat, origin, pitch = _flat(rgb, window)
    left, top, width, height = window
    words, points, weight, piece, area = _seek(
        flat, origin, pitch, left, top, left + width, top + height, table, step, edge, min_area, min_share
    )
    mask = words.view(np.uint8)
    if mask.shape[1] != width:
        mask = np.ascontiguousarray(mask[:, left % 8 : left % 8 + width])
    return Found(mask, points, weight, piece, area)


def _flat(rgb: npt.NDArray[np.uint8], window: Window) -> tuple[npt.NDArray[np.uint8], int, int]:
    """The values of an image in a row, where its pixel (0, 0) stands or would stand, and how far apart its rows are.

    Of an image that does not lie row by row, the window is copied.
    """
    if rgb.flags.c_contiguous:
        flat, origin, pitch = rgb.reshape(-1), 0, 3 * rgb.shape[1]
    else:
        flat, pitch = np.ascontiguousarray(rgb[window.slices]).reshape(-1), 3 * window.width
        origin = -window.top * pitch - 3 * window.left
    flat.flags.writeable = False  # one type for all images, or those that are read-only would be compiled for anew
    return flat, origin, pitch
