"""Centerline: a rope or cable as N points from one end to the other along its axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from shape_obs.coldstart.bridge import join
from shape_obs.coldstart.fold import fold
from shape_obs.configurations.base import Configuration
from shape_obs.curve import catmull_rom, equidistant_positions
from shape_obs.region import Region
from shape_obs.tips import extend_to_tips
from shape_obs.topology import Chain

Ends = Literal["centers", "tips"]
Array = npt.NDArray[np.float64]

# Nodes sit about this many widths apart: closer, and a chain starts to fold across the rope; farther, and it cuts
# corners. N is sampled from the curve afterwards, so it does not matter here.
_NODE_SPACING: Final = 1.4
_NODES: Final = (6, 48)
# The cost of joining pieces grows with the cube of their number, and a rope does not fall into that many.
_MAX_PIECES: Final = 16
_MIN_ASPECT: Final = 3.0  # length over width; what is stouter has no axis to speak of, and a chain would fold up in it


@dataclass(frozen=True)
class Centerline(Configuration, kind="centerline"):
    """A rope's axis.

    Args:
        n: How many points.
        ends: ``"centers"``: the points are centres of N equal pieces, as cluster centres are; ``"tips"``: the first
            and last point lie on the rope's real tips. None takes the detector's.
    """

    n: int = 20
    ends: Ends | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 2 <= self.n <= 1000:
            raise ValueError(f"centerline: n must lie in 2...1000, got {self.n}.")

    @property
    def count(self) -> int:
        """N."""
        return self.n

    def unfit(self, region: Region) -> str:
        """Too many pieces, or no rope: at least three times as long as wide."""
        if len(region.components) > _MAX_PIECES:
            return f"the mask falls into {len(region.components)} pieces, at most {_MAX_PIECES}"
        length = region.area / region.width
        if length < _MIN_ASPECT * region.width:
            return f"the mask is {length:.0f} x {region.width:.0f} px: too stout for a rope"
        return ""

    def topology(self, region: Region) -> Chain:
        """A chain with a node every 1.4 widths, 6 to 48 of them."""
        length = region.area / region.width
        return Chain(int(np.clip(round(length / (_NODE_SPACING * region.width)), *_NODES)))

    def parameterise(self, region: Region) -> Array:
        """Each component folded, the pieces joined end to end."""
        return join([fold(component.outline, component.width) for component in region.components])

    def finish(self, nodes: Array, region: Region) -> Array:
        """The curve through the nodes, lengthened to the rope's tips."""
        return catmull_rom(extend_to_tips(nodes, region, region.width))

    def symmetries(self, nodes: Array) -> tuple[Array, ...]:
        """Forward and reversed."""
        return nodes, nodes[::-1]

    def positions(self, curve: Array, arc: Array) -> Array:
        """Equal chords, from tip to tip or at the centres of N pieces."""
        return equidistant_positions(curve, arc, self.n, centers=self.ends != "tips")
