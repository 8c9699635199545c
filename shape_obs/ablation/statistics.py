"""Statistics of few runs: interquartile means with stratified bootstrap intervals (Agarwal et al., NeurIPS 2021).

Runs are what is drawn anew: episodes of one run share its policy. A stratum holds a value of each run of an arm, on
goals of one difficulty; each stratum is drawn by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Statistic = Callable[..., Any]

LEVEL: Final = 0.95
_RESAMPLES: Final = 2000


class Interval(NamedTuple):
    """A statistic and where it lies.

    Attributes:
        value: Of the runs.
        low: Lower bound; NaN where there is but one run.
        high: Upper bound.
    """

    value: float
    low: float
    high: float


def iqm(*strata: Array, axis: int = -1) -> Any:
    """Interquartile mean of all strata together: a quarter of the values is left out at either end."""
    from scipy.stats import trim_mean

    return trim_mean(np.concatenate(strata, axis=axis), 0.25, axis=axis)


def difference(*strata: Array, axis: int = -1) -> Any:
    """IQM of the first half of the strata, less that of the second."""
    half = len(strata) // 2
    return iqm(*strata[:half], axis=axis) - iqm(*strata[half:], axis=axis)


def improvement(*strata: Array, axis: int = -1) -> Any:
    """Probability that a run of the first half is above one of the second, on goals of the same difficulty.

    Half of the ties count: Mann and Whitney's statistic over the number of pairs, the mean over the difficulties.
    """
    half = len(strata) // 2
    shares = []
    for ours, theirs in zip(strata[:half], strata[half:], strict=True):
        apart = np.moveaxis(ours, axis, -1)[..., :, None] - np.moveaxis(theirs, axis, -1)[..., None, :]
        shares.append(((apart > 0) + 0.5 * (apart == 0)).mean(axis=(-2, -1)))
    return np.mean(shares, axis=0)


def interval(strata: Sequence[Sequence[float]], statistic: Statistic = iqm) -> Interval:
    """A statistic with its 95 % interval: percentiles of the stratified bootstrap.

    Args:
        strata: Values of runs; of two arms those of the one, then those of the other.
        statistic: Of the strata, along ``axis``.

    Raises:
        ValueError: A stratum is empty.
    """
    from scipy.stats import bootstrap

    values = [np.asarray(stratum, np.float64) for stratum in strata]
    if not values or not all(stratum.size for stratum in values):
        raise ValueError(f"expected at least one value in each stratum, got {[stratum.size for stratum in values]}.")
    found = float(statistic(*values, axis=-1))
    if min(stratum.size for stratum in values) < 2:
        return Interval(found, np.nan, np.nan)
    # The same draws each time: a table made twice is the same table.
    draws: dict[str, Any] = {"random_state": np.random.default_rng(0)}  # before SciPy 1.15 not yet "rng"
    bounds = bootstrap(
        values, statistic, n_resamples=_RESAMPLES, method="percentile", confidence_level=LEVEL, vectorized=True,
        **draws,
    ).confidence_interval  # fmt: skip
    return Interval(found, float(bounds.low), float(bounds.high))
