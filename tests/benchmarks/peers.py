"""Compare the detector with other ways from a mask to N points: times, ratios, quality, and their targets.

The others are called as their users would; a peer that is not installed is skipped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any, Final, get_args

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from shape_obs import metrics
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.observed import Samples
from shape_obs.geometry.polyline import nearest_on
from shape_obs.geometry.topology import Topology
from tests.benchmarks.interleaved_timing import Method, Timing, Turn, median_ms, time_methods
from tests.benchmarks.scenes.streams import Name, Scene, Work, outline_pixels, work
from tests.benchmarks.tables import Row, at_least, at_most
from tests.benchmarks.tangle_claims import longest_path

Array = npt.NDArray[np.float64]

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
MINISOM_ITERATIONS: Final = 1000
OWN_ITERATIONS: Final = 3


@dataclass(frozen=True)
class Peer:
    """A method to compare the detector with.

    Args:
        name: Its name in the tables.
        module: The module that must be importable.
        package: The package to install for it.
        run: Takes the work, the module, a seed and a scene; returns ``(N, 2)`` points.
        works: The works for which it can be used.
        slow: Whether it runs only on a few frames.
    """

    name: str
    module: str
    package: str
    run: Callable[[Work, Any, int, Scene], Array]
    works: tuple[Name, ...] = get_args(Name)
    slow: bool = False

    def load(self) -> Any:
        """Return the module, or None if it is not installed."""
        try:
            return import_module(self.module)
        except ImportError:
            return None


def _minisom(work: Work, module: Any, seed: int, scene: Scene) -> Array:
    som = module.MiniSom(*work.grid, 2, random_seed=seed)
    som.random_weights_init(scene.pixels)
    som.train_random(scene.pixels, MINISOM_ITERATIONS)
    return som.get_weights().reshape(-1, 2)


def _kmeans(n_init: int, work: Work, module: Any, seed: int, scene: Scene) -> Array:
    return _centres(module.KMeans(work.n, n_init=n_init, random_state=seed), scene)


def _kmeans_from_ours(work: Work, module: Any, seed: int, scene: Scene) -> Array:
    return _centres(module.KMeans(work.n, init=scene.ours, n_init=1, max_iter=OWN_ITERATIONS), scene)


def _minibatch(work: Work, module: Any, seed: int, scene: Scene) -> Array:
    return _centres(module.MiniBatchKMeans(work.n, n_init=1, random_state=seed), scene)


def _centres(estimator: Any, scene: Scene) -> Array:
    """Return the cluster centres of an estimator of scikit-learn."""
    return estimator.fit(scene.pixels).cluster_centers_


def _mixture(work: Work, module: Any, seed: int, scene: Scene) -> Array:
    return module.GaussianMixture(work.n, random_state=seed).fit(scene.pixels).means_


def _fuzzy(work: Work, module: Any, seed: int, scene: Scene) -> Array:
    samples = Samples(scene.pixels, np.ones(len(scene.pixels)), 1.0)
    return module.FuzzyCMeans().centres(samples, work.configuration.layout, seed).places


def _skfuzzy(work: Work, module: Any, seed: int, scene: Scene) -> Array:
    return module.cmeans(scene.pixels.T, work.n, 2.0, error=5e-3, maxiter=1000, seed=seed)[0]


def _skeleton(work: Work, module: Any, seed: int, scene: Scene) -> Array:
    return spread(longest_path(np.asarray(module.skeletonize(scene.mask > 0))), work.n)


def _contour(work: Work, module: Any, seed: int, scene: Scene) -> Array:
    return spread(outline_pixels(scene.mask), work.n, closed=True)


PEERS: Final = (
    Peer("minisom, 1000 iterations", "minisom", "minisom", _minisom),
    Peer("K-means, n_init 1", "sklearn.cluster", "scikit-learn", partial(_kmeans, 1)),
    Peer("K-means, n_init 10", "sklearn.cluster", "scikit-learn", partial(_kmeans, 10), slow=True),
    Peer("K-means from our points, 3 iterations", "sklearn.cluster", "scikit-learn", _kmeans_from_ours),
    Peer("mini-batch K-means", "sklearn.cluster", "scikit-learn", _minibatch),
    Peer("Gaussian mixture", "sklearn.mixture", "scikit-learn", _mixture, slow=True),
    Peer("fuzzy C-means (shape_obs)", "shape_obs.clustering.fcm", "shape-obs", _fuzzy, slow=True),
    Peer("fuzzy C-means (scikit-fuzzy)", "skfuzzy", "scikit-fuzzy", _skfuzzy, slow=True),
    Peer("skeletonize, longest path", "skimage.morphology", "scikit-image", _skeleton, ("rope",)),
    Peer("findContours, resampled", "cv2", "opencv-python-headless", _contour, ("contour",)),
)


def spread(path: Array, n: int, *, closed: bool = False) -> Array:
    """Return (n, 2) points at equal arc length along a ``(P, 2)`` path, in the middle of equal pieces, or around it."""
    if closed:
        path = np.concatenate([path, path[:1]])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = (np.arange(n) + (0.0 if closed else 0.5)) / n * arc[-1]
    return np.stack([np.interp(at, arc, path[:, d]) for d in range(2)], axis=1)


def point_quality(scene: Scene, points: npt.NDArray[np.float64], layout: Topology) -> tuple[float, float, float]:
    """Measure how well N points, in any order, represent the pixels of one frame; each belongs to the nearest point.

    Returns:
        The mean silhouette, -1 to 1; the Calinski-Harabasz score over all pixels; standard deviation over mean of the
        gaps between successive points along the known line, on a cloth from each point to the nearest other one.
    """
    pixels, labels = scene.pixels, metrics.nearest(scene.pixels, points)
    if scene.curve is None:
        gaps = np.asarray(KDTree(points).query(points, k=2)[0])[:, 1]
        spacing = float(gaps.std() / gaps.mean())
    else:
        along, _ = nearest_on(scene.curve, points)
        spacing = metrics.spacing_cv(points[np.argsort(along, kind="stable")], layout)
    sample = None if len(pixels) <= _EXACT else _SAMPLED
    silhouette = metrics.silhouette(pixels, labels, sample=sample)
    return silhouette, metrics.calinski_harabasz(pixels, labels), spacing


def times_slower(turns: Sequence[Turn], others: Sequence[Turn]) -> float:
    """Return how many times slower one method is than another: the ratio of medians over their common frames."""
    both = {turn.frame for turn in turns} & {turn.frame for turn in others}
    one, other = (median_ms(turn for turn in some if turn.frame in both) for some in (turns, others))
    return one / other


def missing() -> dict[str, str]:
    """Return the package to install for every peer that is not installed, by module."""
    return {peer.module.partition(".")[0]: peer.package for peer in PEERS if peer.load() is None}


def run_work(name: Name, frames: int, slow_frames: int, timing: Timing) -> Row:
    """Run the detector and every installed peer on one work.

    Args:
        name: The work.
        frames: Number of counted frames.
        slow_frames: Frames on which slow methods run and the quality is measured; 0 leaves slow methods out.
        timing: Clock and length of a turn; seed of the motion, and of the methods that draw at random.

    Returns:
        ``turns``: method -> its turns, the detector first; ``summary``: the results as JSON-able values, with one row
        for each method.
    """
    task = work(name, frames + WARM_UP, timing.seed)
    counted = range(WARM_UP, len(task.scenes))
    chosen = np.linspace(0, len(counted) - 1, min(slow_frames or _LOOKED_AT, len(counted))).astype(int)
    looked_at = {counted[i] for i in chosen}
    refused: list[str] = []
    methods = [_detector(task, start, refused) for start in (WARM, COLD)]
    for peer in PEERS:
        module = peer.load() if name in peer.works and (slow_frames or not peer.slow) else None
        if module is not None:
            some = looked_at if peer.slow else None
            methods.append(Method(peer.name, partial(peer.run, task, module, timing.seed), touch=_touch, frames=some))
    found = time_methods(task.scenes, methods, timing, warm_up=WARM_UP)
    rows = []
    for method, turns in found.items():
        seen = [(task.scenes[turn.frame], turn.result) for turn in turns if turn.frame in looked_at]
        qualities = [point_quality(scene, points, task.configuration.layout) for scene, points in seen]
        sc, ch, spacing = np.mean(qualities, axis=0).tolist()
        times = {"median_ms": median_ms(turns), "over_ours": times_slower(turns, found[WARM])}
        rows.append(Row(method=method, frames=len(turns), **times, sc=sc, ch=ch, spacing_cv=spacing))
    return Row(
        turns=found, summary=Row(points=task.n, samples=task.samples, frames=frames, refused=len(refused), rows=rows)
    )


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


def targets(results: Mapping[Name, Row]) -> list[Row]:
    """Compare times and quality with their targets."""
    rows = []
    for name, start, peer, bound in TARGETS:
        turns = results[name].turns if name in results else {}
        ratio = times_slower(turns[peer], turns[start]) if peer in turns else None
        rows.append(at_least(f"{name}, {start.partition(', ')[2]}: times faster than {peer}", bound, ratio))
    for name, result in results.items():
        rows += _quality_targets(name, {row.method: row for row in result.summary.rows})
    return rows


def _quality_targets(name: Name, rows: Mapping[str, Row]) -> list[Row]:
    mine = rows[WARM]

    def relative(peer: str, share: float) -> Row:
        seen = mine.ch / rows[peer].ch if peer in rows else None
        return at_least(f"{name}: Calinski-Harabasz relative to {peer}", share, seen)

    compared = [relative(KMEANS_10, _SPREAD_SHARE[name])]
    if name != "cloth":
        compared.append(relative(MIXTURE, 1.0))
        lost = max(row.sc for row in rows.values()) - mine.sc
        compared.append(at_most(f"{name}: silhouette below the best", _SILHOUETTE_SLACK, lost, ""))
        theirs = f" where K-means has {100 * rows[KMEANS].spacing_cv:.0f} %" if KMEANS in rows else ""
        compared.append(at_most(f"{name}: spacing CV{theirs}", 1.0, 100 * mine.spacing_cv, " %"))
    return compared
