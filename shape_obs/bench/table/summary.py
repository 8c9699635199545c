"""Summarise a run: means with intervals, and whether the ranking is that of the paper."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student

from shape_obs.bench.table.frames import CONFIGURATIONS, OF, Name, Trace, Tracing, missing
from shape_obs.bench.table.methods import METHODS, Method, Row
from shape_obs.bench.table.run import Parts, Plan

Array = npt.NDArray[np.float64]

LABELS: Final[dict[Method, str]] = {
    "gmm": "GMM",
    "fcm": "FCM",
    "kmeans": "KMA",
    "kohonen": "SOM (paper's)",
    "som": "ours",
}
TRACED: Final[dict[Tracing, str]] = {
    "thinning": "thinning",
    "contours": "findContours, every pixel",
    "corners": "findContours, corners alone",
}
# Table I of the paper: silhouette, Calinski-Harabasz, seconds.
PAPER: Final[dict[Method, dict[str, float]]] = {
    "gmm": {"sc": 0.342, "ch": 47593, "ms": 208},
    "fcm": {"sc": 0.268, "ch": 39072, "ms": 187},
    "kmeans": {"sc": 0.254, "ch": 34874, "ms": 126},
    "kohonen": {"sc": 0.279, "ch": 42081, "ms": 63},
}
MEASURES: Final = {"sc": "silhouette", "ch": "Calinski-Harabasz", "ms": "time"}


class Mean(NamedTuple):
    """A mean and half its 95 % interval, which is NaN if there are too few chunks."""

    value: float
    half: float


@dataclass(frozen=True)
class Result:
    """One method on one configuration, or on all.

    Args:
        configuration: Name of the configuration, or ``"all"``.
        method: Name of the method.
        frames: Number of frames.
        refused: Frames without a shape, which the other values leave out.
        pixels: Mean of M.
        sc: Silhouette.
        ch: Calinski-Harabasz.
        ms: Milliseconds.
        cv: Standard deviation over mean of the gaps.
        ordered: Share of the frames with the order right.
        own_order: Share of the frames on which the method itself returns the right order.
        settled: Share of the frames on which it converged.
    """

    configuration: str
    method: Method
    frames: int
    refused: int
    pixels: float
    sc: Mean
    ch: Mean
    ms: Mean
    cv: float
    ordered: float
    own_order: float
    settled: float


@dataclass(frozen=True)
class Traced:
    """A tracing over all frames of its configuration.

    Args:
        tracing: Name of the tracing.
        points: Least, median and largest number of points.
        changed: Share of the frames with another number of points than the previous frame.
        moved: Median and largest motion of the first point over the material within an episode, as shares of the curve.
        ordered: Share of the frames whose points follow each other along the known curve.
        tips: Largest number of ends of a thinned mask; a rope has two.
        ms: Mean milliseconds.
    """

    tracing: Tracing
    points: tuple[int, int, int]
    changed: float
    moved: tuple[float, float]
    ordered: float
    tips: int
    ms: float


class Ranking(NamedTuple):
    """The paper's four methods by one measure, best first.

    Args:
        measure: Name of the measure.
        paper: The order in the paper.
        here: The order in this run.
        pairs: How many of the six pairs are ordered as in the paper: the mean difference on equal frames is farther
            from zero than half its 95 % interval.
        against: How many are ordered the other way round; the others are undecided.
    """

    measure: str
    paper: tuple[Method, ...]
    here: tuple[Method, ...]
    pairs: int
    against: int

    @property
    def holds(self) -> bool:
        """Whether the order is that of the paper."""
        return self.paper == self.here


def results(parts: Parts, plan: Plan) -> list[Result]:
    """Summarise every method that is complete on a configuration, and over all if it is complete on each."""
    found: list[Result] = []
    for method in METHODS:
        strata = _strata(parts, plan, method)
        found += [_result(name, method, [chunks]) for name, chunks in strata.items()]
        if len(strata) == len(CONFIGURATIONS):
            found.append(_result("all", method, list(strata.values())))
    return found


def tracings(parts: Parts, plan: Plan) -> list[Traced]:
    """Summarise every tracing that is complete."""
    found, chunks = [], range(len(plan.chunks))
    for tracing, name in OF.items():
        if not missing(tracing) and all(parts.has(name, tracing, chunk) for chunk in chunks):
            found.append(_traced(tracing, [parts.read(name, tracing, chunk, Trace) for chunk in chunks]))
    return found


def rankings(parts: Parts, plan: Plan) -> list[Ranking]:
    """Rank the methods by each measure over all configurations, if all of the paper's methods are complete."""
    strata = {method: list(_strata(parts, plan, method).values()) for method in PAPER}
    if any(len(of) < len(CONFIGURATIONS) for of in strata.values()):
        return []
    ranked = []
    for measure in MEASURES:
        worse_is = 1 if measure == "ms" else -1  # the sign of a difference towards the worse
        means = {method: [_chunk_means(chunks, measure) for chunks in of] for method, of in strata.items()}
        paper = sorted(PAPER, key=lambda method, m=measure, sign=worse_is: sign * PAPER[method][m])
        here = sorted(PAPER, key=lambda method, of=means, sign=worse_is: sign * _mean(of[method]).value)
        votes = {-1: 0, 0: 0, 1: 0}
        for better, worse in combinations(paper, 2):
            pairs = zip(means[better], means[worse], strict=True)
            gap = _mean([worse_is * (theirs - ours) for ours, theirs in pairs])
            votes[int(np.sign(gap.value)) if abs(gap.value) > gap.half else 0] += 1
        ranked.append(Ranking(measure, tuple(paper), tuple(here), votes[1], votes[-1]))
    return ranked


def every_row(parts: Parts, plan: Plan) -> list[dict[str, Any]]:
    """Return all frames of all measured methods as flat rows."""
    rows = []
    for name in CONFIGURATIONS:
        for method in METHODS:
            head = {"configuration": name, "method": method}
            for chunk in range(len(plan.chunks)):
                if parts.has(name, method, chunk):
                    rows += [{**head, **vars(row)} for row in parts.read(name, method, chunk, Row)]
    return rows


def _result(name: str, method: Method, strata: list[list[list[Row]]]) -> Result:
    """Summarise strata (configurations) of chunks of rows."""
    rows = [row for chunks in strata for chunk in chunks for row in chunk]
    good = [row for row in rows if row.ok]
    if not good:
        nothing = Mean(np.nan, np.nan)
        return Result(name, method, len(rows), len(rows), np.nan, nothing, nothing, nothing, *4 * (np.nan,))
    return Result(
        configuration=name,
        method=method,
        frames=len(rows),
        refused=len(rows) - len(good),
        pixels=float(np.mean([row.pixels for row in good])),
        **{measure: _mean([_chunk_means(chunks, measure) for chunks in strata]) for measure in MEASURES},
        cv=float(np.mean([row.cv for row in good])),
        ordered=float(np.mean([row.ordered for row in good])),
        own_order=float(np.mean([row.own_order for row in good])),
        settled=float(np.mean([row.settled for row in good])),
    )


def _strata(parts: Parts, plan: Plan, method: Method) -> dict[Name, list[list[Row]]]:
    """Return the rows of a method, chunk by chunk, of the configurations on which it is complete."""
    chunks = range(len(plan.chunks))
    return {
        name: [parts.read(name, method, chunk, Row) for chunk in chunks]
        for name in CONFIGURATIONS
        if all(parts.has(name, method, chunk) for chunk in chunks)
    }


def _chunk_means(chunks: list[list[Row]], measure: str) -> Array:
    """Return the mean over the frames of each chunk, (C,); NaN for a chunk without any shape."""
    values = [[getattr(row, measure) for row in chunk if row.ok] for chunk in chunks]
    return np.array([np.mean(of) if of else np.nan for of in values])


def _mean(strata: list[Array]) -> Mean:
    """Return the mean of the strata's means with its interval; each chunk counts as one sample."""
    values, squares, freedom = [], [], 0
    for means in strata:
        known = means[np.isfinite(means)]
        if len(known):
            values.append(known.mean())
            squares.append(known.var(ddof=1) / len(known) if len(known) > 1 else np.nan)
            freedom += len(known) - 1
    half = student.ppf(0.975, freedom) * np.sqrt(np.sum(squares)) / len(squares) if freedom else np.nan
    return Mean(float(np.mean(values)), float(half))


def _traced(tracing: Tracing, chunks: list[list[Trace]]) -> Traced:
    rows = [row for chunk in chunks for row in chunk]
    points = np.array([row.points for row in rows])
    changed = np.concatenate([np.diff([row.points for row in chunk]) != 0 for chunk in chunks])
    moved = [_reach(np.array([row.start for row in chunk]), closed=OF[tracing] == "contour") for chunk in chunks]
    return Traced(
        tracing=tracing,
        points=(int(points.min()), int(np.median(points)), int(points.max())),
        changed=float(changed.mean()) if len(changed) else np.nan,
        moved=(float(np.median(moved)), float(np.max(moved))),
        ordered=float(np.mean([row.ordered for row in rows])),
        tips=max(row.tips for row in rows),
        ms=float(np.mean([row.ms for row in rows])),
    )


def _reach(start: Array, *, closed: bool) -> float:
    """Return the largest distance of a start from its first position as a share of the curve, the shorter way round."""
    off = np.abs(start - start[0])
    return float(np.max(np.minimum(off, 1 - off) if closed else off))
