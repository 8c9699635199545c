"""Fuzzy C-means: every sample belongs to every cluster, the more the nearer it is.

References:
    J. C. Bezdek, "Pattern Recognition with Fuzzy Objective Function Algorithms", Plenum Press, 1981.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from shape_obs.clustering.base import Centres, Clusterer, rms_spread
from shape_obs.geometry.observed import Samples
from shape_obs.geometry.topology import Topology

_TINY: Final = 1e-18  # squared distance, at least, of a spread of 1: a sample on a centre belongs to it alone


@dataclass(frozen=True)
class FuzzyCMeans(Clusterer, kind="fcm"):
    """Fuzzy C-means with the fuzzifier m = 2, started from N samples drawn at random.

    With d the distance of sample i to centre k: u_ik = d_ik^-2 / sum_k d_ik^-2, and centre k is the mean of the
    samples weighed by u_ik^2, in turn.

    Args:
        tolerance: It stops when no centre moves by more than this share of the samples' rms spread.
        max_iter: Iterations at most.
    """

    tolerance: float = 1e-3
    max_iter: int = 100

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.max_iter < 1 or not self.tolerance > 0:
            raise ValueError(f"fcm: expected tolerance > 0 and max_iter >= 1, got {self.tolerance}, {self.max_iter}.")

    def centres(self, samples: Samples, layout: Topology, seed: int) -> Centres:
        """Return the centres."""
        middle, scale = samples.points.mean(axis=0), rms_spread(samples.points)
        points = (samples.points - middle) / scale
        square = np.sum(points**2, axis=1)
        nodes = points[np.random.default_rng(seed).choice(len(points), layout.size, replace=False)]
        # One row a centre: sums over samples then run along the memory.
        share = np.empty((len(nodes), len(points)))
        moved, step = np.inf, 0
        while moved > self.tolerance and step < self.max_iter:
            np.matmul(nodes * -2.0, points.T, out=share)
            share += square
            share += np.sum(nodes**2, axis=1)[:, None]
            np.maximum(share, _TINY, out=share)
            np.reciprocal(share, out=share)
            share /= share.sum(axis=0)
            np.square(share, out=share)
            before, nodes = nodes, (share @ points) / share.sum(axis=1)[:, None]
            moved = float(np.sqrt(np.max(np.sum((nodes - before) ** 2, axis=1))))
            step += 1
        return Centres(nodes * scale + middle, step, moved <= self.tolerance)
