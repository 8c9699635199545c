"""Smoothing by a straight line through each value's neighbours."""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def straightened(values: Array, window: int, closed: bool = False) -> Array:
    """Values along the first axis, each replaced by the line through its neighbours.

    The filter of A. Savitzky and M. J. E. Golay, "Smoothing and Differentiation of Data by Simplified Least Squares
    Procedures", 1964, of first order, as `scipy.signal.savgol_filter` computes it with its modes "interp" and "wrap".
    That one fits the lines at both ends anew at each call, which takes half a millisecond.

    Args:
        values: (P, ...), P >= window.
        window: How many neighbours, odd: the value itself and as many on both sides. The outermost values of an open
            row take the line of the outermost window.
        closed: The last value is followed by the first.
    """
    half, count = window // 2, len(values)
    if closed:
        values, count = np.concatenate([values[-half:], values, values[:half]]), count + 2 * half
    total = np.cumsum(values, axis=0)
    middle = total[window - 1 :].copy()
    middle[1:] -= total[: count - window]
    middle /= window
    if closed:
        return middle
    first = _ends(window)
    head, tail = first @ values[:window], first[::-1, ::-1] @ values[-window:]
    return np.concatenate([head, middle, tail])


@cache
def _ends(window: int) -> Array:
    """(half, window) what the line through a window gives for its first half."""
    at = np.arange(window) - window // 2
    return (1 / window + np.outer(at, at) / float(at @ at))[: window // 2]
