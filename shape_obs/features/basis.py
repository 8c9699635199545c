"""The weighted, regularised least-squares fit that Fourier, Bezier, B-spline and PCA features share."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache, reduce
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.features.coordinates import Geometric
from shape_obs.features.feature import FeatureContext
from shape_obs.geometry.topology import Chain, Grid, Ring, Topology
from shape_obs.shape import Shape

Array = npt.NDArray[np.float64]

#: Weight of second differences where points are missing: it decides how gaps and missing ends are filled.
BEND: Final = 0.3
#: Weight of first differences relative to second ones: it decides only what these leave open.
STEP: Final = 1e-4


class Design(NamedTuple):
    """The matrices of a linear least-squares fit.

    Args:
        basis: ``(N, K)`` values of K basis functions at the N points.
        penalty: ``(K, K)`` matrix added to the normal equations of N points of weight 1.
        inverse: ``(K, N)`` matrix from N points of equal weight to coefficients.
        bridge: ``(K, K)`` matrix added to the normal equations in proportion to the missing weight.
    """

    basis: Array
    penalty: Array
    inverse: Array
    bridge: Array

    @classmethod
    def of(cls, basis: Array, penalty: Array | None = None, bridge: Array | None = None) -> Design:
        """Compute the matrices of a basis; the default penalty and bridge are zero.

        Raises:
            ValueError: The points do not determine the coefficients.
        """
        none = np.zeros((basis.shape[1], basis.shape[1]))
        penalty, bridge = none if penalty is None else penalty, none if bridge is None else bridge
        normal = basis.T @ basis + penalty
        if np.linalg.matrix_rank(normal, hermitian=True) < len(normal):
            raise ValueError(f"{len(basis)} points do not determine {len(normal)} functions: use fewer functions.")
        return cls(basis, penalty, np.linalg.solve(normal, basis.T), bridge)

    def fit(self, points: Array, weight: Array) -> Array:
        """Return the coefficients (K, D) of points (N, D) with weights (N,); NaN if fewer than two are known.

        They minimise ``sum_i w_i |p_i - B_i c|^2 + m tr(c' P c) + (max(w) - m) tr(c' Q c)`` with the penalty P, the
        bridge Q and the mean weight m. If all points have the same weight, the bridge has no effect.
        """
        known = np.count_nonzero(weight)
        if known < 2:
            return np.full((self.basis.shape[1], points.shape[1]), np.nan)
        mean, most = weight.mean(), weight.max()
        if weight.min() == most:
            return self.inverse @ points
        if known < len(weight):
            points = np.where(weight[:, None] > 0, points, 0.0)
        weighted = self.basis.T * weight
        normal = weighted @ self.basis + mean * self.penalty + (most - mean) * self.bridge
        return np.linalg.solve(normal, weighted @ points)


@dataclass(frozen=True)
class LinearFit(Geometric):
    """Coefficients of basis functions over the layout, one point of shape ``(2,)`` or ``(3,)`` for each function.

    The coefficients are a linear function of the points as long as the same points are measured. Filled-in points have
    a small weight; where points are missing, the curve bends as little as possible (the difference penalty of Eilers &
    Marx, 'Flexible smoothing with B-splines and penalties', Statistical Science 1996, applied to the points instead of
    the coefficients).
    """

    @abstractmethod
    def basis(self, layout: Topology) -> Array:
        """Return the functions at the points of a layout, of shape ``(N, K)``.

        Raises:
            ValueError: The layout has no such functions, or fewer points than functions.
        """

    def penalty(self, layout: Topology) -> Array | None:
        """Return a penalty (K, K) on the coefficients that acts even if all N points are measured; None for none."""
        return None

    def design(self, layout: Topology) -> Design:
        """Return the matrices of the fit for a layout.

        Raises:
            ValueError: The layout has no such functions, or fewer points than functions.
        """
        basis = self.basis(layout)
        if basis.shape[1] > len(basis):
            raise ValueError(
                f"feature {self.kind!r} has {basis.shape[1]} functions here, but the shape has {len(basis)} points: "
                "use fewer functions or more points."
            )
        bends, steps = (differences @ basis for differences in _differences(layout))
        return Design.of(basis, self.penalty(layout), BEND * (bends.T @ bends + STEP * (steps.T @ steps)))

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """Return the bounds for points anywhere in their box; each coefficient is a weighted sum of the points."""
        low, high = self.coordinates.box(context)
        inverse = _design(self, layout).inverse
        up, down = np.maximum(inverse, 0.0).sum(axis=1), np.minimum(inverse, 0.0).sum(axis=1)
        return np.ravel(np.outer(up, low) + np.outer(down, high)), np.ravel(np.outer(up, high) + np.outer(down, low))

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """Return the coefficients, function after function, of shape (K * D,)."""
        points = self.coordinates.points(shape, context)
        return _design(self, shape.layout).fit(points, self.coordinates.weights(shape, points)).ravel()

    def reconstruct(self, values: npt.ArrayLike, layout: Topology, context: FeatureContext) -> Array:
        """Return the sum of the basis functions at the points, of shape ``(N, 2)`` or ``(N, 3)``."""
        basis = _design(self, layout).basis
        return basis @ np.asarray(values, dtype=np.float64).reshape(basis.shape[1], -1)


def open_counts(layout: Topology, kind: str, instead: str) -> tuple[int, ...]:
    """Return the number of points of an open layout in each direction: ``(N,)`` of a chain, (rows, cols) of a lattice.

    Args:
        layout: A chain or a lattice.
        kind: The kind of the feature, for the error message.
        instead: What the error message suggests for a ring.

    Raises:
        ValueError: The layout is neither a chain nor a lattice.
    """
    if isinstance(layout, Chain):
        return (layout.count,)
    if isinstance(layout, Grid):
        return layout.rows, layout.cols
    if isinstance(layout, Ring):
        raise ValueError(f"feature {kind!r} is for open curves, but the shape is a ring: use {instead}.")
    raise ValueError(f"feature {kind!r} is for chains and lattices, got {layout!r}.")


def products(bases: Iterable[Array]) -> Array:
    """Return the basis ``(N, K)`` of a lattice from one for each direction; the second direction varies fastest."""
    return np.asarray(reduce(np.kron, bases), dtype=np.float64)


def _differences(layout: Topology) -> tuple[Array, Array]:
    """Return second differences ``(B, N)`` along every direction of a layout, and first differences ``(E, N)``."""
    unit, offsets = np.eye(layout.size), layout.offsets()
    near = np.abs(offsets).sum(axis=0) == 1
    bends = []
    for along in offsets:
        ahead, behind = near & (along == 1), near & (along == -1)
        inner = ahead.any(axis=1) & behind.any(axis=1)
        bends.append((ahead.astype(float) + behind - 2 * unit)[inner])
    start, end = layout.edges().T
    return np.concatenate(bends), unit[end] - unit[start]


@lru_cache(maxsize=64)
def _design(feature: Any, layout: Any) -> Design:
    return feature.design(layout)
