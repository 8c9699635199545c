"""A row for each episode, for each combination, and for the camera beside the truth."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.stats import DegenerateDataWarning, binomtest, bootstrap

from shape_obs.bench.servo.episode import REACHED, Episode
from shape_obs.bench.servo.settings import Disturbance, Setting
from shape_obs.bench.servo.study import Found

Row = dict[str, Any]

_RESAMPLES: Final = 4000
_CONFIDENCE: Final = 0.95
_LONG: Final = ("errors_mm", "start", "goal", "final")  # of an episode: what fills no cell


def episode_rows(found: Found) -> list[Row]:
    """A row for each episode: what it was, and all of its numbers."""
    return [
        _named(setting) | {name: value for name, value in episode.to_dict().items() if name not in _LONG}
        for setting, some in found.items()
        for episode in some
    ]


def summary_rows(found: Found) -> list[Row]:
    """A row for each setting.

    ``success`` is the percentage of goals whose final error is below 10 mm, ``low`` and ``high`` its Wilson interval of
    95 %; ``ever`` counts goals that were within 10 mm at any time; ``steps`` is the median over those that were
    reached. What broke off counts nowhere but in ``failed``.
    """
    return [_named(setting) | _summary(some) for setting, some in found.items()]


def paired_rows(found: Found, seed: int = 0) -> list[Row]:
    """The camera beside the truth on the same goals, by difficulty and in all where there are several.

    ``ratio`` is the camera's number of goals reached over the truth's; ``low`` and ``high`` are its 95 % interval by a
    paired percentile bootstrap over goals (Efron & Tibshirani, 'An introduction to the bootstrap', ch. 13). None where
    the true points reached none, or so few that more than a tail of the resamples has none; fewer are left out.

    Args:
        found: All episodes.
        seed: Of the resampling.
    """
    pairs: dict[Setting, npt.NDArray[np.bool_]] = {}
    for setting, seen in found.items():
        twin = setting._replace(source="truth", disturbance=Disturbance())
        if setting.source == "truth" or twin not in found:
            continue
        both = [(a, b) for a, b in zip(seen, found[twin], strict=True) if not (a.failure or b.failure)]
        pairs[setting] = np.array([(a.success, b.success) for a, b in both], bool).reshape(-1, 2)
    groups: dict[tuple[Any, ...], list[Setting]] = {}
    for setting in pairs:
        groups.setdefault(setting._replace(difficulty="near"), []).append(setting)
    rows = []
    for settings in groups.values():
        rows += [_paired(setting, setting.difficulty, pairs[setting], seed) for setting in settings]
        if len(settings) > 1:
            rows.append(_paired(settings[0], "all", np.concatenate([pairs[each] for each in settings]), seed))
    return rows


def _named(setting: Setting) -> Row:
    wrong = setting.disturbance
    blackout = "" if wrong.blackout is None else "{}+{}".format(*wrong.blackout)
    return {
        "env": setting.env, "difficulty": setting.difficulty, "source": setting.source, "size": setting.size,
        "features": setting.features, "law": setting.law, "invalid": wrong.invalid, "blackout": blackout,
    }  # fmt: skip


def _summary(some: Sequence[Episode]) -> Row:
    whole = [episode for episode in some if not episode.failure]
    reached = sum(episode.success for episode in whole)
    low, high = _wilson(reached, len(whole))
    final = [episode.final_mm for episode in whole if episode.final_mm is not None]
    ever = [episode.best_mm is not None and episode.best_mm < REACHED for episode in whole]
    return {
        "n": len(whole),
        "failed": len(some) - len(whole),
        "success": _percent(reached, len(whole)),
        "low": low,
        "high": high,
        "ever": _percent(sum(ever), len(whole)),
        "steps": _median(episode.steps if episode.success else None for episode in whole),
        "start_mm": _median(episode.start_mm for episode in whole),
        "median_mm": _median(final),
        "p90_mm": float(np.percentile(final, 90)) if final else None,
        "prediction": _median(episode.prediction for episode in whole),
        "seen_mm": _median(episode.seen_mm for episode in whole),
        "detector_ms": _median(episode.detector_ms for episode in whole),
        "feature_ms": _median(episode.feature_ms for episode in whole),
        "blackout_action": max((e.blackout_action for e in whole if e.blackout_action is not None), default=None),
        "blackout_mm": max((e.blackout_mm for e in whole if e.blackout_mm is not None), default=None),
    }


def _paired(setting: Setting, difficulty: str, pairs: npt.NDArray[np.bool_], seed: int) -> Row:
    low, high = _ratio_interval(pairs, seed)
    camera, truth = pairs.sum(axis=0).tolist()
    return _named(setting) | {
        "difficulty": difficulty,
        "n": len(pairs),
        "camera": _percent(camera, len(pairs)),
        "truth": _percent(truth, len(pairs)),
        "ratio": camera / truth if truth else None,
        "low": low,
        "high": high,
    }


def _ratio_interval(pairs: npt.NDArray[np.bool_], seed: int) -> tuple[float | None, float | None]:
    """The interval of the ratio of two counts; None where too many resamples have no success of the truth."""
    if len(pairs) < 2 or not pairs[:, 1].any():
        return None, None

    def ratio(camera: Any, truth: Any, axis: int) -> Any:
        below = truth.sum(axis=axis)
        return np.divide(camera.sum(axis=axis), below, out=np.full(np.shape(below), np.nan), where=below > 0)

    # `rng` came with SciPy 1.15.
    fixed: Any = {"method": "percentile", "random_state": np.random.default_rng(seed)}
    values = tuple(pairs.T.astype(np.float64))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DegenerateDataWarning)  # what NaN means is told here
        found = bootstrap(
            values, ratio, paired=True, vectorized=True, n_resamples=_RESAMPLES, confidence_level=_CONFIDENCE, **fixed
        )
    ratios, tail = found.bootstrap_distribution, (1 - _CONFIDENCE) / 2
    if np.isnan(ratios).mean() > tail:
        return None, None
    low, high = np.nanquantile(ratios, [tail, 1 - tail])
    return float(low), float(high)


def _wilson(reached: int, count: int) -> tuple[float | None, float | None]:
    if not count:
        return None, None
    interval = binomtest(reached, count).proportion_ci(_CONFIDENCE, method="wilson")
    return 100 * float(interval.low), 100 * float(interval.high)


def _percent(part: int, whole: int) -> float | None:
    return 100 * part / whole if whole else None


def _median(values: Any) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None
