"""What Fourier, Bezier, B-spline and principal components share: a weighted, regularised least-squares fit."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import linalg

from shape_obs.features.base import View
from shape_obs.features.coordinates import Geometric
from shape_obs.shape import Shape
from shape_obs.topology import Topology

Array = npt.NDArray[np.float64]


class Design(NamedTuple):
    """How coefficients make points.

    Args:
        basis: (N,K) values of K basis functions at the N points.
        penalty: (K,K) what is added to the normal equations of N points of weight 1.
        inverse: (K,N) from N points of equal weight to coefficients.
    """

    basis: Array
    penalty: Array
    inverse: Array

    @classmethod
    def of(cls, basis: Array, penalty: Array) -> Design:
        """Solve for points of equal weight."""
        inverse = linalg.solve(basis.T @ basis + penalty, basis.T, assume_a="pos")
        return cls(basis, penalty, inverse)

    def fit(self, points: Array, weight: Array) -> Array:
        """(K,D) the coefficients c that minimise ``sum_i w_i |p_i - B_i c|^2 + (sum_i w_i / N) tr(c' P c)``.

        NaN where fewer than two points are known.
        """
        known = np.count_nonzero(weight)
        if known < 2:
            return np.full((self.basis.shape[1], points.shape[1]), np.nan)
        if known == len(weight) and np.ptp(weight) == 0:
            return self.inverse @ points
        points = np.where(weight[:, None] > 0, points, 0.0)
        weighted = self.basis.T * weight
        return linalg.solve(
            weighted @ self.basis + weight.mean() * self.penalty, weighted @ points, assume_a="pos", check_finite=False
        )


@dataclass(frozen=True)
class LinearFit(Geometric):
    """Coefficients of basis functions of the points' place in the layout, one point (2,) or (3,) for each function."""

    @abstractmethod
    def design(self, layout: Topology) -> Design:
        """The basis at the points of a layout, and what keeps its coefficients small.

        Raises:
            ValueError: There is none for this layout, or it has more functions than the layout has points.
        """

    def bounds(self, layout: Topology, view: View) -> tuple[Array, Array]:
        """What points anywhere in their box can give: each coefficient is a weighted sum of them."""
        low, high = self.coordinates.box(view)
        inverse = _design(self, layout).inverse
        up, down = np.maximum(inverse, 0.0).sum(axis=1), np.minimum(inverse, 0.0).sum(axis=1)
        return np.ravel(np.outer(up, low) + np.outer(down, high)), np.ravel(np.outer(up, high) + np.outer(down, low))

    def compute(self, shape: Shape, view: View) -> Array:
        """(K D,) coefficients, function after function; points that were not measured hardly count."""
        points = self.coordinates.points(shape, view)
        return _design(self, shape.layout).fit(points, self.coordinates.weights(shape, points)).ravel()

    def reconstruct(self, values: npt.ArrayLike, layout: Topology, view: View) -> Array:
        """(N,2) or (N,3) the basis functions' sum at the points' places."""
        basis = _design(self, layout).basis
        return basis @ np.asarray(values, dtype=np.float64).reshape(basis.shape[1], -1)


@lru_cache(maxsize=64)
def _design(feature: Any, layout: Any) -> Design:
    return feature.design(layout)
