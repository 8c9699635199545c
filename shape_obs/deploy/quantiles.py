"""Quantiles: median, 95th percentile and maximum of a stream of numbers, in constant memory."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

#: Bins grow by 1 % each, from a microsecond to an hour, in milliseconds.
_LEAST: Final = 1e-3
_GROWTH: Final = math.log(1.01)
_BINS: Final = int(math.log(3.6e6 / _LEAST) / _GROWTH) + 2


class Section(NamedTuple):
    """Milliseconds that a part of the loop took: median, 95th percentile and most."""

    median: float
    p95: float
    most: float


class Quantiles:
    """Count milliseconds in bins that grow by 1 %, so that quantiles are right to 0.5 % however many there are.

    Values below a microsecond count as 0.
    """

    def __init__(self) -> None:
        self._counts = np.zeros(_BINS, np.int64)
        self._most = 0.0

    def add(self, value: float) -> None:
        """Add a value in milliseconds."""
        bin_ = 0 if value < _LEAST else min(1 + int(math.log(value / _LEAST) / _GROWTH), _BINS - 1)
        self._counts[bin_] += 1
        self._most = max(self._most, value)

    def section(self) -> Section:
        """Return the quantiles of all values; there must be one."""
        return Section(self._quantile(0.5), self._quantile(0.95), round(self._most, 3))

    def _quantile(self, share: float) -> float:
        reached = np.cumsum(self._counts)
        bin_ = int(np.searchsorted(reached, share * reached[-1]))
        if bin_ == 0:
            return 0.0
        return round(min(_LEAST * math.exp((bin_ - 0.5) * _GROWTH), self._most), 3)
