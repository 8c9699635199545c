"""Compare the detector with other ways to the same points: times, ratios, quality, and their targets."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from shape_obs import metrics
from shape_obs.bench import Clock
from shape_obs.bench.interleaved_timing import Method, interleaved_timing
from shape_obs.bench.peers import PEERS
from shape_obs.bench.synthetic.streams import Name, Scene, Work, work
from shape_obs.bench.tables import Row, at_least, at_most, mean
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.polyline import nearest_on
from shape_obs.geometry.topology import Topology
from shape_obs.utils.threads import one_thread

WARM_UP: Final = 5  # frames that are not counted
WARM, COLD = "shape_obs, warm", "shape_obs, cold"
KMEANS: Final = "K-means, n_init 1"
KMEANS_10: Final = "K-means, n_init 10"
MIXTURE: Final = "Gaussian mixture"
# (work, our start, the peer) -> how many times faster the detector has to be.
TARGETS: Final[tuple[tuple[Name, str, str, int], ...]] = (
    ("rope", WARM, "minisom, 1000 iterations", 250),
    ("rope", WARM, KMEANS, 120),
    ("rope", WARM, "K-means from our points, 3 iterations", 30),
    ("rope", COLD, KMEANS, 20),
    ("cloth", WARM, KMEANS, 1000),
    ("contour", WARM, KMEANS, 15),
)
_EXACT: Final = 10_000  # up to this number of pixels the silhouette counts all of them
_SAMPLED: Final = 2_000  # beyond, it counts so many of them, each against all
_LOOKED_AT: Final = 5  # frames for quality if no slow method sets the number
_SILHOUETTE_SLACK: Final = 0.006
_SPREAD_SHARE: Final[dict[Name, float]] = {"rope": 0.995, "contour": 0.995, "cloth": 0.96}


class Quality(NamedTuple):
    """How well N points represent the pixels of one frame.

    Args:
        silhouette: Mean silhouette, -1 to 1.
        calinski_harabasz: Calinski-Harabasz score over all pixels.
        spacing: Standard deviation of the gaps over their mean: between successive points along the known line; on a
            cloth from each point to the nearest other one.
    """

    silhouette: float
    calinski_harabasz: float
    spacing: float


def point_quality(scene: Scene, points: npt.NDArray[np.float64], layout: Topology) -> Quality:
    """Measure N points in any order; each pixel belongs to the nearest point."""
    pixels, labels = scene.pixels, metrics.nearest(scene.pixels, points)
    if scene.curve is None:
        gaps = np.asarray(KDTree(points).query(points, k=2)[0])[:, 1]
        spacing = float(gaps.std() / gaps.mean())
    else:
        along, _ = nearest_on(scene.curve, points)
        spacing = metrics.spacing_cv(points[np.argsort(along, kind="stable")], layout)
    sample = None if len(pixels) <= _EXACT else _SAMPLED
    silhouette = metrics.silhouette(pixels, labels, sample=sample)
    return Quality(silhouette, metrics.calinski_harabasz(pixels, labels), spacing)


@dataclass
class Score:
    """The results of one method.

    Args:
        milliseconds: The time of each counted frame, by its number.
        quality: The quality of its points on the frames on which every method ran.
    """

    milliseconds: dict[int, float] = field(default_factory=dict)
    quality: list[Quality] = field(default_factory=list)

    @property
    def median(self) -> float:
        """The median time in milliseconds."""
        return float(np.median([*self.milliseconds.values()]))

    def mean(self, measure: str) -> float:
        """Return the mean of a measure of quality."""
        return mean(getattr(quality, measure) for quality in self.quality)

    def times(self, other: Score) -> float:
        """Return how many times slower this method is than another: the ratio of medians over their common frames."""
        both = self.milliseconds.keys() & other.milliseconds.keys()
        mine, theirs = (np.median([score.milliseconds[i] for i in both]) for score in (self, other))
        return float(mine / theirs)


@dataclass(frozen=True)
class Result:
    """The results of one work.

    Args:
        work: The work with its frames.
        scores: Method -> results, the detector first.
        refused: Number of detections without a shape, warm and cold together.
    """

    work: Work
    scores: Mapping[str, Score]
    refused: int

    def to_dict(self) -> dict[str, Any]:
        """Return the results as JSON-able values, with one row for each method."""
        return {
            "points": self.work.n,
            "samples": self.work.samples,
            "frames": len(self.work.scenes) - WARM_UP,
            "refused": self.refused,
            "rows": [
                {
                    "method": name,
                    "frames": len(score.milliseconds),
                    "median_ms": score.median,
                    "over_ours": score.times(self.scores[WARM]),
                    "sc": score.mean("silhouette"),
                    "ch": score.mean("calinski_harabasz"),
                    "spacing_cv": score.mean("spacing"),
                }
                for name, score in self.scores.items()
            ],
        }


def missing() -> dict[str, str]:
    """Return the package to install for every peer that is not installed, by module."""
    return {peer.module.partition(".")[0]: peer.package for peer in PEERS if peer.load() is None}


def run_work(
    name: Name,
    frames: int,
    slow_frames: int,
    seed: int,
    clock: Clock = "wall",
    burst: int = 1,
    tick: Callable[[], Any] = lambda: None,
) -> Result:
    """Run the detector and every installed peer on one work.

    Args:
        name: The work.
        frames: Number of counted frames.
        slow_frames: Frames on which slow methods run and the quality is measured; 0 leaves slow methods out.
        seed: Seed of the motion, and of the methods that draw at random.
        clock: The clock.
        burst: Frames in a turn.
        tick: Called after each frame.
    """
    task = work(name, frames + WARM_UP, seed)
    counted = range(WARM_UP, len(task.scenes))
    chosen = np.linspace(0, len(counted) - 1, min(slow_frames or _LOOKED_AT, len(counted))).astype(int)
    looked_at = {counted[i] for i in chosen}
    refused: list[str] = []
    methods = [_detector(task, start, refused) for start in (WARM, COLD)]
    for peer in PEERS:
        module = peer.load() if name in peer.works and (slow_frames or not peer.slow) else None
        if module is not None:
            some = looked_at if peer.slow else None
            methods.append(Method(peer.name, peer.make(task, module, seed), touch=_touch, frames=some))
    scores, last = {method.name: Score() for method in methods}, 0
    with one_thread():
        for turn in interleaved_timing(task.scenes, methods, clock, burst=burst):
            if turn.frame > last:
                tick()
            last = max(last, turn.frame)
            if turn.frame >= WARM_UP:
                scores[turn.name].milliseconds[turn.frame] = turn.milliseconds
            if turn.frame in looked_at:
                found = point_quality(task.scenes[turn.frame], turn.result, task.configuration.layout)
                scores[turn.name].quality.append(found)
    return Result(task, scores, len(refused))


def _touch(scene: Scene) -> None:
    cv2.countNonZero(scene.mask)
    scene.pixels.sum()


def _detector(task: Work, start: str, refused: list[str]) -> Method[Scene]:
    detector = ShapeDetector([task.configuration])

    def run(scene: Scene) -> npt.NDArray[np.float32]:
        shape = detector.detect_mask(scene.mask).shapes[0]
        if shape.reason:
            refused.append(shape.reason)
        return shape.pixels

    return Method(start, run, detector.reset if start == COLD else lambda: None, _touch)


def targets(results: Mapping[Name, Result]) -> list[Row]:
    """Compare times and quality with their targets."""
    rows = []
    for name, start, peer, bound in TARGETS:
        scores = results[name].scores if name in results else {}
        ratio = scores[peer].times(scores[start]) if peer in scores else None
        rows.append(at_least(f"{name}, {start.partition(', ')[2]}: times faster than {peer}", bound, ratio))
    for name, result in results.items():
        rows += _quality_targets(name, result.scores)
    return rows


def _quality_targets(name: Name, scores: Mapping[str, Score]) -> list[Row]:
    mine = scores[WARM]

    def relative(peer: str, share: float) -> Row:
        own, other = mine.mean("calinski_harabasz"), scores.get(peer)
        seen = None if other is None else own / other.mean("calinski_harabasz")
        return at_least(f"{name}: Calinski-Harabasz relative to {peer}", share, seen)

    rows = [relative(KMEANS_10, _SPREAD_SHARE[name])]
    if name != "cloth":
        rows.append(relative(MIXTURE, 1.0))
        best = max(score.mean("silhouette") for score in scores.values())
        lost = best - mine.mean("silhouette")
        rows.append(at_most(f"{name}: silhouette below the best", _SILHOUETTE_SLACK, lost, ""))
        theirs = f" where K-means has {100 * scores[KMEANS].mean('spacing'):.0f} %" if KMEANS in scores else ""
        rows.append(at_most(f"{name}: spacing CV{theirs}", 1.0, 100 * mine.mean("spacing"), " %"))
    return rows
