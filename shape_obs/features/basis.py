"""What Fourier, Bezier, B-spline and principal components share: a weighted, regularised least-squares fit."""

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

#: How much a bend costs where points are missing, beside their distances, and how much a step does beside a bend: the
#: first tells how a gap is bridged and an end goes on, the second only what is left open by it.
BEND: Final = 0.3
STEP: Final = 1e-4


class Design(NamedTuple):
    """How coefficients make points.

    Args:
        basis: (N,K) values of K basis functions at the N points.
        penalty: (K,K) what is added to the normal equations of N points of weight 1.
        inverse: (K,N) from N points of equal weight to coefficients.
        bridge: (K,K) what is added to them in the measure that points are missing.
    """

    basis: Array
    penalty: Array
    inverse: Array
    bridge: Array

    @classmethod
    def of(cls, basis: Array, penalty: Array | None = None, bridge: Array | None = None) -> Design:
        """Solve for points of equal weight; a penalty or a bridge that is not given is none.

        Raises:
            ValueError: The points do not tell the functions apart.
        """
        none = np.zeros((basis.shape[1], basis.shape[1]))
        penalty, bridge = none if penalty is None else penalty, none if bridge is None else bridge
        normal = basis.T @ basis + penalty
        if np.linalg.matrix_rank(normal, hermitian=True) < len(normal):
            raise ValueError(f"{len(basis)} points do not tell {len(normal)} functions apart: use fewer functions.")
        return cls(basis, penalty, np.linalg.solve(normal, basis.T), bridge)

    def fit(self, points: Array, weight: Array) -> Array:
        """Weighted least squares: (N,D) points, (N,) weights -> (K,D) coefficients; NaN where fewer than 2 are known.

        They minimise ``sum_i w_i |p_i - B_i c|^2 + m tr(c' P c) + (max(w) - m) tr(c' Q c)``, P being the penalty, Q the
        bridge and m the mean weight: where all points weigh the same, nothing is bridged.
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
    """Coefficients of basis functions of the points' place in the layout, one point (2,) or (3,) for each function.

    They are a linear function of the points as long as the same ones are measured. Points that were filled in hardly
    count; where points are missing, the curve bends as little as it can (the difference penalty of Eilers & Marx,
    'Flexible smoothing with B-splines and penalties', Statistical Science 1996, taken of the points, not of the
    coefficients).
    """

    @abstractmethod
    def basis(self, layout: Topology) -> Array:
        """(N,K) the functions at the points of a layout.

        Raises:
            ValueError: There are none for this layout, or more than it has points.
        """

    def penalty(self, layout: Topology) -> Array | None:
        """(K,K) what keeps the coefficients small even when all N points are measured; None for nothing."""
        return None

    def design(self, layout: Topology) -> Design:
        """The basis at the points of a layout, and what keeps its coefficients sane.

        Raises:
            ValueError: There is no basis for this layout, or it has more functions than the layout has points.
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
        """What points anywhere in their box can give: each coefficient is a weighted sum of them."""
        low, high = self.coordinates.box(context)
        inverse = _design(self, layout).inverse
        up, down = np.maximum(inverse, 0.0).sum(axis=1), np.minimum(inverse, 0.0).sum(axis=1)
        return np.ravel(np.outer(up, low) + np.outer(down, high)), np.ravel(np.outer(up, high) + np.outer(down, low))

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """(K D,) coefficients, function after function; points that were not measured hardly count."""
        points = self.coordinates.points(shape, context)
        return _design(self, shape.layout).fit(points, self.coordinates.weights(shape, points)).ravel()

    def reconstruct(self, values: npt.ArrayLike, layout: Topology, context: FeatureContext) -> Array:
        """(N,2) or (N,3) the basis functions' sum at the points' places."""
        basis = _design(self, layout).basis
        return basis @ np.asarray(values, dtype=np.float64).reshape(basis.shape[1], -1)


def open_counts(layout: Topology, kind: str, instead: str) -> tuple[int, ...]:
    """How many points an open layout has in each of its directions: (N,) of a chain, (rows, cols) of a lattice.

    Args:
        layout: A chain or a lattice.
        kind: Of the feature that asks, for the message.
        instead: What the message tells to use for a ring.

    Raises:
        ValueError: It is no such layout.
    """
    if isinstance(layout, Chain):
        return (layout.count,)
    if isinstance(layout, Grid):
        return layout.rows, layout.cols
    if isinstance(layout, Ring):
        raise ValueError(f"feature {kind!r} is of open curves, but the shape is a ring: use {instead}.")
    raise ValueError(f"feature {kind!r} is of chains and lattices, got {layout!r}.")


def products(bases: Iterable[Array]) -> Array:
    """(N,K) the basis of a lattice, its second direction's functions running fastest, from one for each direction."""
    return np.asarray(reduce(np.kron, bases), dtype=np.float64)


def _differences(layout: Topology) -> tuple[Array, Array]:
    """(B,N) second differences along every direction of a layout, and (E,N) first ones."""
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
