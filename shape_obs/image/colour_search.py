"""Find objects by colour without reading every pixel: look up a colour table on a lattice, then read near the hits."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.image.connected_runs import Components, find_components, shift
from shape_obs.image.roi import Window

Mask = npt.NDArray[np.uint8]
Box = tuple[int, int, int, int]

# Eight pixels in a row are a byte, the leftmost its lowest bit; here is the byte as eight bytes of a mask.
_BITS: Final = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1, bitorder="little")
_SPREAD: Final = np.ascontiguousarray(_BITS * np.uint8(255)).view(np.uint64).ravel()
_U = np.uint64  # unsigned indices are not checked for being negative


def flat_pixels(rgb: npt.NDArray[np.uint8], window: Window) -> tuple[npt.NDArray[np.uint8], int, int]:
    """Return the values of an image in a row, where its pixel ``(0, 0)`` stands, and the distance between its rows.

    If an image is not stored row by row, the window is copied.

    Args:
        rgb: ``(H, W, 3)`` uint8.
        window: Which of its pixels will be read.
    """
    if rgb.flags.c_contiguous:
        flat, origin, pitch = rgb.reshape(-1), 0, 3 * rgb.shape[1]
    else:
        flat, pitch = np.ascontiguousarray(rgb[window.slices]).reshape(-1), 3 * window.width
        origin = -window.top * pitch - 3 * window.left
    flat.flags.writeable = False  # one type for all images: compiled code distinguishes read-only arrays
    return flat, origin, pitch


@compiled("(Array(u1, 1, 'C', readonly=True), i8, i8, UniTuple(i8, 4), Array(u8, 1, 'C', readonly=True))")
def look_up(flat: Any, origin: int, pitch: int, window: Box, table: Any) -> Mask:
    """Return the pixels of a window whose colour is in a table: ``(h, w)`` uint8, 0 or 255.

    Args:
        flat: The image, see ``flat_pixels``.
        origin: Where its pixel ``(0, 0)`` stands.
        pitch: The distance between its rows.
        window: Left, top, width and height.
        table: See ``colour_table``.
    """
    left, top, width, height = window
    out = np.empty((height, width), np.uint8)
    for row in range(height):
        at = _U(origin + (top + row) * pitch + 3 * left)
        for column in range(width):
            out[row, column] = -np.uint8(_bit(flat, at, table))
            at += _U(3)
    return out


@compiled("(Array(u1, 1, 'C', readonly=True), i8, i8, UniTuple(i8, 4), Array(u8, 1, 'C', readonly=True), i8, f8, f8)")
def find_on_lattice(
    flat: Any, origin: int, pitch: int, window: Box, table: Any, step: int, min_area: float, min_share: float
) -> Components:
    """Find the plausible components of a colour without reading every pixel.

    One pixel in ``step * step`` is looked at, in a lattice that lies fast in the image with every other row shifted
    by half a step. Where one has such a colour its cell of 8 x 8 pixels is read, and from there on where pixels touch.
    Components that hold none of the lattice are left out, so any object that a disc of diameter 1.25 * step + 1 fits
    into is found, and what is found is complete to the pixel.

    Args:
        flat: The image, see ``flat_pixels``.
        origin: Where its pixel ``(0, 0)`` stands.
        pitch: The distance between its rows.
        window: Left, top, width and height of what counts.
        table: See ``colour_table``.
        step: 4 or 8 pixels.
        min_area: Components with fewer pixels are dropped.
        min_share: So are those smaller than this share of the largest.

    Returns:
        What ``find_components`` returns, the mask 0 and 255.
    """
    left, top, right, bottom = window[0], window[1], window[0] + window[2], window[1] + window[3]
    west, north = left & ~7, top & ~7
    across, down = (right - west + 7) >> 3, (bottom - north + 7) >> 3
    words = np.zeros((bottom - top, across), np.uint64)
    stride = across + 2  # cells around the window count as seen
    seen = np.ones((down + 2) * stride, np.uint8)
    seen.reshape(down + 2, stride)[1:-1, 1:-1] = 0
    stack, rows = np.empty(across * down, np.int64), np.empty(8, np.uint64)
    for v in range(top + (step // 2 - top) % step, bottom, step):
        line, start = (((v - north) >> 3) + 1) * stride + 1, origin + v * pitch
        for u in range(left + (shift(v, step) - left) % step, right, step):
            cell = line + ((u - west) >> 3)
            if seen[_U(cell)] != 0 or _bit(flat, _U(start + 3 * u), table) == 0:
                continue
            waiting = _push(cell, seen, stack, 0)
            while waiting > 0:
                waiting -= 1
                cell = stack[_U(waiting)]
                row, column = cell // stride - 1, cell % stride - 1
                u0, v0 = west + 8 * column, north + 8 * row
                at = origin + v0 * pitch + 3 * u0
                every = _U(0)
                if u0 >= left and v0 >= top and u0 + 8 <= right and v0 + 8 <= bottom:
                    for y in range(8):
                        rows[y] = _eight(flat, _U(at + y * pitch), table)
                        every |= rows[y]
                else:
                    for y in range(8):
                        inside = top <= v0 + y < bottom
                        stop = min(right - u0, 8) if inside else 0
                        rows[y] = _few(flat, at + y * pitch, table, max(left - u0, 0), stop)
                        every |= rows[y]
                if every == 0:
                    continue
                for y in range(max(v0, top), min(v0 + 8, bottom)):
                    words[_U(y - top), _U(column)] = _SPREAD[rows[y - v0]]
                for edge, neighbour in ((rows[0], cell - stride), (rows[7], cell + stride)):
                    if edge:
                        waiting = _push(neighbour, seen, stack, waiting)
                        if edge & _U(1):
                            waiting = _push(neighbour - 1, seen, stack, waiting)
                        if edge >> _U(7):
                            waiting = _push(neighbour + 1, seen, stack, waiting)
                # The last to be pushed are read first: those in the same row, which lie together in memory.
                if every & _U(1):
                    waiting = _push(cell - 1, seen, stack, waiting)
                if every >> _U(7):
                    waiting = _push(cell + 1, seen, stack, waiting)
    found = find_components(words.view(np.uint8), west, top, step, min_area, min_share)
    mask = found[0] if window[2] == 8 * across else found[0][:, left - west : right - west].copy()
    return mask, found[1], found[2], found[3], found[4]


@compiled(inline=True)
def _bit(flat: Any, at: Any, table: Any) -> Any:
    """Return whether the table has the colour whose red value stands at ``at``: 0 or 1."""
    red, green, blue = _U(flat[at]), _U(flat[at + _U(1)]), _U(flat[at + _U(2)])
    return (table[(red << _U(10)) | (green << _U(2)) | (blue >> _U(6))] >> (blue & _U(63))) & _U(1)


@compiled(inline=True)
def _eight(flat: Any, at: Any, table: Any) -> Any:
    """Return ``_bit`` of eight pixels in a row."""
    bits = _bit(flat, at, table)
    for k in range(1, 8):
        bits |= _bit(flat, at + _U(3 * k), table) << _U(k)
    return bits


@compiled(inline=True)
def _few(flat: Any, at: Any, table: Any, first: Any, stop: Any) -> Any:
    """Return ``_bit`` of the pixels of eight that lie in the window."""
    bits = _U(0)
    for k in range(first, stop):
        bits |= _bit(flat, _U(at + 3 * k), table) << _U(k)
    return bits


@compiled(inline=True)
def _push(cell: Any, seen: Any, stack: Any, top: Any) -> Any:
    """Push a cell on the stack if it has not been seen."""
    if seen[_U(cell)] == 0:
        seen[_U(cell)] = 1
        stack[_U(top)] = cell
        top += 1
    return top
