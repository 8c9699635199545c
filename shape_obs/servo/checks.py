"""Checks of numbers that a law is told."""

from __future__ import annotations

import math


def share(name: str, value: float, most: float = 1.0) -> float:
    """A number above 0, at most ``most``.

    Raises:
        ValueError: It is none.
    """
    if not (isinstance(value, (int, float)) and not isinstance(value, bool) and 0 < value <= most):
        raise ValueError(f"{name}: expected a number above 0, at most {most:g}, got {value!r}.")
    assert math.isfinite(value)
    return float(value)
