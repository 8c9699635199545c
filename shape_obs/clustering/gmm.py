"""A mixture of Gaussians, scikit-learn's; the centres are the means.

References:
    A. P. Dempster, N. M. Laird, D. B. Rubin, "Maximum Likelihood from Incomplete Data via the EM Algorithm", Journal of
    the Royal Statistical Society B 39, 1977.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shape_obs.clustering.base import Centres, Clusterer, fit_quietly, rms_spread
from shape_obs.geometry.observed import Samples
from shape_obs.geometry.topology import Topology


@dataclass(frozen=True)
class GaussianMixture(Clusterer, kind="gmm"):
    """Full covariances, scikit-learn's own settings: started by K-means, until a step gains less than 1e-3.

    The samples are scaled to unit spread before, so that pixels and metres are regularised alike.

    Args:
        max_iter: Steps of expectation and maximisation at most.
    """

    max_iter: int = 100

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.max_iter < 1:
            raise ValueError(f"gmm: max_iter must be >= 1, got {self.max_iter}.")

    def centres(self, samples: Samples, layout: Topology, seed: int) -> Centres:
        """Return the means."""
        from sklearn.mixture import GaussianMixture as Estimator

        middle, scale = samples.points.mean(axis=0), rms_spread(samples.points)
        estimator = Estimator(layout.size, max_iter=self.max_iter, random_state=seed)
        fit_quietly(estimator, (samples.points - middle) / scale)
        places = np.asarray(estimator.means_, dtype=np.float64) * scale + middle
        return Centres(places, int(estimator.n_iter_), bool(estimator.converged_))
