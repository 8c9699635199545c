"""Summarize few runs: interquartile means with stratified bootstrap intervals (Agarwal et al., NeurIPS 2021).

The bootstrap resamples runs, since the episodes of one run share its policy. A stratum holds one value per run of an
arm, for goals of one difficulty; each stratum is resampled separately.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.ablation.results import FinishedRun
from shape_obs.ablation.study import Study

ALL: Final = "all"
LEVELS: Final = (50, 80, 90)
Array = npt.NDArray[np.float64]
Statistic = Callable[..., Any]

LEVEL: Final = 0.95
_RESAMPLES: Final = 2000


class Interval(NamedTuple):
    """A statistic with its confidence interval.

    Attributes:
        value: The statistic.
        low: Lower bound; NaN if there is only one run.
        high: Upper bound; NaN if there is only one run.
    """

    value: float
    low: float
    high: float


def iqm(*strata: Array, axis: int = -1) -> Any:
    """Return the interquartile mean of all strata together, which omits a quarter of the values at either end."""
    from scipy.stats import trim_mean

    return trim_mean(np.concatenate(strata, axis=axis), 0.25, axis=axis)


def difference(*strata: Array, axis: int = -1) -> Any:
    """Return the interquartile mean of the first half of the strata minus that of the second."""
    half = len(strata) // 2
    return iqm(*strata[:half], axis=axis) - iqm(*strata[half:], axis=axis)


def improvement(*strata: Array, axis: int = -1) -> Any:
    """Return the probability that a run of the first half exceeds one of the second, for the same difficulty.

    Ties count one half: this is the Mann-Whitney statistic over the number of pairs, averaged over the difficulties.
    """
    half = len(strata) // 2
    probabilities = []
    for ours, theirs in zip(strata[:half], strata[half:], strict=True):
        gap = np.moveaxis(ours, axis, -1)[..., :, None] - np.moveaxis(theirs, axis, -1)[..., None, :]
        probabilities.append(((gap > 0) + 0.5 * (gap == 0)).mean(axis=(-2, -1)))
    return np.mean(probabilities, axis=0)


def interval(strata: Sequence[Sequence[float]], statistic: Statistic = iqm) -> Interval:
    """Return a statistic with its 95 % interval, from percentiles of the stratified bootstrap.

    Args:
        strata: Values of runs; to compare two arms, the strata of the first and then those of the second.
        statistic: Computes the statistic of the strata along ``axis``.

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
    # The same draws every time, so that equal results give equal tables.
    draws: dict[str, Any] = {"random_state": np.random.default_rng(0)}  # called "rng" from SciPy 1.15 on
    bounds = bootstrap(
        values, statistic, n_resamples=_RESAMPLES, method="percentile", confidence_level=LEVEL, vectorized=True,
        **draws,
    ).confidence_interval  # fmt: skip
    return Interval(found, float(bounds.low), float(bounds.high))


@dataclass(frozen=True)
class ArmSummary:
    """The results of an arm. Values by difficulty include ``"all"`` if there are several difficulties.

    Attributes:
        runs: Number of finished runs.
        success: By difficulty: goals reached in the last evaluation, in percent.
        final_mm: By difficulty: mean final error of the true points, in millimetres.
        curve: By difficulty: goals reached at each evaluation, by steps of training.
        steps_to: By difficulty: steps of training before the first evaluation that reached each of ``LEVELS``
            percent; None for never.
        area: By difficulty: goals reached, averaged from the first evaluation to the last, in percent.
        lost: By disturbance: decrease of goals reached, in percentage points, for all difficulties.
        ms_training: Duration of a step in training in milliseconds, without evaluations; mean over the runs.
        ms_acting: Duration of a step with the trained policy in milliseconds; mean over the runs.
        difference: Success minus that of the reference, in percentage points; None for the reference itself.
        improvement: Probability that a run of the arm reaches more goals than one of the reference.
    """

    runs: int
    success: Mapping[str, Interval]
    final_mm: Mapping[str, Interval]
    curve: Mapping[str, Mapping[int, Interval]]
    steps_to: Mapping[str, tuple[int | None, ...]]
    area: Mapping[str, Interval]
    lost: Mapping[str, Interval]
    ms_training: float
    ms_acting: float
    difference: Interval | None
    improvement: Interval | None


def summarize(study: Study, runs: Sequence[FinishedRun]) -> dict[str, ArmSummary]:
    """Return the results of all arms with a finished run.

    Success, error and area are interquartile means over runs, with 95 % stratified bootstrap intervals.
    """
    by_arm = {arm: [run for run in runs if run.arm == arm] for arm in study.arms}
    reference = study.reference or next(iter(study.arms))
    return {
        arm: _summary(study, some, None if arm == reference else by_arm[reference])
        for arm, some in by_arm.items()
        if some
    }


def groups(study: Study) -> dict[str, tuple[str, ...]]:
    """Return the groups of difficulties: each difficulty, and all of them if there are several."""
    names = study.evaluation.difficulties
    return {**{name: (name,) for name in names}, **({ALL: names} if len(names) > 1 else {})}


def _summary(study: Study, runs: Sequence[FinishedRun], reference: Sequence[FinishedRun] | None) -> ArmSummary:
    parts = groups(study)
    whole = study.evaluation.difficulties
    success = {name: interval(_success(runs, some)) for name, some in parts.items()}
    curve = {
        name: {steps: interval(_success(runs, some, steps)) for steps in runs[0].steps} for name, some in parts.items()
    }
    both = None if not reference else _success(runs, whole) + _success(reference, whole)
    return ArmSummary(
        runs=len(runs),
        success=success,
        final_mm={
            name: interval([[run.final_mm(each) for run in runs] for each in some]) for name, some in parts.items()
        },
        curve=curve,
        steps_to={name: tuple(_first(curve[name], level) for level in LEVELS) for name in parts},
        area={name: interval([[_area(run, each) for run in runs] for each in some]) for name, some in parts.items()},
        lost={name: interval(_lost(runs, whole, name)) for name in runs[0].disturbances},
        ms_training=float(np.mean([run.about["ms_per_step"] for run in runs])),
        ms_acting=float(np.mean([run.ms_acting() for run in runs])),
        difference=None if both is None else interval(both, difference),
        improvement=None if both is None else interval(both, improvement),
    )


def _success(runs: Sequence[FinishedRun], difficulties: Sequence[str], steps: int | None = None) -> list[list[float]]:
    """Return a stratum for each difficulty, with one value per run."""
    return [[run.success(each, steps) for run in runs] for each in difficulties]


def _lost(runs: Sequence[FinishedRun], difficulties: Sequence[str], disturbance: str) -> list[list[float]]:
    return [[run.success(each) - run.success(each, disturbance=disturbance) for run in runs] for each in difficulties]


def _first(curve: Mapping[int, Interval], level: float) -> int | None:
    return next((steps for steps, found in curve.items() if found.value >= level), None)


def _area(run: FinishedRun, difficulty: str) -> float:
    from scipy.integrate import trapezoid

    reached = [run.success(difficulty, steps) for steps in run.steps]
    if len(reached) == 1:
        return reached[0]
    return float(trapezoid(reached, run.steps) / (run.steps[-1] - run.steps[0]))
