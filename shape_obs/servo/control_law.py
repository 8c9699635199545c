"""Control laws on an estimated Jacobian: damped least squares, model-free adaptive control, weights of their errors."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.features import Feature, FeatureContext
from shape_obs.geometry.topology import Topology
from shape_obs.servo.jacobian import (
    Broyden,
    JacobianEstimator,
    Kalman,
    PseudoJacobian,
    RecursiveLeastSquares,
    check_in_range,
)
from shape_obs.spec import did_you_mean

Array = npt.NDArray[np.float64]

_RESPONSE: Final = 0.05  # share of the response to the largest action that counts as noise
_SINGULAR: Final = 1e-9  # largest entry of an estimate below which it counts as zero


class ServoLaw(ABC):
    """Map an error of features to an action with a Jacobian that is estimated while moving.

    Args:
        estimator: The estimator of the Jacobian.

    Attributes:
        estimator: The estimator of the Jacobian.
        weights: (M, F) matrix that maps an error of features to M values of equal importance; None for the identity.
        learnt: Number of updates of the estimate.
    """

    estimator: JacobianEstimator
    weights: Array | None
    learnt: int

    def __init__(self, estimator: JacobianEstimator) -> None:
        self.estimator = estimator
        self.weights = None
        self.learnt = 0

    def start(self, features: int, actions: int, matrix: npt.ArrayLike | None = None) -> None:
        """Reset the law; see ``JacobianEstimator.start``."""
        self.estimator.start(features, actions, matrix)
        self.weights, self.learnt = None, 0

    def update(
        self,
        delta_features: npt.ArrayLike,
        delta_action: npt.ArrayLike,
        measured: npt.NDArray[np.bool_] | None = None,
    ) -> bool:
        """Update the estimate; see ``JacobianEstimator.update``."""
        done = self.estimator.update(delta_features, delta_action, measured)
        self.learnt += done
        return done

    @property
    def ready(self) -> bool:
        """Whether the estimate can be used, which it can if it is finite and not zero."""
        matrix = self.estimator.matrix
        return matrix is not None and bool(np.all(np.isfinite(matrix))) and float(np.abs(matrix).max()) > _SINGULAR

    def act(self, error: npt.ArrayLike, measured: npt.NDArray[np.bool_] | None = None) -> Array:
        """Return the action, -1...1, for an error of features.

        Args:
            error: ``(F,)`` desired minus current features.
            measured: ``(F,)`` which features to use; None for all.

        Returns:
            The action ``(A,)``; zeros if the estimate cannot be used or the error is not finite.

        Raises:
            ValueError: ``start`` was not called, or a size is wrong.
        """
        matrix, away = self.estimator.matrix, np.asarray(error, dtype=np.float64)
        if matrix is None:
            raise ValueError("servo law: call start(features, actions) first.")
        if away.shape != matrix.shape[:1]:
            raise ValueError(f"servo law: expected an error of {matrix.shape[0]} features, got {away.shape}.")
        if not self.ready or not np.all(np.isfinite(away)):
            return np.zeros(matrix.shape[1])
        if measured is not None:
            matrix, away = np.where(measured[:, None], matrix, 0.0), np.where(measured, away, 0.0)
        if self.weights is not None:
            matrix, away = self.weights @ matrix, self.weights @ away
        return self._step(matrix, away)

    @abstractmethod
    def _step(self, jacobian: Array, error: Array) -> Array:
        """Return the action ``(A,)`` for J ``(F, A)`` and an error ``(F,)``, both weighted."""


def saturated(action: Array) -> Array:
    """Scale an action down, without changing its direction, until all of its values are within -1...1."""
    return action / max(float(np.abs(action).max()), 1.0)


class DampedLeastSquares(ServoLaw):
    """Damped least squares, ``a = (J'WJ + m I)^-1 J'W g e``, scaled down to the largest action.

    Nakamura and Hanafusa, 'Inverse kinematic solutions with singularity robustness for robot manipulator control',
    Journal of Dynamic Systems, Measurement, and Control 1986. The damping m is relative to the mean diagonal of J'WJ,
    so it does not depend on the units.

    Args:
        estimator: The estimator of J.
        gain: g, 0...1: share of the error to remove in one step.
        damping: m, relative; larger values slow down directions that hardly change the features.
    """

    def __init__(self, estimator: JacobianEstimator, gain: float = 0.5, damping: float = 0.1) -> None:
        super().__init__(estimator)
        self.gain, self.damping = (
            check_in_range("DampedLeastSquares: gain", gain),
            check_in_range("DampedLeastSquares: damping", damping),
        )

    def _step(self, jacobian: Array, error: Array) -> Array:
        normal = jacobian.T @ jacobian
        normal += self.damping * np.trace(normal) / len(normal) * np.eye(len(normal))
        return saturated(np.linalg.solve(normal, jacobian.T @ (self.gain * error)))


class ModelFreeAdaptiveControl(ServoLaw):
    """Model-free adaptive control, ``a = r J'e / (l + |J|^2)``, scaled down to the largest action.

    Hou and Jin, 'Data-driven model-free adaptive control for a class of MIMO nonlinear discrete-time systems', IEEE
    Transactions on Neural Networks 2011, eq. 10. ``|J|`` is the spectral norm and ``l`` relative to its square. No
    matrix is inverted. Directions that hardly change the features are slow, which is safe.

    Args:
        estimator: The estimator of J; ``PseudoJacobian`` in the paper.
        step: r, 0...2.
        penalty: l, the penalty on motion.
    """

    def __init__(self, estimator: JacobianEstimator, step: float = 1.0, penalty: float = 0.1) -> None:
        super().__init__(estimator)
        self.step = check_in_range("ModelFreeAdaptiveControl: step", step, 2.0)
        self.penalty = check_in_range("ModelFreeAdaptiveControl: penalty", penalty, 1e6)

    def _step(self, jacobian: Array, error: Array) -> Array:
        square = np.linalg.norm(jacobian, 2) ** 2
        return saturated(self.step * (jacobian.T @ error) / ((1 + self.penalty) * square))


_MADE: Final[Mapping[str, tuple[str, Callable[[], ServoLaw]]]] = {
    "broyden": ("Broyden's update, damped least squares", lambda: DampedLeastSquares(Broyden())),
    "rls": ("recursive least squares, damped least squares", lambda: DampedLeastSquares(RecursiveLeastSquares())),
    "kalman": ("Kalman filter, damped least squares", lambda: DampedLeastSquares(Kalman())),
    "mfac": ("pseudo-Jacobian, damped least squares", lambda: DampedLeastSquares(PseudoJacobian())),
    "mfac-law": ("pseudo-Jacobian, model-free adaptive control", lambda: ModelFreeAdaptiveControl(PseudoJacobian())),
}

#: The estimator and the law behind each name.
LAWS: Final[Mapping[str, str]] = {name: what for name, (what, _) in _MADE.items()}


def make_law(name: str) -> ServoLaw:
    """Return a law by its name, with the settings that did best in ``shape-obs bench servo``.

    Raises:
        ValueError: The name is unknown.
    """
    if name not in _MADE:
        raise ValueError(f"servo law: unknown name {name!r}{did_you_mean(name, LAWS)}")
    return _MADE[name][1]()


def geometric_weights(features: Sequence[Feature], layout: Topology, context: FeatureContext) -> Array | None:
    """Return the matrix from changes of features to changes of the points that they describe.

    Coefficients of a curve differ in their effect: one moves all points, another hardly any, and two may nearly cancel.
    As points, their errors are the visible ones. For point features the matrix is the identity.

    Args:
        features: The features in the order of the vector.
        layout: The topology of the shape.
        context: The context, as for the bounds of the features.

    Returns:
        A matrix (M, F) with M at most F; None if a feature cannot be turned back into points, or is not linear in them.
    """
    blocks = []
    for feature in features:
        if not feature.invertible:
            return None
        count = len(feature.bounds(layout, context)[0])
        back = partial(feature.reconstruct, layout=layout, context=context)
        origin = back(np.zeros(count)).ravel()
        columns = np.column_stack([back(unit).ravel() - origin for unit in np.eye(count)])
        if not np.allclose(back(np.arange(count)).ravel() - origin, columns @ np.arange(count)):
            return None
        # Only lengths matter, and the triangular factor has the same with fewer rows.
        blocks.append(np.linalg.qr(columns, mode="r") / np.sqrt(layout.size))
    out = np.zeros((sum(len(block) for block in blocks), sum(block.shape[1] for block in blocks)))
    row = column = 0
    for block in blocks:
        out[row : row + len(block), column : column + block.shape[1]] = block
        row, column = row + len(block), column + block.shape[1]
    return out


def noise_weights(still: npt.ArrayLike, jacobian: npt.ArrayLike) -> Array:
    """Return weights that scale each feature by its noise, plus a small share of its response to motions.

    Args:
        still: ``(T, F)`` features while nothing moved, T at least 3.
        jacobian: ``(F, A)`` response of the features to actions, which sets the scale if there is no noise.

    Returns:
        A diagonal matrix ``(F, F)``.
    """
    frames, matrix = np.asarray(still, dtype=np.float64), np.asarray(jacobian, dtype=np.float64)
    scale = np.hypot(np.std(frames, axis=0, ddof=1), _RESPONSE * np.linalg.norm(matrix, axis=1))

    known = scale > 0
    return np.diag(np.where(known, 1 / np.where(known, scale, 1.0), 0.0))
