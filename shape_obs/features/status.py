"""How far a shape can be trusted, as numbers that a policy can see (it cannot read ``info``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shape_obs.features.base import Feature, View
from shape_obs.geometry.topology import Topology
from shape_obs.shape import Shape

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Ok(Feature, kind="ok"):
    """1 where the shape is ok, else 0."""

    def bounds(self, layout: Topology, view: View) -> tuple[Array, Array]:
        """0...1."""
        return np.zeros(1), np.ones(1)

    def compute(self, shape: Shape, view: View) -> Array:
        """(1,)."""
        return np.array([float(shape.ok)])


@dataclass(frozen=True)
class Age(Feature, kind="age"):
    """Seconds since the points were seen, at most ``max_age`` (past that ``ok`` is 0 anyway)."""

    @property
    def unit(self) -> str:
        """Seconds."""
        return "s"

    def bounds(self, layout: Topology, view: View) -> tuple[Array, Array]:
        """0...max_age."""
        return np.zeros(1), np.full(1, view.max_age)

    def compute(self, shape: Shape, view: View) -> Array:
        """(1,) seconds."""
        return np.array([min(shape.age, view.max_age)])


@dataclass(frozen=True)
class Valid(Feature, kind="valid"):
    """For each point 1 where it was really measured, 0 where it was filled in."""

    def bounds(self, layout: Topology, view: View) -> tuple[Array, Array]:
        """0...1."""
        return np.zeros(layout.size), np.ones(layout.size)

    def compute(self, shape: Shape, view: View) -> Array:
        """(N,)."""
        return shape.valid.astype(np.float64)
