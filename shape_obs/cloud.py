"""A cloud of points in space, as a body that shapes are fitted to."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from shape_obs.samples import Samples


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of one object in space.

    Args:
        points: (M,3) metres.
    """

    points: npt.NDArray[np.float64]
    unit: ClassVar[str] = "m"
    noun: ClassVar[str] = "cloud"
    grains: ClassVar[str] = "points"

    @cached_property
    def components(self) -> tuple[Any, ...]:
        """Pieces that hang together, largest first."""
        raise NotImplementedError

    @cached_property
    def width(self) -> float:
        """Thickness, metres."""
        raise NotImplementedError

    @cached_property
    def stretch(self) -> float:
        """Length, metres."""
        raise NotImplementedError

    @cached_property
    def samples(self) -> Samples:
        """The points in voxels."""
        raise NotImplementedError

    @property
    def amount(self) -> int:
        """Points."""
        return len(self.points)

    def seen(self, points: npt.NDArray[np.float64], target: npt.NDArray[np.float64] | None) -> npt.NDArray[np.float64]:
        """(N,D) the points as an anchor is given."""
        return points

    def breadth(self, length: float) -> float:
        """The width that a spread is judged by, metres."""
        return self.width

    def carries(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
        """Whether the cloud has points near (N,3) places: (N,) bool."""
        raise NotImplementedError
