"""K-means, scikit-learn's.

References:
    S. Lloyd, "Least Squares Quantization in PCM", IEEE Transactions on Information Theory 28, 1982.
    D. Arthur and S. Vassilvitskii, "k-means++: The Advantages of Careful Seeding", SODA 2007: the start.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from shape_obs.clustering.base import Centres, Clusterer, fit_quietly
from shape_obs.geometry.observed import Samples
from shape_obs.geometry.topology import Topology


@dataclass(frozen=True)
class KMeans(Clusterer, kind="kmeans"):
    """K-means with scikit-learn's own settings: k-means++, until the centres move by less than 1e-4 of the variance.

    Args:
        n_init: Starts, of which the best is kept.
        max_iter: Iterations at most, for each start.
    """

    n_init: int = 1
    max_iter: int = 300

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.n_init < 1 or self.max_iter < 1:
            raise ValueError(f"kmeans: n_init and max_iter must be >= 1, got {self.n_init} and {self.max_iter}.")

    def centres(self, samples: Samples, layout: Topology, seed: int) -> Centres:
        """Return the centres."""
        from sklearn.cluster import KMeans as Estimator

        n_init: Any = self.n_init  # scikit-learn's annotation allows "auto" alone
        estimator = Estimator(layout.size, n_init=n_init, max_iter=self.max_iter, random_state=seed)
        fit_quietly(estimator, samples.points)  # with fewer places than clusters, some centres coincide
        places = np.asarray(estimator.cluster_centers_, dtype=np.float64)
        return Centres(places, int(estimator.n_iter_), bool(estimator.n_iter_ < self.max_iter))
