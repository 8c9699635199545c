"""Check what the features of a vector return: the bounds of each when the vector is made, its values in each frame."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

Vector = npt.NDArray[Any]

_NUMBERS: Final = "fiub"  # kinds of dtype: float, whole numbers, bool


def check_bounds(bounds: Any, what: str) -> tuple[Vector, Vector]:
    """Return the bounds of a feature, lowest and highest values.

    Args:
        bounds: What ``Feature.bounds`` returned.
        what: The feature and its shape, for error messages.

    Raises:
        TypeError: They are no pair of arrays of numbers.
        ValueError: They are not of one shape ``(D,)``, not finite, or not low < high.
    """
    if not isinstance(bounds, (tuple, list)) or len(bounds) != 2:
        raise TypeError(f"{what}: bounds() must return (low, high), got {bounds!r:.100}.")
    low, high = bounds
    for name, values in (("low", low), ("high", high)):
        if not isinstance(values, np.ndarray) or values.dtype.kind not in _NUMBERS:
            raise TypeError(f"{what}: bounds() must return numpy arrays of numbers, got {name} = {_described(values)}.")
    if low.ndim != 1 or low.shape != high.shape or not low.size:
        raise ValueError(
            f"{what}: bounds() must return two arrays of one shape (D,), got {low.shape} and {high.shape}."
        )
    for k in np.flatnonzero(~(np.isfinite(low) & np.isfinite(high) & (low < high)))[:1].tolist():
        raise ValueError(f"{what}: bounds must be finite and low < high, got {low[k]:g} and {high[k]:g} for value {k}.")
    return low, high


def check_values(values: Any, size: int, what: str) -> None:
    """Refuse what ``Feature.compute`` returned unless it is an array of ``size`` numbers; they may be NaN.

    Args:
        values: The values.
        size: How many bounds the feature has.
        what: The feature and its shape, for error messages.

    Raises:
        TypeError: They are no array of numbers.
        ValueError: They have another shape than the bounds.
    """
    if not isinstance(values, np.ndarray) or values.dtype.kind not in _NUMBERS:
        raise TypeError(f"{what}: compute() must return a numpy array of numbers, got {_described(values)}.")
    if values.shape != (size,):
        raise ValueError(f"{what}: compute() must return shape ({size},), as its bounds have, got {values.shape}.")


def _described(value: Any) -> str:
    return f"an array of {value.dtype}" if isinstance(value, np.ndarray) else f"{value!r:.60} ({type(value).__name__})"
