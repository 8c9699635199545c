"""Methods in turn on the same work: what each takes, and how good its points are.

The detector beside other ways to the same points: times, ratios and quality, and what is asked of them.

How well N points in any order stand for a mask: silhouette, Calinski-Harabasz and how evenly they are spread.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from shape_obs import metrics
from shape_obs.bench.backends import LABELS, Backend, backends, ours
from shape_obs.bench.interleaved_timing import Clock, Entrant, turns
from shape_obs.bench.peers import PEERS
from shape_obs.bench.synthetic.streams import Name, Scene, Work, work
from shape_obs.bench.tables import at_least, at_most
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.polyline import nearest_on
from shape_obs.geometry.topology import Topology
from shape_obs.utils.threads import one_thread

WARM_UP: Final = 5  # frames that are not counted: imports, compilation, the first cold start


@dataclass
class Score:
    """What one method did.

    Args:
        milliseconds: Frame -> time.
        quality: Of its points, on the frames on which every method ran.
    """

    milliseconds: dict[int, float] = field(default_factory=dict)
    quality: list[Quality] = field(default_factory=list)

    @property
    def median(self) -> float:
        """Milliseconds."""
        return float(np.median([*self.milliseconds.values()]))

    def mean(self, measure: str) -> float:
        """Of a measure over the frames on which quality was looked at."""
        return float(np.mean([getattr(quality, measure) for quality in self.quality]))

    def times(self, other: Score) -> float:
        """How many times slower than another method: the ratio of the medians over the frames of both."""
        both = self.milliseconds.keys() & other.milliseconds.keys()
        mine, theirs = (np.median([score.milliseconds[i] for i in both]) for score in (self, other))
        return float(mine / theirs)


def contest(
    work: Work,
    entrants: Sequence[Entrant[Scene]],
    slow: set[str],
    few: int,
    clock: Clock = "wall",
    burst: int = 1,
    tick: Callable[[], Any] = lambda: None,
) -> dict[str, Score]:
    """Let every entrant run on every frame.

    Args:
        work: The frames; the first ``WARM_UP`` of them are not counted.
        entrants: Who runs.
        slow: Who runs on few frames only.
        few: On how many; on these the quality of all is measured.
        clock: What counts the time.
        burst: Frames in a turn.
        tick: Called after each frame.

    Returns:
        Name -> score.
    """
    scores = {entrant.name: Score() for entrant in entrants}
    counted = range(WARM_UP, len(work.scenes))
    chosen = {counted[i] for i in np.linspace(0, len(counted) - 1, min(few, len(counted))).astype(int)}
    entered = [replace(each, touch=_touch, frames=chosen if each.name in slow else None) for each in entrants]
    last = 0
    for turn in turns(work.scenes, entered, clock, burst=burst):
        if turn.frame > last:
            tick()
        last = max(last, turn.frame)
        if turn.frame < WARM_UP:
            continue
        scores[turn.name].milliseconds[turn.frame] = turn.milliseconds
        if turn.frame in chosen:
            found = point_quality(work.scenes[turn.frame], turn.result, work.configuration.layout)
            scores[turn.name].quality.append(found)
    return scores


def _touch(scene: Scene) -> None:
    cv2.countNonZero(scene.mask)
    scene.pixels.sum()


Row = dict[str, Any]


MINISOM: Final = "minisom, 1000 iterations"

KMEANS: Final = "K-means, n_init 1"

KMEANS_10: Final = "K-means, n_init 10"

KMEANS_OURS: Final = "K-means from our points, 3 iterations"

MIXTURE: Final = "Gaussian mixture"


# (work, how we start, beside whom) -> times faster with NumPy, with Numba.
ASKED: Final[tuple[tuple[Name, str, str, int, int], ...]] = (
    ("rope", "warm", MINISOM, 50, 250),
    ("rope", "warm", KMEANS, 25, 120),
    ("rope", "warm", KMEANS_OURS, 6, 30),
    ("rope", "cold", KMEANS, 10, 20),
    ("cloth", "warm", KMEANS, 150, 1000),
    ("contour", "warm", KMEANS, 8, 15),
)

_LOOKED_AT: Final = 5  # frames for quality where no slow method says how many

_SILHOUETTE_SLACK: Final = 0.006

_SPREAD_SHARE: Final[dict[Name, float]] = {"rope": 0.995, "contour": 0.995, "cloth": 0.96}


@dataclass(frozen=True)
class Result:
    """Of one work.

    Args:
        work: Which, with its frames.
        scores: Method -> what it did, the detector first.
        refused: Frames in which the detector found nothing, all its entrants together.
    """

    work: Work
    scores: Mapping[str, Score]
    refused: int

    @property
    def frames(self) -> int:
        """How many are counted."""
        return len(self.work.scenes) - WARM_UP

    def rows(self) -> list[Row]:
        """One row a method."""
        rows = []
        for name, score in self.scores.items():
            row: Row = {"method": name, "frames": len(score.milliseconds), "median_ms": score.median}
            for backend in LABELS:
                mine = self.scores.get(ours(backend, "warm"))
                row[f"over_{backend}"] = None if mine is None else score.times(mine)
            row |= {"sc": score.mean("silhouette"), "ch": score.mean("calinski_harabasz")}
            rows.append(row | {"spacing_cv": score.mean("spacing")})
        return rows


def missing() -> dict[str, str]:
    """Module -> what to install, for every peer that is not here; and Numba."""
    away = {} if "numba" in backends() else {"numba": "shape-obs[fast]"}
    return away | {peer.module.partition(".")[0]: peer.package for peer in PEERS if peer.load() is None}


def run_work(
    name: Name,
    frames: int,
    slow_frames: int,
    seed: int,
    clock: Clock = "wall",
    burst: int = 1,
    tick: Callable[[], Any] = lambda: None,
) -> Result:
    """Let the detector and every installed peer run on one work.

    Args:
        name: Which work.
        frames: How many are counted.
        slow_frames: On how many of them slow methods run; 0 leaves these out. Quality is looked at on as many.
        seed: Of the motion, and of the methods that draw.
        clock: What counts the time.
        burst: Frames in a turn.
        tick: Called after each frame.
    """
    task = work(name, frames + WARM_UP, seed)
    refused: list[str] = []
    entrants = [_detector(task, backend, start, refused) for start in ("warm", "cold") for backend in backends()]
    entered = [peer for peer in PEERS if name in peer.works and (slow_frames or not peer.slow)]
    modules = [(peer, peer.load()) for peer in entered]
    entrants += [Entrant(peer.name, peer.make(task, module, seed)) for peer, module in modules if module is not None]
    slow = {peer.name for peer in entered if peer.slow}
    with one_thread():
        scores = contest(task, entrants, slow, slow_frames or _LOOKED_AT, clock, burst, tick)
    return Result(task, scores, len(refused))


def claims(results: Mapping[Name, Result]) -> list[Row]:
    """What is asked, what was seen."""
    rows = []
    for name, start, peer, *bounds in ASKED:
        for backend, bound in zip(LABELS, bounds, strict=True):
            what = f"{name}, {start}, {LABELS[backend]}: times faster than {peer}"
            rows.append(at_least(what, bound, _ratio(results.get(name), ours(backend, start), peer)))
    for name, result in results.items():
        rows += _quality(name, result)
    return rows


def _quality(name: Name, result: Result) -> list[Row]:
    mine = result.scores[ours("numpy", "warm")]
    spread = mine.mean("calinski_harabasz")
    rows = []

    def beside(peer: str, share: float) -> Row:
        other = result.scores.get(peer)
        seen = None if other is None else spread / other.mean("calinski_harabasz")
        return at_least(f"{name}: Calinski-Harabasz beside {peer}", share, seen)

    rows.append(beside(KMEANS_10, _SPREAD_SHARE[name]))
    if name != "cloth":
        rows.append(beside(MIXTURE, 1.0))
        best = max(score.mean("silhouette") for score in result.scores.values())
        lost = best - mine.mean("silhouette")
        rows.append(at_most(f"{name}: silhouette below the best", _SILHOUETTE_SLACK, lost, ""))
        theirs = ""
        if KMEANS in result.scores:
            theirs = f" where K-means has {100 * result.scores[KMEANS].mean('spacing'):.0f} %"
        rows.append(at_most(f"{name}: spacing CV{theirs}", 1.0, 100 * mine.mean("spacing"), " %"))
    return rows


def _ratio(result: Result | None, mine: str, peer: str) -> float | None:
    if result is None or mine not in result.scores or peer not in result.scores:
        return None
    return result.scores[peer].times(result.scores[mine])


def _detector(task: Work, backend: Backend, start: str, refused: list[str]) -> Entrant[Scene]:
    """The detector as an entrant; frames without a shape are noted in ``refused``."""
    detector = ShapeDetector([task.configuration], backend=backend)

    def run(scene: Scene) -> npt.NDArray[np.float32]:
        shape = detector.detect_mask(scene.mask).shapes[0]
        if shape.reason:
            refused.append(shape.reason)
        return shape.pixels

    name = ours(backend, start)
    return Entrant(name, run, before=detector.reset) if start == "cold" else Entrant(name, run)


Array = npt.NDArray[np.float64]


EXACT: Final = 10_000  # pixels up to which every one's silhouette is computed

SAMPLED: Final = 2_000  # else that of so many, each against all pixels


class Quality(NamedTuple):
    """Of N points on one frame.

    Args:
        silhouette: -1...1, the mean over all pixels, beyond ``EXACT`` of them over ``SAMPLED``, each against all.
        calinski_harabasz: Over all pixels.
        spacing: Standard deviation of the gaps over their mean: between successive points along the known line; on a
            cloth the distance from each point to the nearest other.
    """

    silhouette: float
    calinski_harabasz: float
    spacing: float


def point_quality(scene: Scene, points: Array, layout: Topology) -> Quality:
    """The quality of one method's points; a pixel belongs to the nearest of them.

    Args:
        scene: The frame; its pixels are what is to be represented.
        points: (N,2) in any order.
        layout: How they would hang together, were they in order.
    """
    pixels, labels = scene.pixels, metrics.nearest(scene.pixels, points)
    return Quality(
        metrics.silhouette(pixels, labels, sample=None if len(pixels) <= EXACT else SAMPLED),
        metrics.calinski_harabasz(pixels, labels),
        _spacing(scene, points, layout),
    )


def _spacing(scene: Scene, points: Array, layout: Topology) -> float:
    """The coefficient of variation of the gaps, see ``Quality``."""
    if scene.curve is None:
        gaps = np.asarray(KDTree(points).query(points, k=2)[0])[:, 1]
        return float(gaps.std() / gaps.mean())
    place, _ = nearest_on(scene.curve, points)
    return metrics.spacing_cv(points[np.argsort(place, kind="stable")], layout)
