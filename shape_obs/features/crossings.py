"""Where a rope lies over or under itself and others, as a fixed number of values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shape_obs.features.feature import Feature, FeatureContext
from shape_obs.geometry.topology import Chain, Topology
from shape_obs.shape import Shape

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Crossings(Feature, kind="crossings"):
    """The number of a rope's crossings, and its first passages through them.

    There are 4 + 2 ``passages`` values without a unit. The first four count the crossings with itself, and those with
    others in which it is above, below, and in which that is unknown. Then follows a pair for each passage, from
    point 0 on: where it is, as a share 0...1 of the rope's length, and 1 if the rope passes over the other strand, -1
    if under it, 0 if that is unknown. A crossing of the rope with itself has two passages. Pairs that are not needed
    are (0, 0), which is the end of the rope and no crossing; passages that do not fit are left out. What is invariant
    is the order: the values change neither when the rope moves nor when it turns.

    They jump when a crossing appears or vanishes, so that they are for policies and no goals of a servo law.

    Args:
        passages: How many passages there is room for.
        max_count: At which the counts saturate.
    """

    passages: int = 8
    max_count: int = 8

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, least in (("passages", 0), ("max_count", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"crossings: {name} must be at least {least}, got {getattr(self, name)}.")

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """Return 0 and ``max_count`` for each count, then (0, -1) and (1, 1) for each passage.

        Raises:
            ValueError: The layout is no chain.
        """
        if not isinstance(layout, Chain):
            raise ValueError(f"feature 'crossings' is for a Chain, got {layout}.")
        low = np.concatenate([np.zeros(4), np.tile([0.0, -1.0], self.passages)])
        return low, np.concatenate([np.full(4, float(self.max_count)), np.ones(2 * self.passages)])

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """Return the counts and the passages, of shape (4 + 2 ``passages``,)."""
        values, found = np.zeros(4 + 2 * self.passages), []
        for crossing in shape.crossings:
            for side, level in ((0, 1.0), (1, -1.0)):
                if crossing.slots[side] == shape.name:
                    level = 0.0 if crossing.above is None else level * (1 - 2 * crossing.above)
                    found.append((crossing.arcs[side], level))
                    own = crossing.slots[1 - side] == shape.name
                    values[0 if own else {1.0: 1, -1.0: 2, 0.0: 3}[level]] += 0.5 if own else 1.0
        values[:4] = np.minimum(values[:4], self.max_count)
        first = np.ravel(sorted(found)[: self.passages])
        values[4 : 4 + len(first)] = first
        return values
