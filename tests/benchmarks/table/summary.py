"""Summarise a run: means with intervals, and whether the ranking is that of the paper."""

from __future__ import annotations

from itertools import combinations
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student

from tests.benchmarks.table.frames import CONFIGURATIONS, OF, Name, Tracing
from tests.benchmarks.table.methods import METHODS, Method
from tests.benchmarks.table.run import Chunks, Done, Plan
from tests.benchmarks.tables import Row, mean

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


def results(done: Done, plan: Plan) -> list[Row]:
    """Summarise every method that is complete on a configuration, and over all if it is complete on each.

    Returns:
        Rows with number of ``frames``, and those ``refused``, which the other values leave out; the means of M
        (``pixels``), of the measures with half their 95 % intervals (NaN if there are too few chunks), and of ``cv``;
        the shares of the frames with the order right (``ordered``, ``own_order``) and on which the method ``settled``.
    """
    found: list[Row] = []
    for method in METHODS:
        strata = _strata(done, plan, method)
        found += [_result(name, method, [chunks]) for name, chunks in strata.items()]
        if len(strata) == len(CONFIGURATIONS):
            found.append(_result("all", method, list(strata.values())))
    return found


def rankings(done: Done, plan: Plan) -> list[Row]:
    """Rank the paper's methods by each measure over all configurations, if all of them are complete.

    Returns:
        For each measure the orders in the ``paper`` and ``here``, best first, and whether the paper's ``holds``;
        ``pairs``: how many of the six pairs are ordered as in the paper: the mean difference on equal frames is farther
        from zero than half its 95 % interval; ``against``: how many are ordered the other way round; the others are
        undecided.
    """
    strata = {method: list(_strata(done, plan, method).values()) for method in PAPER}
    if any(len(of) < len(CONFIGURATIONS) for of in strata.values()):
        return []
    ranked = []
    for measure in MEASURES:
        worse_is = 1 if measure == "ms" else -1  # the sign of a difference towards the worse
        means = {method: [_chunk_means(chunks, measure) for chunks in of] for method, of in strata.items()}
        paper = sorted(PAPER, key=lambda method, m=measure, sign=worse_is: sign * PAPER[method][m])
        here = sorted(PAPER, key=lambda method, of=means, sign=worse_is: sign * _mean(of[method])[0])
        votes = {-1: 0, 0: 0, 1: 0}
        for better, worse in combinations(paper, 2):
            pairs = zip(means[better], means[worse], strict=True)
            gap, half = _mean([worse_is * (theirs - ours) for ours, theirs in pairs])
            votes[int(np.sign(gap)) if abs(gap) > half else 0] += 1
        orders = {"paper": tuple(paper), "here": tuple(here), "holds": paper == here}
        ranked.append(Row(measure=measure, **orders, pairs=votes[1], against=votes[-1]))
    return ranked


def tracings(done: Done, plan: Plan) -> list[Row]:
    """Summarise every tracing that is complete over all frames of its configuration.

    Returns:
        Least, median and largest number of ``points``; ``changed``: share of the frames with another number of points
        than the previous frame; ``moved``: median and largest motion of the first point over the material within an
        episode, as shares of the curve; ``ordered``: share of the frames whose points follow each other along the known
        curve; ``tips``: largest number of ends of a thinned mask, a rope has two; ``ms``: mean milliseconds.
    """
    found = []
    for tracing, name in OF.items():
        chunks = done.get((name, tracing), [])
        if len(chunks) < len(plan.chunks):
            continue
        rows = [row for chunk in chunks for row in chunk]
        points = np.array([row.points for row in rows])
        changed = np.concatenate([np.diff([row.points for row in chunk]) != 0 for chunk in chunks])
        moved = [_reach(np.array([row.start for row in chunk]), closed=name == "contour") for chunk in chunks]
        found.append(
            Row(
                tracing=tracing,
                points=(int(points.min()), int(np.median(points)), int(points.max())),
                changed=float(changed.mean()) if len(changed) else np.nan,
                moved=(float(np.median(moved)), float(np.max(moved))),
                ordered=mean(row.ordered for row in rows),
                tips=max(row.tips for row in rows),
                ms=mean(row.ms for row in rows),
            )
        )
    return found


def every_row(done: Done) -> list[Row]:
    """Return all frames of all measured methods as flat rows."""
    return [
        Row(configuration=name, method=method, **row)
        for (name, method), chunks in done.items()
        if method in METHODS
        for chunk in chunks
        for row in chunk
    ]


def _result(name: str, method: Method, strata: list[Chunks]) -> Row:
    """Summarise strata (configurations) of chunks of rows."""
    rows = [row for chunks in strata for chunk in chunks for row in chunk]
    good = [row for row in rows if row.ok]
    result = Row(configuration=name, method=method, frames=len(rows), refused=len(rows) - len(good))
    for value in ("pixels", "cv", "ordered", "own_order", "settled"):
        result[value] = mean(row[value] for row in good) if good else np.nan
    for measure in MEASURES:
        means = [_chunk_means(chunks, measure) for chunks in strata]
        result[measure], result[f"{measure}_half_interval"] = _mean(means) if good else (np.nan, np.nan)
    return result


def _strata(done: Done, plan: Plan, method: Method) -> dict[Name, Chunks]:
    """Return the rows of a method, chunk by chunk, of the configurations on which it is complete."""
    found: dict[Name, Chunks] = {name: done.get((name, method), []) for name in CONFIGURATIONS}
    return {name: chunks for name, chunks in found.items() if len(chunks) == len(plan.chunks)}


def _chunk_means(chunks: Chunks, measure: str) -> Array:
    """Return the mean over the frames of each chunk, ``(C,)``; NaN for a chunk without any shape."""
    values = [[row[measure] for row in chunk if row.ok] for chunk in chunks]
    return np.array([np.mean(of) if of else np.nan for of in values])


def _mean(strata: list[Array]) -> tuple[float, float]:
    """Return the mean of the strata's means and half its 95 % interval; each chunk counts as one sample."""
    values, squares, freedom = [], [], 0
    for means in strata:
        known = means[np.isfinite(means)]
        if len(known):
            values.append(known.mean())
            squares.append(known.var(ddof=1) / len(known) if len(known) > 1 else np.nan)
            freedom += len(known) - 1
    half = student.ppf(0.975, freedom) * np.sqrt(np.sum(squares)) / len(squares) if freedom else np.nan
    return float(np.mean(values)), float(half)


def _reach(start: Array, *, closed: bool) -> float:
    """Return the largest distance of a start from its first position as a share of the curve, the shorter way round."""
    off = np.abs(start - start[0])
    return float(np.max(np.minimum(off, 1 - off) if closed else off))
