"""Statistics of few runs: interquartile means with stratified bootstrap intervals (Agarwal et al., NeurIPS 2021).

Runs are what is drawn anew: episodes of one run share its policy. A stratum holds a value of each run of an arm, on
goals of one difficulty; each stratum is drawn by itself.

Summary: the figures of a study's arms.
"""

from __future__ import annotations
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple
import numpy as np
import numpy.typing as npt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final
from shape_obs.ablation.results import Finished
from shape_obs.ablation.study import Study


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



ALL: Final = "all"

LEVELS: Final = (50, 80, 90)



@dataclass(frozen=True)
class ArmSummary:
    """Figures of an arm. What is told by difficulty is told for ``"all"`` of them too, where there are several.

    Attributes:
        runs: How many were done.
        success: By difficulty: goals reached in the end, per cent.
        final_mm: By difficulty: mean error in the end, millimetres of the true points.
        curve: By difficulty: goals reached at each evaluation, by steps of training.
        steps_to: By difficulty: steps of training at the first evaluation where ``LEVELS`` per cent were reached; None
            for never.
        area: By difficulty: goals reached on average from the first evaluation to the last, per cent.
        lost: By disturbance: goals no longer reached under it, points of a hundred; of all difficulties.
        ms_training: Of a step in training, milliseconds, without evaluations; mean over the runs.
        ms_acting: Of a step with the trained policy; mean over the runs.
        difference: Success less that of the reference, points of a hundred; None for the reference itself.
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



def summarize(study: Study, runs: Sequence[Finished]) -> dict[str, ArmSummary]:
    """The figures of all arms of which a run is done.

    Success is the interquartile mean over runs, as are error and area, with a 95 % stratified bootstrap interval.
    """
    by_arm = {arm: [run for run in runs if run.arm == arm] for arm in study.arms}
    reference = study.reference or next(iter(study.arms))
    return {
        arm: _summary(study, some, None if arm == reference else by_arm[reference])
        for arm, some in by_arm.items()
        if some
    }



def groups(study: Study) -> dict[str, tuple[str, ...]]:
    """The difficulties of each figure: each by itself, and all."""
    names = study.evaluation.difficulties
    return {**{name: (name,) for name in names}, **({ALL: names} if len(names) > 1 else {})}



def _summary(study: Study, runs: Sequence[Finished], reference: Sequence[Finished] | None) -> ArmSummary:
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



def _success(runs: Sequence[Finished], difficulties: Sequence[str], steps: int | None = None) -> list[list[float]]:
    """Strata: a list for each difficulty, with a value of each run."""
    return [[run.success(each, steps) for run in runs] for each in difficulties]



def _lost(runs: Sequence[Finished], difficulties: Sequence[str], disturbance: str) -> list[list[float]]:
    return [[run.success(each) - run.success(each, disturbance=disturbance) for run in runs] for each in difficulties]



def _first(curve: Mapping[int, Interval], level: float) -> int | None:
    return next((steps for steps, found in curve.items() if found.value >= level), None)



def _area(run: Finished, difficulty: str) -> float:
    from scipy.integrate import trapezoid

    reached = [run.success(difficulty, steps) for steps in run.steps]
    if len(reached) == 1:
        return reached[0]
    return float(trapezoid(reached, run.steps) / (run.steps[-1] - run.steps[0]))

