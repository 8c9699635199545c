"""Other ways from a mask to N points, called as their users would; a peer that is not installed is skipped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.bench.synthetic.streams import Name, Scene, Work, outline_pixels
from shape_obs.bench.tangle_claims import longest_path
from shape_obs.geometry.samples import Samples

Array = npt.NDArray[np.float64]

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
        run: Takes the work, the module, a seed and a scene; returns (N, 2) points.
        works: The works for which it can be used.
        slow: Whether it runs only on a few frames.
    """

    name: str
    module: str
    package: str
    run: Callable[[Work, Any, int, Scene], Array]
    works: tuple[Name, ...] = _ALL
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
    """Return (n, 2) points at equal arc length along a (P, 2) path, in the middle of equal pieces, or around it."""
    if closed:
        path = np.concatenate([path, path[:1]])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = (np.arange(n) + (0.0 if closed else 0.5)) / n * arc[-1]
    return np.stack([np.interp(at, arc, path[:, d]) for d in range(2)], axis=1)
