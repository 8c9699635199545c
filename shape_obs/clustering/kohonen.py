"""The self-organising map as it was first written down: one sample a step, from a random start.

It is here for comparison. What a shape is fitted with by default is the batch map of ``shape_obs.clustering.som``.

References:
    T. Kohonen, "Self-organized formation of topologically correct feature maps", Biological Cybernetics 43, 1982, and
    "Self-Organizing Maps", 3rd edition, Springer, 2001, chapter 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shape_obs.clustering.base import Centres, Clusterer
from shape_obs.geometry.observed import Samples
from shape_obs.geometry.topology import Topology


@dataclass(frozen=True)
class Kohonen(Clusterer, kind="kohonen"):
    """The online map over the shape's own chain, ring or lattice.

    The nodes start on samples drawn at random. In each step one sample x is drawn; the node nearest to it and, by a
    Gaussian of their distance over the layout, the nodes around it move towards x. The learning rate falls linearly
    to 0.01, the Gaussian's width from half the layout's length to half a node.

    Args:
        steps: For each node. Kohonen advises 500; the 63 ms of the paper leave time for about a fifth of that.
        rate: The learning rate at the start, 0...1.
    """

    steps: int = 100
    rate: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.steps < 1 or not 0 < self.rate <= 1:
            raise ValueError(f"kohonen: expected steps >= 1 and a rate in 0...1, got {self.steps} and {self.rate}.")

    def centres(self, samples: Samples, layout: Topology, seed: int) -> Centres:
        """Return the nodes, in the map's own order."""
        rng = np.random.default_rng(seed)
        middle = samples.points.mean(axis=0)
        points = samples.points - middle
        nodes = points[rng.choice(len(points), layout.size, replace=False)]
        off = np.sum(layout.offsets() ** 2, axis=0)
        count = self.steps * layout.size
        left = np.linspace(1.0, 0.0, count)
        rates = 0.01 + (self.rate - 0.01) * left
        widths = np.maximum(np.sqrt(off.max()) / 2, 0.5) ** left * 0.5 ** (1 - left)
        falls = -0.5 / widths**2
        for x, rate, fall in zip(points[rng.integers(len(points), size=count)], rates, falls, strict=True):
            away = x - nodes
            winner = int(np.argmin(np.einsum("kd,kd->k", away, away)))
            nodes += (rate * np.exp(fall * off[winner]))[:, None] * away
        return Centres(nodes + middle, count, True)
