"""What control laws on an estimated Jacobian have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.servo.estimator import JacobianEstimator

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
