"""Points in the image: in pixels, or normalised to the image's size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shape_obs.features.base import Feature, View
from shape_obs.shape import Shape

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Points2D(Feature, kind="points2d"):
    """(u0, v0, u1, v1, ...) in pixels, pixel centres at integers; within the image."""

    def bounds(self, count: int, view: View) -> tuple[Array, Array]:
        """From the image's first to its last edge."""
        return np.full(2 * count, -0.5), np.tile([view.width - 0.5, view.height - 0.5], count)

    def compute(self, shape: Shape, view: View) -> Array:
        """(2N,) pixels."""
        return shape.pixels.astype(np.float64).ravel()


@dataclass(frozen=True)
class Points2DNormalized(Feature, kind="points2d_normalized"):
    """(u0, v0, u1, v1, ...), -1...1 from the image's first edge to its last."""

    def bounds(self, count: int, view: View) -> tuple[Array, Array]:
        """-1...1."""
        return np.full(2 * count, -1.0), np.full(2 * count, 1.0)

    def compute(self, shape: Shape, view: View) -> Array:
        """(2N,) without unit: 2 (u + 0.5) / width - 1, likewise v."""
        return (2 * (shape.pixels.astype(np.float64) + 0.5) / (view.width, view.height) - 1).ravel()
