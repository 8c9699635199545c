"""What control laws on an estimated Jacobian have in common.

The laws by name.

The damped least-squares law on an estimated Jacobian.

The control law of model-free adaptive control.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
import numpy.typing as npt

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


# Of the largest singular value: below it an estimate answers to one direction alone, or to none.
_SINGULAR: Final = 1e-9


class ServoLaw(ABC):
    """From an error of features to an action, on a Jacobian that is learnt on the way.

    Args:
        estimator: Of the Jacobian.

    Attributes:
        estimator: As given.
        weights: (M,F) what an error of features is taken to be, as M numbers of equal worth; None: the features
            themselves.
        learnt: How many changes were learnt from.
    """

    def __init__(self, estimator: JacobianEstimator) -> None:
        self.estimator = estimator
        self.weights: Array | None = None
        self.learnt = 0

    def start(self, features: int, actions: int, matrix: npt.ArrayLike | None = None) -> None:
        """Forget everything; see ``JacobianEstimator.start``."""
        self.estimator.start(features, actions, matrix)
        self.weights, self.learnt = None, 0

    def update(
        self,
        delta_features: npt.ArrayLike,
        delta_action: npt.ArrayLike,
        measured: npt.NDArray[np.bool_] | None = None,
    ) -> bool:
        """See ``JacobianEstimator.update``."""
        done = self.estimator.update(delta_features, delta_action, measured)
        self.learnt += done
        return done

    @property
    def ready(self) -> bool:
        """Whether the estimate can be acted on: finite, and not zero."""
        matrix = self.estimator.matrix
        return matrix is not None and bool(np.all(np.isfinite(matrix))) and float(np.abs(matrix).max()) > _SINGULAR

    def act(self, error: npt.ArrayLike, measured: npt.NDArray[np.bool_] | None = None) -> Array:
        """The action (A,) in -1...1 for an error (F,), what is desired minus what is.

        Args:
            error: (F,).
            measured: (F,) which features count; None for all.

        Zeros while there is no estimate to act on, and for an error that is not finite.

        Raises:
            ValueError: ``start`` was not called, or a wrong size.
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
        """(A,) for J (F,A) and an error (F,), both weighted."""


def saturated(action: Array) -> Array:
    """The action, shortened without a change of direction until no part of it is beyond -1...1."""
    return action / max(float(np.abs(action).max()), 1.0)


class DampedLeastSquares(ServoLaw):
    """``a = (J'WJ + m I)^-1 J'W g e``, shortened to the largest action: Levenberg's step towards the goal.

    Nakamura and Hanafusa, 'Inverse kinematic solutions with singularity robustness for robot manipulator control',
    Journal of Dynamic Systems, Measurement, and Control 1986. The damping m is a share of the mean diagonal of J'WJ, so
    that it means the same in any unit.

    Args:
        estimator: Of J.
        gain: g, 0...1: the share of the error to be removed by one step.
        damping: m, as a share: more takes directions that the features hardly answer to more slowly.
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
    """``a = r J'e / (l + |J|^2)``, shortened to the largest action: downhill, with no matrix to invert.

    Hou and Jin, 'Data-driven model-free adaptive control for a class of MIMO nonlinear discrete-time systems', IEEE
    Transactions on Neural Networks 2011, eq. 10. ``|J|`` is the spectral norm and ``l`` a share of its square.
    Directions that the features hardly answer to are taken slowly: safe, and slow where they matter.

    Args:
        estimator: Of J; the paper's is ``PseudoJacobian``.
        step: r, 0...2.
        penalty: l, on motion.
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

#: What each name stands for: an estimator, and the law that acts on its Jacobian.
LAWS: Final[Mapping[str, str]] = {name: what for name, (what, _) in _MADE.items()}


def make_law(name: str) -> ServoLaw:
    """A law with the settings that stood the bench best.

    Raises:
        ValueError: An unknown name.
    """
    if name not in _MADE:
        raise ValueError(f"servo law: unknown name {name!r}{did_you_mean(name, LAWS)}")
    return _MADE[name][1]()
