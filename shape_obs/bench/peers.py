"""Other ways from a mask to N points, called as their users would; a peer that is not installed is skipped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.synthetic.streams import Name, Scene, Work
from shape_obs.bench.tangle_claims import longest_path
from shape_obs.geometry.samples import Samples

Array = npt.NDArray[np.float64]
Run = Callable[[Scene], Array]

MINISOM_ITERATIONS: Final = 1000
OWN_ITERATIONS: Final = 3
_ALL: Final[tuple[Name, ...]] = ("rope", "contour", "cloth")


@dataclass(frozen=True)
class Peer:
    """A method to compare the detector with.

    Args:
        name: Its name in the tables.
        module: The module that must be importable.
        package: The package to install for it.
        make: Takes the work, the module and a seed; returns a function of a scene that returns (N, 2) points.
        works: The works for which it can be used.
        slow: Whether it runs only on a few frames.
    """

    name: str
    module: str
    package: str
    make: Callable[[Work, Any, int], Run]
    works: tuple[Name, ...] = _ALL
    slow: bool = False

    def load(self) -> Any:
        """Return the module, or None if it is not installed."""
        try:
            return import_module(self.module)
        except ImportError:
            return None


def _minisom(work: Work, module: Any, seed: int) -> Run:
    def run(scene: Scene) -> Array:
        som = module.MiniSom(*work.grid, 2, random_seed=seed)
        som.random_weights_init(scene.pixels)
        som.train_random(scene.pixels, MINISOM_ITERATIONS)
        return som.get_weights().reshape(-1, 2)

    return run


def _kmeans(n_init: int) -> Callable[[Work, Any, int], Run]:
    return lambda work, module, seed: _centres(lambda scene: module.KMeans(work.n, n_init=n_init, random_state=seed))


def _kmeans_from_ours(work: Work, module: Any, seed: int) -> Run:
    return _centres(lambda scene: module.KMeans(work.n, init=scene.ours, n_init=1, max_iter=OWN_ITERATIONS))


def _minibatch(work: Work, module: Any, seed: int) -> Run:
    return _centres(lambda scene: module.MiniBatchKMeans(work.n, n_init=1, random_state=seed))


def _centres(estimator: Callable[[Scene], Any]) -> Run:
    """Return the cluster centres of an estimator of scikit-learn."""
    return lambda scene: estimator(scene).fit(scene.pixels).cluster_centers_


def _mixture(work: Work, module: Any, seed: int) -> Run:
    return lambda scene: module.GaussianMixture(work.n, random_state=seed).fit(scene.pixels).means_


def _fuzzy(work: Work, module: Any, seed: int) -> Run:
    def run(scene: Scene) -> Array:
        samples = Samples(scene.pixels, np.ones(len(scene.pixels)), 1.0)
        return module.FuzzyCMeans().centres(samples, work.configuration.layout, seed).places

    return run


def _skfuzzy(work: Work, module: Any, seed: int) -> Run:
    return lambda scene: module.cmeans(scene.pixels.T, work.n, 2.0, error=5e-3, maxiter=1000, seed=seed)[0]


def _skeleton(work: Work, module: Any, seed: int) -> Run:
    return lambda scene: spread(longest_path(np.asarray(module.skeletonize(scene.mask > 0))), work.n)


def _contour(work: Work, module: Any, seed: int) -> Run:
    def run(scene: Scene) -> Array:
        contours, _ = cv2.findContours(scene.mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        outline = np.asarray(max(contours, key=cv2.contourArea), dtype=np.float64).reshape(-1, 2)
        return spread(outline, work.n, closed=True)

    return run


PEERS: Final = (
    Peer("minisom, 1000 iterations", "minisom", "minisom", _minisom),
    Peer("K-means, n_init 1", "sklearn.cluster", "scikit-learn", _kmeans(1)),
    Peer("K-means, n_init 10", "sklearn.cluster", "scikit-learn", _kmeans(10), slow=True),
    Peer("K-means from our points, 3 iterations", "sklearn.cluster", "scikit-learn", _kmeans_from_ours),
    Peer("mini-batch K-means", "sklearn.cluster", "scikit-learn", _minibatch),
    Peer("Gaussian mixture", "sklearn.mixture", "scikit-learn", _mixture, slow=True),
    Peer("fuzzy C-means (shape_obs)", "shape_obs.clustering.fcm", "shape-obs", _fuzzy, slow=True),
    Peer("fuzzy C-means (scikit-fuzzy)", "skfuzzy", "scikit-fuzzy", _skfuzzy, slow=True),
    Peer("skeletonize, longest path", "skimage.morphology", "scikit-image", _skeleton, ("rope",)),
    Peer("findContours, resampled", "cv2", "opencv-python-headless", _contour, ("contour",)),
)


def spread(path: Array, n: int, *, closed: bool = False) -> Array:
    """Return (n, 2) points at equal arc length along a (P, 2) path, in the middle of equal pieces, or around it."""
    if closed:
        path = np.concatenate([path, path[:1]])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = (np.arange(n) + (0.0 if closed else 0.5)) / n * arc[-1]
    return np.stack([np.interp(at, arc, path[:, d]) for d in range(2)], axis=1)
