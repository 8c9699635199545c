"""Play the episodes of all settings, keep them so that a run can continue, and summarise them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.stats import DegenerateDataWarning, binomtest, bootstrap

from shape_obs import __version__
from shape_obs.utils.files import write_text
from tests.benchmarks import run_tasks
from tests.benchmarks.servo.episode import REACHED, STEPS, Found, episodes
from tests.benchmarks.servo.settings import Disturbance, Setting
from tests.benchmarks.tables import Parts, Row, as_csv, as_markdown, grouped, median

_CHUNK: Final = 5  # episodes for which a world is made
_RESAMPLES: Final = 4000
_CONFIDENCE: Final = 0.95
_LONG: Final = ("errors_mm", "start", "goal", "final")  # fields of an episode that do not fit in a cell
_NAMED: Final = ("env", "difficulty", "source", "size", "features", "law")  # fields of a setting in the tables
_IF_ANY: Final = ("failed", "invalid")


def run(
    settings: Sequence[Setting],
    seeds: Sequence[int],
    *,
    steps: int = STEPS,
    jobs: int = 1,
    folder: Path | None = None,
    resume: bool = False,
    tick: Callable[[Setting, Row], object] = lambda setting, episode: None,
) -> Found:
    """Play the same goals under every setting.

    Args:
        settings: The settings to compare.
        seeds: One seed for each goal, the same for all settings.
        steps: Steps of an episode.
        jobs: Number of processes.
        folder: Where finished episodes are kept; None keeps them nowhere.
        resume: Use the episodes in the folder, except those that broke off.
        tick: Called with each episode, kept ones included.

    Returns:
        The episodes of each setting, in the order of the seeds.

    Raises:
        ValueError: The folder holds episodes of another version or length, or a setting is not understood.
    """
    kept: dict[Setting, dict[int, Row]] = {setting: {} for setting in settings}
    stores = {} if folder is None else {each: Parts(folder, _made_with(each, steps)) for each in settings}
    if resume:
        for setting, store in stores.items():
            found = store.read(setting.name) or ()
            kept[setting] = {episode.seed: episode for episode in found if not episode.failure}
    tasks = []
    for setting, done in kept.items():
        for seed in seeds:
            if seed in done:
                tick(setting, done[seed])
        left = [seed for seed in seeds if seed not in done]
        tasks += [(setting, left[first : first + _CHUNK], steps) for first in range(0, len(left), _CHUNK)]
    for setting, episode in _played(tasks, jobs):
        kept[setting][episode.seed] = episode
        if stores:
            stores[setting].write(setting.name, [kept[setting][seed] for seed in sorted(kept[setting])])
        tick(setting, episode)
    return {setting: [done[seed] for seed in seeds] for setting, done in kept.items()}


def _played(tasks: Sequence[tuple[Setting, list[int], int]], jobs: int) -> Iterator[tuple[Setting, Row]]:
    chunks: Any = ((task[0], episodes(*task)) for task in tasks) if jobs == 1 else run_tasks(_chunk, tasks, jobs)
    for setting, found in chunks:
        for episode in found:
            yield setting, episode


def _chunk(setting: Setting, seeds: Sequence[int], steps: int) -> tuple[Setting, list[Row]]:
    return setting, list(episodes(setting, seeds, steps))


def _made_with(setting: Setting, steps: int) -> Mapping[str, Any]:
    return {"shape_obs": __version__, "steps": steps, "renderer": setting.renderer, "pca": setting.pca}


def write_tables(found: Found, folder: Path) -> None:
    """Write ``episodes.csv``, ``summary.csv`` and ``table.md``, and ``paired.csv`` if there are pairs."""
    rows, pairs = summary_rows(found), paired_rows(found)
    write_text(folder / "episodes.csv", as_csv(episode_rows(found)))
    write_text(folder / "summary.csv", as_csv(rows))
    page = "# Shape servoing\n\n" + as_markdown(without_empty(rows))
    if pairs:
        write_text(folder / "paired.csv", as_csv(pairs))
        page += "\n\n## The camera and the true points\n\n" + as_markdown(without_empty(pairs))
    write_text(folder / "table.md", page + "\n")


def without_empty(rows: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Return the rows without columns that are empty in all of them: no disturbance, no failure, no detector."""
    names = rows[0] if rows else ()
    kept = [name for name in names if any(row[name] not in (None, "") for row in rows)]
    kept = [name for name in kept if name not in _IF_ANY or any(row[name] for row in rows)]
    return [Row({name: row[name] for name in kept}) for row in rows]


def episode_rows(found: Found) -> list[Row]:
    """Return a row for each episode with its setting and all of its numbers."""
    return [
        Row(_named(setting), **{name: value for name, value in episode.items() if name not in _LONG})
        for setting, some in found.items()
        for episode in some
    ]


def summary_rows(found: Found) -> list[Row]:
    """Return a row for each setting.

    ``success`` is the percentage of goals whose final error is below 10 mm, ``low`` and ``high`` its Wilson interval of
    95 %; ``ever`` counts goals that were within 10 mm at any time; ``steps`` is the median over the reached goals.
    Rows that broke off count only in ``failed``.
    """
    return [Row(_named(setting), **_summary(some)) for setting, some in found.items()]


def paired_rows(found: Found) -> list[Row]:
    """Compare the camera with the truth on the same goals, by difficulty and over all if there are several.

    ``ratio`` is the number of goals reached from the camera over the number reached from the true points; ``low`` and
    ``high`` are its 95 % interval by a paired percentile bootstrap over goals (Efron & Tibshirani, 'An introduction to
    the bootstrap', ch. 13). The interval is None if more than one tail of the resamples has no success of the truth;
    if fewer have none, they are left out.
    """
    pairs: dict[Setting, npt.NDArray[np.bool_]] = {}
    for setting, seen in found.items():
        twin = setting._replace(source="truth", disturbance=Disturbance())
        if setting.source == "truth" or twin not in found:
            continue
        both = [(a, b) for a, b in zip(seen, found[twin], strict=True) if not (a.failure or b.failure)]
        pairs[setting] = np.array([(a.success, b.success) for a, b in both], bool).reshape(-1, 2)
    rows = []
    for settings in grouped(pairs, lambda setting: setting._replace(difficulty="near")).values():
        rows += [_paired(setting, pairs[setting]) for setting in settings]
        if len(settings) > 1:
            every = np.concatenate([pairs[each] for each in settings])
            rows.append(Row(_paired(settings[0], every), difficulty="all"))
    return rows


def _named(setting: Setting) -> Row:
    wrong = setting.disturbance
    blackout = "" if wrong.blackout is None else "{}+{}".format(*wrong.blackout)
    named = {name: getattr(setting, name) for name in _NAMED}
    rope = "" if setting.rope is None else setting.rope
    return Row(named, view=setting.view or "", rope=rope, invalid=wrong.invalid, blackout=blackout)


def _summary(some: Sequence[Row]) -> Row:
    whole = [episode for episode in some if not episode.failure]
    reached = sum(episode.success for episode in whole)
    low, high = _wilson(reached, len(whole))
    final = [episode.final_mm for episode in whole]
    ever = [episode.best_mm < REACHED for episode in whole]

    def middle(name: str) -> float | None:
        return median(episode[name] for episode in whole)

    def largest(name: str) -> float | None:
        return max((value for episode in whole if (value := episode[name]) is not None), default=None)

    return Row(
        n=len(whole),
        failed=len(some) - len(whole),
        success=_percent(reached, len(whole)),
        low=low,
        high=high,
        ever=_percent(sum(ever), len(whole)),
        steps=median(episode.steps if episode.success else None for episode in whole),
        start_mm=middle("start_mm"),
        median_mm=median(final),
        p90_mm=float(np.percentile(final, 90)) if final else None,
        **{name: middle(name) for name in ("prediction", "seen_mm", "detector_ms", "feature_ms")},
        **{name: largest(name) for name in ("blackout_action", "blackout_mm")},
    )


def _paired(setting: Setting, pairs: npt.NDArray[np.bool_]) -> Row:
    low, high = _ratio_interval(pairs)
    camera, truth = pairs.sum(axis=0).tolist()
    return Row(
        _named(setting),
        n=len(pairs),
        camera=_percent(camera, len(pairs)),
        truth=_percent(truth, len(pairs)),
        ratio=camera / truth if truth else None,
        low=low,
        high=high,
    )


def _ratio_interval(pairs: npt.NDArray[np.bool_]) -> tuple[float | None, float | None]:
    """Return the interval of the ratio of two counts; None if too many resamples have no success of the truth."""
    if len(pairs) < 2 or not pairs[:, 1].any():
        return None, None

    def ratio(camera: Any, truth: Any, axis: int) -> Any:
        below = truth.sum(axis=axis)
        return np.divide(camera.sum(axis=axis), below, out=np.full(np.shape(below), np.nan), where=below > 0)

    # `rng` came with SciPy 1.15.
    fixed: Any = {"method": "percentile", "random_state": np.random.default_rng(0)}
    values = tuple(pairs.T.astype(np.float64))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DegenerateDataWarning)  # NaN is handled below
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
