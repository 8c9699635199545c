"""What all clusterers share: a spec with a kind, and the centres that one finds."""

from __future__ import annotations

import warnings
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.observed import Samples
from shape_obs.geometry.topology import Topology
from shape_obs.spec import Spec
from shape_obs.utils.threads import single_thread


class Centres(NamedTuple):
    """What a clusterer finds.

    Args:
        places: ``(N, D)`` the centres, in no particular order.
        steps: Iterations that it took; of a mixture those of its start left out.
        settled: It stopped because nothing moved any more, not because its iterations were used up.
    """

    places: npt.NDArray[np.float64]
    steps: int
    settled: bool


_CLUSTERERS = {kind: f"shape_obs.clustering.{kind}" for kind in ("kmeans", "gmm", "fcm", "kohonen")}


@dataclass(frozen=True)
class Clustering(Spec, family="clustering", modules=_CLUSTERERS):
    """Where the N points of a shape come from."""


@dataclass(frozen=True)
class SelfOrganisingMap(Clustering, kind="som"):
    """The map that the form is fitted with, see ``shape_obs.clustering.som``; points are spread evenly on the form."""


@dataclass(frozen=True)
class Clusterer(Clustering):
    """A clusterer without an order: its centres are the points, sorted along the form."""

    @abstractmethod
    def centres(self, samples: Samples, layout: Topology, seed: int) -> Centres:
        """Cluster the samples, from nothing but them: equal arguments give equal centres.

        Args:
            samples: M >= N points of any dimension; each counts once, regardless of its weight.
            layout: How the N points of the shape are connected; ``layout.size`` = N.
            seed: Of what is drawn at random.
        """


def fit_quietly(estimator: Any, points: npt.NDArray[np.float64]) -> Any:
    """Fit an estimator of scikit-learn to ``(M, D)`` points in one thread; ``Centres`` show whether it settled."""
    from sklearn.exceptions import ConvergenceWarning

    with single_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return estimator.fit(points)


def rms_spread(points: npt.NDArray[np.float64]) -> float:
    """Return the root mean square distance of ``(M, D)`` points from their mean, a length for tolerances."""
    return max(float(np.sqrt(points.var(axis=0).sum())), 1e-300)
